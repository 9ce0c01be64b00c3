"""Reduction of raw records to one table of points per run, with type A uncertainties."""
