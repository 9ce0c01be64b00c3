"""What a running test sends to the live view."""
