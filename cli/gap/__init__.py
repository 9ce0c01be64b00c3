"""Commands of the diagnosis."""
