"""Writes what a person asked for with `--out`; what stands in the way becomes one line."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from daq.wholefile import write_whole
from gap.errors import GapError


def check_out(path: Path | None) -> None:
    """Raise `GapError` where a file could not be written: told before the work, not after it."""
    if path is None:
        return
    if path.is_dir():
        raise GapError(str(path), "cannot be written: is a folder", "give a file in it")
    above = next(folder for folder in path.absolute().parents if folder.exists())
    if not above.is_dir():
        raise GapError(str(path), f"cannot be written: {above} is a file")
    if not os.access(above, os.W_OK):
        raise GapError(str(path), f"cannot be written: {above} may not be written to")


def write_text(path: Path, text: str) -> None:
    """Write a text file, its folder made if need be. Raises `GapError` where it cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
    except OSError as error:
        raise GapError(str(path), f"cannot be written: {error.strerror}") from None


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    return repr(value.item() if hasattr(value, "item") else value)
