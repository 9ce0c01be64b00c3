"""The virtual bench: byte-level instruments over one plant, on one clock."""
