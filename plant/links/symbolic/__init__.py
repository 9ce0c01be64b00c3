"""Equations of motion in symbols, printed or as source text."""
