"""Reduction of the standard tests of one muscle."""
