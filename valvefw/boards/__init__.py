"""Boards with hardware."""
