"""Data of others, brought into the dataset format by a mapping file."""
