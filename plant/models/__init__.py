"""Models of the muscle that can be fitted to a run, compared, and put into the simulation."""
