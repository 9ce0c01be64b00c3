"""Findings of the standard tests of one muscle beside those of the thesis."""
