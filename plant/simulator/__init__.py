"""The compiled simulator of one muscle, its valve and its load."""
