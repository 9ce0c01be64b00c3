"""Opens, lists, indexes, verifies, annotates and derives recorded runs."""
