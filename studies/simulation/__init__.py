"""Scenarios of the whole bench: read, simulated with the firmware in the loop, recorded as runs."""
