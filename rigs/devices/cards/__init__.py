"""Data acquisition cards by their makers' Python packages."""
