"""The contents of the site from docs/README.md, and the folders that pages link to."""

from __future__ import annotations

import html
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FRONT = "README"
EXAMPLES = "examples"
PAGES = (".md", ".ipynb")
_HEADING = re.compile(r"^## (.+)$")
_ROW = re.compile(r"^\| \[[^\]]+\]\(([^)#]+)\)")
_LINK = re.compile(r"\[([^\]]+)\]\((?!https?:|#|mailto:)([^)#\s]+)\)")
_LISTING = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 sans-serif; max-width: 40em; margin: 2em auto; padding: 0 1em }}
body {{ overflow-wrap: anywhere }}
</style>
<h1>{title}</h1>
<ul>
{rows}
</ul>
</body>
</html>
"""


def sections(text: str) -> Iterator[tuple[str, list[str]]]:
    """Heading and pages of each table of the front page."""
    title, pages = "", list[str]()
    for line in text.splitlines():
        heading, row = _HEADING.match(line), _ROW.match(line)
        if heading:
            if pages:
                yield title, pages
            title, pages = heading[1], []
        elif row and row[1].endswith(PAGES):
            pages.append(row[1])
    if pages:
        yield title, pages


def navigation(app: Any, page: str, source: list[str]) -> None:
    """Give the front page the contents for the sidebar, and links to folders a target."""
    if page.startswith("tutorials/"):
        return  # JSON of a notebook
    folder = Path(app.srcdir, page).parent
    text = _LINK.sub(lambda found: _to_folder(folder, found), source[0])
    if page == FRONT:
        text += "".join(
            f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{chr(10).join(pages)}\n```\n"
            for title, pages in sections(source[0])
        )
    source[0] = text


def _to_folder(folder: Path, found: re.Match[str]) -> str:
    """A link to a folder leads to a listing of its files, which `listings` writes."""
    if not (folder / found[2]).is_dir():
        return found[0]
    return f'<a href="{found[2].rstrip("/")}/index.html">{html.escape(found[1])}</a>'


def listings(app: Any, error: Exception | None) -> None:
    """Add index.html and the examples, each folder with a list of its files."""
    if error is not None:
        return
    front = f'<!doctype html><meta http-equiv="refresh" content="0; url={FRONT}.html">\n'
    Path(app.outdir, "index.html").write_text(front, "utf-8")
    target = Path(app.outdir, EXAMPLES)
    shutil.rmtree(target, ignore_errors=True)
    kept = shutil.ignore_patterns("__pycache__", "*.pyc")
    shutil.copytree(Path(app.srcdir, EXAMPLES), target, ignore=kept)
    for folder in [target, *(path for path in target.rglob("*") if path.is_dir())]:
        rows = "\n".join(
            f'<li><a href="{entry.name}{"/index.html" if entry.is_dir() else ""}">{entry.name}</a>'
            for entry in sorted(folder.iterdir())
        )
        title = html.escape(folder.relative_to(Path(app.outdir)).as_posix())
        page = _LISTING.format(title=title, rows=rows)
        (folder / "index.html").write_text(page, "utf-8")
