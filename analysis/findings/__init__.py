"""What a test shows: one module per protocol, from its table to figures and numbers."""
