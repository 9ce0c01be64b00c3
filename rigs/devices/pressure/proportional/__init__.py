"""Proportional pressure regulators: one file for each protocol that they speak."""
