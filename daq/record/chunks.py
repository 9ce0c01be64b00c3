"""Appended files of chunks, whose every byte an index line vouches for.

A bulk file (Arrow segment, JPEG string, wire dump) is a string of *chunks*. Each chunk
is written first, then its line in the index beside it: file, offset, length, CRC-32.
Bytes that no sound line covers are never read as data.
"""

from __future__ import annotations

import contextlib
import json
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.sealed import plain, read_lines, seal_text
from daq.record.within import LARGEST_BULK, LARGEST_INDEX, path_inside, read_inside


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
        data = read_inside(self.root, self.index, LARGEST_INDEX)
        expected = 0
        for line in read_lines(data):
            last = line.offset + len(line.raw) == len(data)
            if line.fields is None:
                torn = last and not line.raw.endswith(b"\n")
                what = "last line is torn" if torn else "line does not match its CRC"
                self.problems.append(Problem(self.index, line.offset, what, len(line.raw), torn))
                continue
            fields = dict(line.fields)
            try:
                n = _count(fields.pop("n"))
                entry = _entry(n, fields) if n else None
            except (KeyError, ValueError):
                what = "line is sealed, but says no place in a file"
                self.problems.append(Problem(self.index, line.offset, what, len(line.raw)))
                continue
            if n != expected:
                what = f"lines {expected} to {n - 1} are missing or damaged"
                self.problems.append(Problem(self.index, line.offset, what, len(line.raw)))
            expected = n + 1
            if entry is None:
                self.head = fields
            else:
                self.entries.append(entry)

    def sound(self) -> Iterator[tuple[bytes, list[Entry]]]:
        """File by file: its bytes and the chunks in it that match their lines.

        Whatever does not goes to ``problems``: chunks damaged or cut short, bytes between
        and after chunks, missing files, files that are come back to.
        """
        seen: set[str] = set()
        for file, entries in groupby(self.entries, key=lambda entry: entry.file):
            if file in seen:
                self.problems.append(Problem(file, 0, "its chunks are not in order, not read"))
                continue
            seen.add(file)
            try:
                data = read_inside(self.root, file, LARGEST_BULK)
            except RecordError as error:
                self.problems.append(Problem(file, 0, error.what))
                continue
            yield data, list(self._sound_chunks(file, data, entries))

    def possible(self) -> Iterator[Entry]:
        """Entries whose chunks can be there: within their file, in order, none upon another.

        What is set aside for the rows of these is bounded by the bytes that there are.
        """
        ends: dict[str, int] = {}
        sizes: dict[str, int] = {}
        for entry in self.entries:
            if entry.file not in sizes:
                sizes[entry.file] = ends[entry.file] = 0
                with contextlib.suppress(OSError, RecordError):
                    sizes[entry.file] = path_inside(self.root, entry.file).stat().st_size
            end = entry.offset + entry.length
            if ends[entry.file] <= entry.offset and end <= sizes[entry.file]:
                ends[entry.file] = end
                yield entry

    def _sound_chunks(self, file: str, data: bytes, entries: Iterable[Entry]) -> Iterator[Entry]:
        view = memoryview(data)
        end = 0
        for entry in entries:
            offset, length = entry.offset, entry.length
            if offset < end:
                what = f"chunk {entry.n} lies upon the one before it, not read"
                self.problems.append(Problem(file, offset, what, length))
                continue
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


def _entry(n: int, fields: dict[str, Any]) -> Entry:
    """An index line's own members, and what else it says."""
    file, crc32 = fields.pop("file"), fields.pop("crc32")
    if not isinstance(file, str) or not isinstance(crc32, str):
        raise ValueError("names no file")
    return Entry(n, file, _count(fields.pop("offset")), _count(fields.pop("length")), crc32, fields)


def _count(value: Any) -> int:
    """A whole number from 0 that a file can have."""
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"{value!r} is no count")
    return value


def only_possible_rows(index: ChunkIndex, row_bytes: int = 1) -> None:
    """Leave out lines that claim rows which their bytes cannot hold; each is a problem."""
    kept = []
    for entry in index.entries:
        rows, first = entry.fields.get("rows", 0), entry.fields.get("first_row", 0)
        says = entry.fields.get("chunk") != "rows" or {"rows", "first_row"} <= set(entry.fields)
        counts = says and type(rows) is int and type(first) is int and 0 <= first < 2**62
        if counts and 0 <= rows * max(row_bytes, 1) <= entry.length:
            kept.append(entry)
            continue
        what = f"chunk {entry.n} claims {rows!r} rows from {first!r} on in {entry.length} bytes"
        index.problems.append(Problem(index.index, 0, f"{what}, not read", entry.length))
    index.entries = kept
