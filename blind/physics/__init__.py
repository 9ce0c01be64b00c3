"""The second bench: its own physics, forms and numbers."""
