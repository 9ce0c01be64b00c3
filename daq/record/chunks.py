"""Bulk files of checksummed chunks and their index files.

A bulk file (Arrow segment, JPEG sequence, wire dump) is a sequence of *chunks*. The writer
appends each chunk first, then a line in the index: file, offset, length, CRC-32. Bytes without
a valid index line are never read as data.
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
from daq.record.safe_read import LARGEST_BULK, LARGEST_INDEX, read_inside, size_inside
from daq.record.sealed import plain, read_lines, seal_text


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
    """One valid index line: a chunk and its position."""

    n: int
    file: str
    offset: int
    length: int
    crc32: str
    fields: dict[str, Any]


@dataclass(frozen=True)
class Problem:
    """Damaged bytes, or bytes without an entry in the record.

    Attributes:
        file: path within the run folder.
        offset: first damaged byte (0 if the whole file is affected).
        what: the expected and the actual state.
        length: number of affected bytes.
        tail: True for bytes that a kill or a power cut left unfinished: not damaged.
    """

    file: str
    offset: int
    what: str
    length: int = 0
    tail: bool = False

    def __str__(self) -> str:
        return f"{self.file}, byte {self.offset}: {self.what}"


def unwritten(file: str, data: bytes, begin: int, end: int) -> list[Problem]:
    """Damage in a part of a file that holds nothing but zeros."""
    rest = data[begin:end].lstrip(b"\0")
    if not rest:
        return []
    at = min(end, len(data)) - len(rest)
    return [Problem(file, at, "bytes where none were written", len(rest.rstrip(b"\0")))]


class ChunkIndex:
    """An index file and the bulk files it lists; every value is checked before use.

    Attributes:
        head: members of the first line (None if missing or damaged).
        entries: valid lines in file order.
        problems: damaged lines and missing line numbers; :meth:`valid_chunks` adds to them.
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
            length = len(line.raw)
            if line.fields is None:
                what = "last line is torn" if line.torn else "line does not match its CRC"
                self.problems.append(Problem(self.index, line.offset, what, length, line.torn))
                continue
            fields = dict(line.fields)
            try:
                n = _count(fields.pop("n"))
                entry = _entry(n, fields) if n else None
            except (KeyError, ValueError):
                what = "the CRC of the line is correct, but it is not an index line"
                self.problems.append(Problem(self.index, line.offset, what, length))
                continue
            if n != expected:
                what = f"lines {expected} to {n - 1} are missing or damaged"
                self.problems.append(Problem(self.index, line.offset, what, length))
            expected = n + 1
            if entry is None:
                self.head = fields
            else:
                self.entries.append(entry)

    def valid_chunks(self) -> Iterator[tuple[bytes, list[Entry]]]:
        """File by file: its bytes and those chunks that match their index lines.

        All else is added to ``problems``: damaged or truncated chunks, bytes between and after
        chunks, missing files, chunks out of order.
        """
        seen: set[str] = set()
        for file, entries in groupby(self.entries, key=lambda entry: entry.file):
            if file in seen:
                self.problems.append(Problem(file, 0, "its chunks are out of order, not read"))
                continue
            seen.add(file)
            try:
                data = read_inside(self.root, file, LARGEST_BULK)
            except RecordError as error:
                self.problems.append(Problem(file, 0, error.what))
                continue
            yield data, list(self._valid_chunks(file, data, entries))

    def plausible(self) -> Iterator[Entry]:
        """Entries whose chunks lie within their file, in order and without overlap.

        The existing bytes therefore limit the memory that their rows can request.
        """
        ends: dict[str, int] = {}
        sizes: dict[str, int] = {}
        for entry in self.entries:
            if entry.file not in sizes:
                sizes[entry.file] = ends[entry.file] = 0
                with contextlib.suppress(RecordError):
                    sizes[entry.file] = size_inside(self.root, entry.file)
            end = entry.offset + entry.length
            if ends[entry.file] <= entry.offset and end <= sizes[entry.file]:
                ends[entry.file] = end
                yield entry

    def _valid_chunks(self, file: str, data: bytes, entries: Iterable[Entry]) -> Iterator[Entry]:
        view = memoryview(data)
        end = 0
        for entry in entries:
            offset, length = entry.offset, entry.length
            if offset < end:
                what = f"chunk {entry.n} overlaps the one before it, not read"
                self.problems.append(Problem(file, offset, what, length))
                continue
            if offset > end:
                what = "bytes without a valid index line, not read"
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
            what = "bytes at the end without an index line, not read"
            self.problems.append(Problem(file, end, what, len(data) - end, tail=True))


def _entry(n: int, fields: dict[str, Any]) -> Entry:
    file, crc32 = fields.pop("file"), fields.pop("crc32")
    if not isinstance(file, str) or not isinstance(crc32, str):
        raise ValueError("file and crc32 must be text")
    return Entry(n, file, _count(fields.pop("offset")), _count(fields.pop("length")), crc32, fields)


def _count(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"{value!r} is not a count")
    return value


def drop_implausible_rows(index: ChunkIndex, row_bytes: int = 1) -> None:
    """Drop index lines that claim more rows than their bytes can hold; each is a problem."""
    kept = []
    for entry in index.entries:
        rows, first = entry.fields.get("rows", 0), entry.fields.get("first_row", 0)
        named = entry.fields.get("chunk") != "rows" or {"rows", "first_row"} <= set(entry.fields)
        counts = named and type(rows) is int and type(first) is int and 0 <= first < 2**62
        if counts and 0 <= rows * max(row_bytes, 1) <= entry.length:
            kept.append(entry)
            continue
        what = f"chunk {entry.n} claims {rows!r} rows from {first!r} on in {entry.length} bytes"
        index.problems.append(Problem(index.index, 0, f"{what}, not read", entry.length))
    index.entries = kept
