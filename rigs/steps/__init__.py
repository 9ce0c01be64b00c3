"""The steps a protocol may yield, and how each is carried out on a rig."""
