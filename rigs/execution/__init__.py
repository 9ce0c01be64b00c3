"""Carries out the steps of a test, records it, and ends it safely."""
