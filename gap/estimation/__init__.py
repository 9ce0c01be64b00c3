"""Noise from replicates, fits of constants and effects, intervals."""
