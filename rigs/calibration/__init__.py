"""Calibration of pressure, force and camera."""
