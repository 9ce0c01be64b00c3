"""Recordings of a controller of one's own that prints columns and keeps no safety contract."""
