"""Instrument drivers, rigs, the virtual bench, test protocols, the command line."""
