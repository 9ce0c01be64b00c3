"""Measures the gap between two edges in a picture with sub-pixel resolution."""
