"""The printed figures of the thesis recomputed."""
