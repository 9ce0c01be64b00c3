"""Proportional regulators at byte level, and the pressure at their outlet."""
