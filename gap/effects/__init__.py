"""Candidate effects: catalogue entries in several forms, and recording defects."""
