"""Findings of recordings of a controller of one's own."""
