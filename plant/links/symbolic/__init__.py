"""Symbolic equations of motion, printed or as source code."""
