"""Instrument drivers, rigs, the virtual bench, test protocols, the command line."""

import vision as _vision  # noqa: F401 - bounds the pictures that OpenCV takes, before it is loaded
