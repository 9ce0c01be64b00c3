"""Simulation of a scenario with the firmware in the loop; it leaves a record like any run."""
