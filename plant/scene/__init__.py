"""Simulation of several muscles or cylinders on a mechanism (a scene)."""
