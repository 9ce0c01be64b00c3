"""Several muscles on a mechanism, simulated as one scene."""
