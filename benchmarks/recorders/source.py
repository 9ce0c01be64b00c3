"""What is to be recorded, when it comes, and what was read back: the same for every recorder."""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

RATE_HZ = 1000
CHANNELS = [f"channel_{k}" for k in range(8)]
BLOCK = 50
TABLE = np.random.default_rng(8).normal(0.0, 100.0, (1000, len(CHANNELS)))
LISTS = TABLE.tolist()


def blocks(job: dict[str, Any], rows: int = BLOCK) -> Iterator[tuple[int, np.ndarray]]:
    """(number of the first row, (rows, 8) float64): flat out, or as 1 kHz brings them."""
    for first in _times(job, rows):
        at = first % len(TABLE)
        yield first, TABLE[at : at + rows]


def rows(job: dict[str, Any]) -> Iterator[tuple[int, list[float]]]:
    """(number of the row, eight floats), likewise."""
    for number in _times(job, 1):
        yield number, LISTS[number % len(LISTS)]


def _times(job: dict[str, Any], step: int) -> Iterator[int]:
    if job["mode"] == "flat":
        end = time.perf_counter() + job["seconds"]
        number = 0
        while time.perf_counter() < end:
            yield number
            number += step
        return
    with open(Path(job["folder"]) / "given", "w+b") as file:
        file.write(bytes(8))
        file.flush()
        given = mmap.mmap(file.fileno(), 8)  # outlives the process
    begin_ns = time.monotonic_ns()
    partial = Path(job["folder"]) / "started.partial"
    partial.write_text(str(begin_ns))
    partial.rename(partial.with_name("started"))
    for number in range(0, round(job["seconds"] * RATE_HZ), step):
        due = begin_ns * 1e-9 + (number + step) / RATE_HZ
        while (left := due - time.monotonic()) > 0:
            time.sleep(left)
        yield number
        struct.pack_into("<q", given, 0, number + step)  # the tool has asked for more


@contextlib.contextmanager
def synced(path: Callable[[], Path | None], on: bool) -> Iterator[None]:
    """What a careful user adds to a tool that leaves its file to the system: fsync each second."""
    if not on:
        yield
        return
    done = threading.Event()

    def sync() -> None:
        found = path()
        if found is not None and found.exists():
            fd = os.open(found, os.O_RDONLY)
            os.fsync(fd)
            os.close(fd)

    def loop() -> None:
        while not done.wait(1.0):
            sync()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        sync()


def checked(numbers: np.ndarray, channels: np.ndarray) -> dict[str, int]:
    """How many rows came back from the first on, and how many do not hold what was given."""
    numbers = np.asarray(numbers, dtype=np.int64)
    order = np.argsort(numbers, kind="stable")
    numbers, channels = numbers[order], np.asarray(channels, dtype=float)[order]
    # QCoDeS keeps 15 digits of a plain number.
    wrong = ~np.all(np.isclose(channels, TABLE[numbers % len(TABLE)], rtol=1e-12, atol=0.0), axis=1)
    wrong |= numbers != np.arange(len(numbers))
    return {"rows": len(numbers), "wrong": int(wrong.sum())}


def serve(
    record: Callable[[dict[str, Any]], int],
    read: Callable[[dict[str, Any]], dict[str, int]],
    version: str,
) -> None:
    """Answer jobs until standard input ends."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a tool prints must not come between
    out.write(json.dumps({"version": version}) + "\n")
    out.flush()
    for line in sys.stdin:
        job = json.loads(line)
        if job["mode"] == "read":
            answer: dict[str, Any] = read(job)
        elif job["mode"] == "fork":  # to be killed: in a process of its own, imports done
            pid = os.fork()
            if not pid:
                record({**job, "mode": "paced"})
                os._exit(0)
            answer = {"pid": pid}
        elif job["mode"] == "reap":
            os.waitpid(job["pid"], 0)
            answer = {}
        else:
            wall, cpu = time.perf_counter(), time.process_time()
            count = record(job)
            answer = {
                "rows": count,
                "wall_s": time.perf_counter() - wall,
                "cpu_s": time.process_time() - cpu,
            }
        out.write(json.dumps(answer) + "\n")
        out.flush()
