"""Positions of the pages of a TIFF and the memory that reading one needs, from its tags alone.

TIFF 6.0 (Adobe, 1992) and BigTIFF. A decoder allocates strips and tiles as a whole, and a tile
may be much larger than its picture.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_PAGES = 10_000
MOST_TAGS = 4096
WIDTH, HEIGHT, BITS, SAMPLES, ROWS, TILE_WIDTH, TILE_HEIGHT = 256, 257, 258, 277, 278, 322, 323
WHOLE = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 16: "Q", 17: "q"}
"""Integer types, as `struct` format characters."""


class Page(NamedTuple):
    """A page: position of its tags, and decoded size of one strip or tile, bytes."""

    at: int
    strip_bytes: int


class _Form(NamedTuple):
    """Byte order; format of an offset and of a tag count; bytes per tag and per value."""

    order: str
    offset: str
    number: str
    tag: int
    value: int

    @property
    def first(self) -> int:
        """Position of the offset of the first page: 4, or 8 with 64-bit offsets."""
        return self.value


def _form(data: memoryview) -> _Form:
    order = "<" if data[0] == ord("I") else ">"
    big = ord("+") in data[2:4]
    return _Form(order, "Q", "Q", 20, 8) if big else _Form(order, "I", "H", 12, 4)


def pages(data: memoryview) -> Iterator[Page]:
    """The pages of a TIFF in order, up to the first one with damaged tags."""
    if not data[:4].tobytes().startswith(SIGNATURES):
        return
    form = _form(data)
    seen: set[int] = set()
    try:
        (at,) = struct.unpack_from(form.order + form.offset, data, form.first)
        while at and at not in seen and len(seen) < MOST_PAGES:
            seen.add(at)
            (count,) = struct.unpack_from(form.order + form.number, data, at)
            if count > MOST_TAGS:
                return
            begin = at + struct.calcsize(form.order + form.number)
            end = begin + count * form.tag
            tags: dict[int, int] = {}
            for place in range(begin, end, form.tag):
                tag, value = _tag(data, form, place)
                tags[tag] = max(value, tags.get(tag, 0))  # of a repeated tag, the larger value
            yield Page(at, _strip_bytes(tags))
            (at,) = struct.unpack_from(form.order + form.offset, data, end)
    except (struct.error, OverflowError):  # an offset beyond the end of the file
        return


def set_first_page(data: memoryview, at: int) -> None:
    """Make the page whose tags start at ``at`` the first page of ``data``."""
    form = _form(data)
    struct.pack_into(form.order + form.offset, data, form.first, at)


def _tag(data: memoryview, form: _Form, at: int) -> tuple[int, int]:
    """Number and first value of a tag; 0 if it is not an integer."""
    tag, kind, count = struct.unpack_from(f"{form.order}HH{form.offset}", data, at)
    if kind not in WHOLE:
        return tag, 0
    at += form.tag - form.value
    if count * struct.calcsize(form.order + WHOLE[kind]) > form.value:
        (at,) = struct.unpack_from(form.order + form.offset, data, at)
    return tag, abs(struct.unpack_from(form.order + WHOLE[kind], data, at)[0])


def _strip_bytes(tags: dict[int, int]) -> int:
    """Decoded bytes of one strip or tile, at least four per pixel for conversion to colour."""
    width, height = tags.get(WIDTH, 0), tags.get(HEIGHT, 0)
    height = min(height, tags.get(ROWS) or height)
    if TILE_WIDTH in tags or TILE_HEIGHT in tags:
        width, height = tags.get(TILE_WIDTH) or width, tags.get(TILE_HEIGHT) or height
    return width * height * max(4, tags.get(SAMPLES, 1) * tags.get(BITS, 1) // 8)
