"""Control schemes of the valves: the five of the thesis and later ones."""
