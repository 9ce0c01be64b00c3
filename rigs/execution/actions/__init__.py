"""Steps that only some protocols need: loads, sweeps, temperatures, valves."""
