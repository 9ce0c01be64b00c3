"""Make the reference pages anew: ``python -m docs.make``."""

from __future__ import annotations

from collections.abc import Callable

from docs.make import commands, files, python_page

GENERATORS: tuple[Callable[[], None], ...] = (files.main, python_page.main, commands.main)
"""Each writes one page."""

if __name__ == "__main__":
    for generator in GENERATORS:
        generator()
