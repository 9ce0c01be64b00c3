"""Commands that use a bench: virtual bench, check, vent, calibration, firmware."""
