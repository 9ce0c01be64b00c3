"""Studies of the valve schemes of the thesis, in simulation."""
