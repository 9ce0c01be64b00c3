"""Import of data from other programs, and export of runs to other programs."""
