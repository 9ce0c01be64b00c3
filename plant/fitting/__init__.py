"""Fitting muscle models to data, and comparing them."""
