"""What a test sends to the viewer's process, and its form in the pipe between them.

A message is eight bytes of two sizes, a JSON text and the bytes of its numbers and pictures. The
first message describes the view; each later one holds all items of one drawing period.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from daq.live.layout import Axis, Channel, LiveLayout, Panel
from daq.live.queue import Item

Floats = npt.NDArray[np.float64]
Message = tuple[dict[str, Any], bytes]
_SIZES = struct.Struct("<II")


def pack(words: dict[str, Any], data: Iterable[bytes] = ()) -> bytes:
    """One message, ready to be written."""
    text, joined = json.dumps(words).encode(), b"".join(data)
    return _SIZES.pack(len(text), len(joined)) + text + joined


def unpack(pipe: BinaryIO) -> Message | None:
    """The next message; None when the other side has closed the pipe, also in mid-message."""
    head = pipe.read(_SIZES.size)
    if len(head) < _SIZES.size:
        return None
    sizes = _SIZES.unpack(head)
    body = pipe.read(sum(sizes))
    if len(body) < sum(sizes):
        return None
    return json.loads(body[: sizes[0]]), body[sizes[0] :]


def items_message(
    bulk: list[Item], pictures: list[Item], events: list[Item], dropped: int
) -> bytes:
    """The items of one drawing period as a message; pieces of the same curve are joined."""
    curves: dict[str, list[Item]] = {}
    for item in bulk:
        curves.setdefault(item[0], []).append(item)
    items: list[list[Any]] = []
    data: list[bytes] = []
    for path, pieces in curves.items():
        time_s, values = (np.concatenate([p[k] for p in pieces]) for k in (1, 2))
        items.append(["series", path, len(time_s)])
        data += [time_s.tobytes(), values.tobytes()]
    for kind, path, time_s, *rest in events:
        if kind == "points":
            label, x, y = rest
            items.append([kind, path, time_s, label, len(x)])
            data += [x.tobytes(), y.tobytes()]
        else:
            items.append([kind, path, time_s, *rest])
    for path, time_s, jpeg, lines in pictures:
        items.append(["image", path, time_s, lines, len(jpeg)])
        data.append(jpeg)
    return pack({"items": items, "dropped": dropped}, data)


class Numbers:
    """Takes arrays and pictures from the bytes of a message, in their order."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes."""
        part = self._data[self._at : self._at + size]
        self._at += size
        return part

    def floats(self, n: int) -> Floats:
        """The next ``n`` numbers."""
        return np.frombuffer(self.take(8 * n), dtype=np.float64)


def layout_words(layout: LiveLayout) -> dict[str, Any]:
    """What is drawn of a layout, as JSON holds it; its sources in the record stay behind."""
    return {
        "title": layout.title,
        "columns": [
            [[asdict(p) for p in (entry if isinstance(entry, tuple) else (entry,))] for entry in c]
            for c in layout.columns
        ],
        "shares": layout.shares,
        "window_s": layout.window_s,
        "camera": layout.camera,
    }


def layout_from(words: dict[str, Any]) -> LiveLayout:
    """The layout that :func:`layout_words` wrote down."""
    columns = []
    for column in words["columns"]:
        rows: list[Panel | tuple[Panel, ...]] = []
        for entry in column:
            panels = tuple(_panel(panel) for panel in entry)
            rows.append(panels[0] if len(panels) == 1 else panels)
        columns.append(tuple(rows))
    return LiveLayout(
        words["title"],
        tuple(columns),
        tuple(words["shares"]),
        words["window_s"],
        camera=words["camera"],
    )


def _panel(words: dict[str, Any]) -> Panel:
    channels = tuple(
        Channel(**{**c, "colour": tuple(c["colour"]) if c["colour"] else None})
        for c in words["channels"]
    )
    return Panel(
        **{
            **words,
            "channels": channels,
            "y_range": tuple(words["y_range"]) if words["y_range"] else None,
            "x_axis": Axis(**words["x_axis"]) if words["x_axis"] else None,
            "y_axis": Axis(**words["y_axis"]) if words["y_axis"] else None,
            "state_colours": tuple((t, tuple(c)) for t, c in words["state_colours"]),
        }
    )
