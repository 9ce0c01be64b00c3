"""Muscle models fitted to data and compared."""
