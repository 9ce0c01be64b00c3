"""The command line, and what joins a rig to a diagnosis."""
