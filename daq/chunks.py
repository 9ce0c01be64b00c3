"""Appended files of chunks, whose every byte an index line vouches for.

A bulk file (Arrow segment, JPEG string, wire dump) is a string of *chunks*. Each chunk
is written first, then its line in the index beside it: file, offset, length, CRC-32.
Bytes that no sound line covers are never read as data.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from daq.sealed import plain, read_lines, seal_text


def index_line(n: int, file: str, offset: int, data: bytes, fields: str = "") -> bytes:
    """A sealed index line; ``fields`` is further JSON members as text, ``"rows":50``."""
    more = "," + fields if fields else ""
    return seal_text(
        f'{{"n":{n},"file":"{file}","offset":{offset},"length":{len(data)},'
        f'"crc32":"{zlib.crc32(data):08x}"{more}'
    )


def members(fields: dict[str, Any]) -> str:
    """JSON members as text for :func:`index_line`."""
    return json.dumps(plain(fields), separators=(",", ":"), ensure_ascii=False)[1:-1]


@dataclass(slots=True)
class Entry:
    """One sound index line: a chunk and where it lies."""

    n: int
    file: str
    offset: int
    length: int
    crc32: str
    fields: dict[str, Any]


@dataclass(frozen=True)
class Problem:
    """Bytes that are not what was written, or that nothing vouches for.

    Attributes:
        file: path within the run folder.
        offset: where in it the damage begins (0 if the whole file is meant).
        what: what was expected and what is there.
        length: how many bytes are concerned.
        tail: True for what a kill or a power cut leaves behind: unfinished, not damaged.
    """

    file: str
    offset: int
    what: str
    length: int = 0
    tail: bool = False

    def __str__(self) -> str:
        return f"{self.file}, byte {self.offset}: {self.what}"


class ChunkIndex:
    """An index file and the bulk files it vouches for, read with suspicion.

    Attributes:
        head: the members of the opening line (None if there is none or it is damaged).
        entries: sound lines in file order.
        problems: damaged index lines and missing numbers; :meth:`sound` adds to them.
    """

    def __init__(self, root: Path, index: str) -> None:
        self.root = root
        self.index = index
        self.head: dict[str, Any] | None = None
        self.entries: list[Entry] = []
        self.problems: list[Problem] = []
        self._read()

    def _read(self) -> None:
        data = (self.root / self.index).read_bytes()
        expected = 0
        for line in read_lines(data):
            last = line.offset + len(line.raw) == len(data)
            if line.fields is None:
                torn = last and not line.raw.endswith(b"\n")
                what = "last line is torn" if torn else "line does not match its CRC"
                self.problems.append(Problem(self.index, line.offset, what, len(line.raw), torn))
                continue
            fields = dict(line.fields)
            n = int(fields.pop("n"))
            if n != expected:
                what = f"lines {expected} to {n - 1} are missing or damaged"
                self.problems.append(Problem(self.index, line.offset, what, len(line.raw)))
            expected = n + 1
            if n == 0:
                self.head = fields
                continue
            self.entries.append(
                Entry(
                    n,
                    str(fields.pop("file")),
                    int(fields.pop("offset")),
                    int(fields.pop("length")),
                    str(fields.pop("crc32")),
                    fields,
                )
            )

    def sound(self) -> Iterator[tuple[bytes, list[Entry]]]:
        """File by file: its bytes and the chunks in it that match their lines.

        Whatever does not goes to ``problems``: chunks damaged or cut short, bytes between
        and after chunks, missing files.
        """
        for file, entries in groupby(self.entries, key=lambda entry: entry.file):
            try:
                data = (self.root / file).read_bytes()
            except OSError as error:
                self.problems.append(Problem(file, 0, f"cannot be read: {error.strerror}"))
                continue
            yield data, list(self._sound_chunks(file, data, entries))

    def _sound_chunks(self, file: str, data: bytes, entries: Iterable[Entry]) -> Iterator[Entry]:
        view = memoryview(data)
        end = 0
        for entry in entries:
            offset, length = entry.offset, entry.length
            if offset > end:
                what = "bytes that no sound index line covers, not read"
                self.problems.append(Problem(file, end, what, offset - end))
            end = offset + length
            chunk = view[offset:end]
            if len(chunk) < length:
                what = f"chunk {entry.n} has {len(chunk)} of {length} bytes, not read"
                self.problems.append(Problem(file, offset, what, len(chunk), tail=True))
            elif f"{zlib.crc32(chunk):08x}" != entry.crc32:
                what = f"chunk {entry.n} does not match its CRC, not read"
                self.problems.append(Problem(file, offset, what, length))
            else:
                yield entry
        if len(data) > end:
            what = "bytes at the end that no index line covers, not read"
            self.problems.append(Problem(file, end, what, len(data) - end, tail=True))
