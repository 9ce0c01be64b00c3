"""Audit of the thesis: published figures recomputed from its tables."""
