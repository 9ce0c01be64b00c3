"""Everything that reads bytes of an instrument, a file or a folder of others, by name."""

from __future__ import annotations

from collections.abc import Callable

from . import files, wires
from .loop import Target

TARGETS: dict[str, Callable[[], Target]] = {**wires.TARGETS, **files.TARGETS}
