"""The gap between two edges in a picture, to a fraction of a pixel."""
