"""Simulators from elsewhere behind the interface of `gap.data.simulator`, opened from a file."""
