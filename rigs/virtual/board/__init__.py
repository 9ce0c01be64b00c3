"""The emulated valve controller: the real firmware on simulated inputs and outputs."""
