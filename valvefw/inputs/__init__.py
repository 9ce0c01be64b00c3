"""Further inputs: force and length on the controller."""
