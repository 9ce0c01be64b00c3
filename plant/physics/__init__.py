"""Muscle, flow, valve and friction laws, and the layout of the parameter array."""
