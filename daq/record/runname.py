"""Names of run folders: start time, protocol, specimen and a unique suffix."""

from __future__ import annotations

import re
import secrets
from datetime import UTC, datetime
from pathlib import Path

STAMP = 16
TAIL = 6


def slug(text: object) -> str:
    """Convert ``text`` to a part of a folder name."""
    return re.sub(r"[^A-Za-z0-9.-]+", "-", str(text)).strip("-.")[:40] or "none"


def run_name(wall_ns: int, protocol: str, specimen: str) -> str:
    """Folder name, such as ``20260131T093000Z_PROTOCOL_SPECIMEN_0a1b2c``.

    The suffix is the fraction of the second (three hexadecimal digits of 0.24 ms), then three
    random digits.
    """
    stamp = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
    part = wall_ns % 1_000_000_000 * 4096 // 1_000_000_000
    return f"{stamp}_{protocol}_{specimen}_{part:03x}{secrets.randbelow(4096):03x}"


def by_start(folder: Path) -> tuple[str, str, str]:
    """Sort key of run folders: start time including the fraction of the second."""
    name = folder.name
    return name[:STAMP], name[-TAIL:], name


def run_tag(run_id: str) -> str:
    """The end of a run's name, which each of its events carries."""
    return run_id[-TAIL:]
