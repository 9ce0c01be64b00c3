"""Terms that a correction may have: what they are made of, and fits of many of them at once."""
