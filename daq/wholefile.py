"""Files that take their names only when they are whole.

An interrupted command (Ctrl-C, a full disk, an error) leaves what stood there before, or nothing,
and never half a file.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path


@contextlib.contextmanager
def whole_files() -> Iterator[Callable[[Path], Path]]:
    """Files that take their names together when the block ends without an error.

        with whole_files() as part:
            part(folder / "a.csv").write_text("...")

    The function gives the path to write to: beside the file, with the ending ``.partial``. What
    exists and is no file, such as a pipe, is written directly.

    Raises:
        OSError: a file cannot be written.
    """
    parts: dict[Path, Path] = {}

    def part(path: Path) -> Path:
        if path.exists() and not path.is_file():
            return path
        parts[path] = path.with_name(path.name + ".partial")
        return parts[path]

    try:
        yield part
        for path, partial in parts.items():
            os.replace(partial, path)
    finally:
        for partial in parts.values():
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all; text in UTF-8, with its line ends as they are.

    Raises:
        OSError: it cannot be written.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    with whole_files() as part:
        part(path).write_bytes(data)
