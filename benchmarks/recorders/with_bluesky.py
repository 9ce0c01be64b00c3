"""Bluesky: a RunEngine whose documents its own JSONLinesWriter writes.

By default one event a row, as ``trigger_and_read`` gives; else a flyer that hands over pages of 50
rows, the form Bluesky has for data that come fast.
"""

from __future__ import annotations

import importlib.metadata
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bluesky.plan_stubs as bps
import event_model
import numpy as np
from bluesky import RunEngine
from bluesky.callbacks.json_writer import JSONLinesWriter
from source import BLOCK, CHANNELS, blocks, checked, rows, serve, synced

KEYS = {
    "row": {"source": "bench", "dtype": "integer", "shape": []},
    **{name: {"source": "bench", "dtype": "number", "shape": []} for name in CHANNELS},
}


class Device:
    """Eight channels and a counter, read row by row or collected in pages."""

    name = "bench"
    parent = None

    def __init__(self) -> None:
        self.now: Any = None

    def describe(self) -> dict[str, Any]:
        return KEYS

    describe_collect = describe

    def read(self) -> dict[str, Any]:
        number, values = self.now
        at = time.time()
        reading = {"row": {"value": number, "timestamp": at}}
        for name, value in zip(CHANNELS, values, strict=True):
            reading[name] = {"value": value, "timestamp": at}
        return reading

    def collect_pages(self) -> Iterator[dict[str, Any]]:
        first, block = self.now
        at = [time.time()] * BLOCK
        data: dict[str, Any] = {"row": list(range(first, first + BLOCK))}
        for k, name in enumerate(CHANNELS):
            data[name] = block[:, k].tolist()
        yield {"data": data, "timestamps": dict.fromkeys(data, at), "time": at, "filled": {}}

    def read_configuration(self) -> dict[str, Any]:
        return {}

    describe_configuration = read_configuration


def record(job: dict[str, Any]) -> int:
    device, count = Device(), 0

    def by_row() -> Iterator[Any]:
        nonlocal count
        yield from bps.open_run()
        for device.now in rows(job):
            yield from bps.create("primary")
            yield from bps.read(device)
            yield from bps.save()
            count = device.now[0] + 1
        yield from bps.close_run()

    def by_page() -> Iterator[Any]:
        nonlocal count
        yield from bps.open_run()
        yield from bps.declare_stream(device, name="primary", collect=True)
        for device.now in blocks(job):
            yield from bps.collect(device, name="primary")
            count = device.now[0] + BLOCK
        yield from bps.close_run()

    engine = RunEngine({})
    engine.subscribe(JSONLinesWriter(job["folder"], "bench.jsonl"))
    with synced(lambda: Path(job["folder"]) / "bench.jsonl", job["fsync"]):
        engine(by_page() if job["pages"] else by_row())
    return count


def read(job: dict[str, Any]) -> dict[str, int]:
    numbers: list[int] = []
    channels: list[list[float]] = []
    path = Path(job["folder"]) / "bench.jsonl"
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            document = json.loads(line)
        except json.JSONDecodeError:  # a torn last line
            break
        events = []
        if document["name"] == "event":
            events = [document["doc"]]
        elif document["name"] == "event_page":
            events = list(event_model.unpack_event_page(document["doc"]))
        for event in events:
            numbers.append(event["data"]["row"])
            channels.append([event["data"][name] for name in CHANNELS])
    return checked(np.array(numbers), np.array(channels).reshape(-1, len(CHANNELS)))


if __name__ == "__main__":
    serve(record, read, f"Bluesky {importlib.metadata.version('bluesky')}")
