"""The book of uses of reserved sets: a set that has been looked at is no longer blind."""

from __future__ import annotations

import csv
import datetime
from collections.abc import Sequence
from pathlib import Path

from gap.errors import CheckError

COLUMNS = ("date", "version", "first", "last", "sets", "purpose")


def uses(path: Path) -> list[dict[str, str]]:
    """Entries of the ledger, oldest first; none if there is no ledger yet."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise CheckError(f"{path}, row 1", f"expected the columns {', '.join(COLUMNS)}")
        return list(reader)


def used_before(path: Path, numbers: Sequence[int]) -> list[dict[str, str]]:
    """Entries whose range meets these numbers."""
    first, last = min(numbers), max(numbers)
    return [u for u in uses(path) if int(u["first"]) <= last and int(u["last"]) >= first]


def enter(path: Path, numbers: Sequence[int], version: str, purpose: str) -> None:
    """Write one use, before the sets are made."""
    fresh = not path.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(COLUMNS)
        today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
        writer.writerow([today, version, min(numbers), max(numbers), len(numbers), purpose])
