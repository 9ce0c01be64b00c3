"""Diagnoses that know nothing, for tests of what surrounds a diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def quiet(folder: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Sees no gap, ever."""
    assert (folder / "trials.csv").exists()
    return {
        "schema": 1, "status": "no_gap_above_floor", "stage": None, "effects": [],
        "probability_none": 1.0, "probability_unknown": 0.0, "gap": {},
    }  # fmt: skip


def broken(folder: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Falls over."""
    raise ZeroDivisionError("no floor")
