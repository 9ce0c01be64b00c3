"""The version of the program, as pyproject.toml states it; there is no second place."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed


def version() -> str:
    """The version of the installed distribution; "unknown" from a bare source tree."""
    try:
        return installed("pamrig")
    except PackageNotFoundError:
        return "unknown"
