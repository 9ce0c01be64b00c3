"""Standard tests of one muscle beside those of the thesis."""
