"""How far the gap shrinks on held-out data, and where it lies."""
