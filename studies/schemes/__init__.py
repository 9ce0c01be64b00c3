"""Questions put to the simulation, with answers in figures: `pamrig study NAME`."""
