"""Predicted channels and residual features for any constants and effects."""
