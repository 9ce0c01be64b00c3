"""How the valves are switched: the five schemes of the thesis, and those that came after."""
