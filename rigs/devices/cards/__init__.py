"""Data acquisition cards by their manufacturers' Python packages."""
