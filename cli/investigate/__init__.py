"""Alternates tests and diagnosis until the effect is named."""
