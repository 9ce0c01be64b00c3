"""Tests and diagnosis in turn, until the effect is named."""
