"""Statistics of repeated tests: means, variance components, control charts, decisions on limits."""
