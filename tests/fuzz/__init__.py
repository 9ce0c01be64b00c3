"""Fuzzing: inputs that nobody would write, for everything that reads bytes of others."""

import vision as _vision  # noqa: F401 - bounds what OpenCV lays out, before it is loaded
