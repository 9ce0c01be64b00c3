"""Data of other programs in, and runs out to other programs."""
