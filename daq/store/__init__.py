"""Recorded runs: opened, indexed, verified, annotated, derived again."""
