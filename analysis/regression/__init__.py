"""Straight lines through points, with the uncertainty of their coefficients."""
