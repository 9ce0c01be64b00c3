"""Names of run folders: when it began, what it was, and what tells it from its neighbours."""

from __future__ import annotations

import re
import secrets
from datetime import UTC, datetime
from pathlib import Path

STAMP = 16
TAIL = 6


def slug(text: object) -> str:
    """``text`` as part of a folder name."""
    return re.sub(r"[^A-Za-z0-9.-]+", "-", str(text)).strip("-.")[:40] or "none"


def run_name(wall_ns: int, protocol: str, specimen: str) -> str:
    """``20260131T093000Z_PROTOCOL_SPECIMEN_0a1b2c``: the tail begins with the part of the second.

    Three hexadecimal digits of it (0.24 ms), then three drawn by lot.
    """
    stamp = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
    part = wall_ns % 1_000_000_000 * 4096 // 1_000_000_000
    return f"{stamp}_{protocol}_{specimen}_{part:03x}{secrets.randbelow(4096):03x}"


def by_start(folder: Path) -> tuple[str, str, str]:
    """Sorts run folders by when they began, also within a second, whatever they are called."""
    name = folder.name
    return name[:STAMP], name[-TAIL:], name
