"""A rig file as checked values: devices, limits, calibrations."""
