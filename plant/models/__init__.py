"""Muscle models that can be fitted to a run, compared, and used in the simulation."""
