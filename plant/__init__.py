"""Physics of the bench: muscle, valve and gas, loads, whole-bench simulation."""
