"""Writes what a person asked for with `--out`; what stands in the way becomes one line."""

from __future__ import annotations

from pathlib import Path

from gap.errors import GapError


def write_text(path: Path, text: str) -> None:
    """Write a text file, its folder made if need be. Raises `GapError` where it cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GapError(str(path), f"cannot be written: {error.strerror}") from None
