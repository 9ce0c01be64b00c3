"""Scores of blind sets and their totals."""
