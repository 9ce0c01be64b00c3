"""Linear stages at byte level, one module a protocol."""
