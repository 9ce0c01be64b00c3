"""Device links, clocks, run records, the run store and the live view."""
