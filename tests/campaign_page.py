"""Pages of campaigns: what a command writes, and below a mark what a person adds."""

from __future__ import annotations

from pathlib import Path

MARK = "<!-- below this line the page is written by hand -->"


def write_page(path: Path, text: str) -> None:
    """Write a page in UTF-8; what a person wrote below the mark stays."""
    kept = ""
    if path.exists():
        _, mark, below = path.read_text(encoding="utf-8").partition(MARK)
        kept = mark + below
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text.rstrip()}\n\n{kept or MARK + chr(10)}", encoding="utf-8")
