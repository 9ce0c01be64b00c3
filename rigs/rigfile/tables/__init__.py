"""Tables of a rig file, each read by a module of its own: joint, marks, regulator, stage."""
