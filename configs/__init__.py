"""TOML shipped with the package: rigs, protocols, plants."""
