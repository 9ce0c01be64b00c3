"""Cameras behind packages of their own, and recorded videos."""
