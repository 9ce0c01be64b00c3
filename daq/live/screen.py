"""The viewer's process: draws what a test sends through a pipe, and serves it to browsers.

`daq.live.live` starts it. It reads messages on its standard input (`daq.live.pipe`) and writes
lines of JSON to its standard output: where it serves, and how many viewers are connected. It ends
when its input ends, so it cannot outlive the test.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any, BinaryIO, TextIO

import numpy as np

from daq.live.decimate import Thinner, decimate_steps
from daq.live.door import Door
from daq.live.history import History
from daq.live.layout import LiveLayout
from daq.live.page import PageFile, page_files
from daq.live.pipe import Floats, Message, Numbers, layout_from, unpack
from daq.live.scene import APPLICATION, Scene

PERIOD_S = 0.05  # drawing period
BIN_S = 0.02  # min/max envelope: at most 100 points per second
IDLE_FLUSH_S = 0.2  # an incomplete bin is drawn after this time without data
READOUT_S = 0.25
HOLD_BEHIND_S = 0.25
LAST_DATA_S = 1.5
NICENESS = 10  # acquisition goes first

_log = logging.getLogger(__name__)


class Screen:
    """Draws items into a recording and hands its bytes to ``history``."""

    def __init__(self, run_id: str, layout: LiveLayout, history: History) -> None:
        # Rerun then logs errors as warnings and raises no exceptions.
        os.environ.setdefault("RERUN_STRICT", "0")
        import rerun as rr

        self._rec = rr.RecordingStream(APPLICATION, recording_id=run_id)
        self._bytes = self._rec.binary_stream()
        self._layout = layout
        self._history = history
        self._scene = Scene(self._rec, layout, live=True)
        self._scene.start()
        self._thinners: dict[str, tuple[Thinner, float]] = {}
        self._next_readout = 0.0
        self._news = False
        self._dropped = self._rejected = 0
        self._pass_on()

    def draw(self, message: Message | None, last: bool = False) -> None:
        """Draw a message, and what has waited long enough; ``last`` draws everything."""
        drawn = False
        if message is not None:
            words, data = message
            self._dropped = int(words["dropped"])
            drawn = self._items(words["items"], Numbers(data))
        now = time.monotonic()
        for path, (thinner, fed_at) in list(self._thinners.items()):
            if thinner.waiting and (last or now - fed_at > IDLE_FLUSH_S):
                self._try(self._scene.series, path, *thinner.flush())
                drawn = True
        self._news = self._news or drawn
        if self._news and (now >= self._next_readout or last):
            self._news = False
            self._next_readout = now + READOUT_S
            dropped = self._dropped + self._rejected
            note = f"{dropped} items not shown (the viewer was slow)" if dropped else ""
            self._try(self._scene.hold_steps, 0.0 if last else HOLD_BEHIND_S)
            self._try(self._scene.readout, note)
            drawn = True
        if drawn:
            self._pass_on()

    def _pass_on(self) -> None:
        self._history.add(self._bytes.read(flush=True) or b"")

    def _items(self, items: list[list[Any]], numbers: Numbers) -> bool:
        scene = self._scene
        for kind, path, *rest in items:
            if kind == "series":
                n = rest[0]
                time_s, values = numbers.floats(n), numbers.floats(n)
                self._try(self._curve, path, time_s, values)
            elif kind == "points":
                when, label, n = rest
                x, y = numbers.floats(n), numbers.floats(n)
                at_s = scene.newest_s if when is None else when
                self._try(scene.points, path, at_s, label, x, y)
            elif kind == "image":
                time_s, lines, size = rest
                lines = [(tuple(a), tuple(b), text) for a, b, text in lines]
                self._try(scene.image, path, time_s, numbers.take(size), lines)
            elif kind == "status":
                self._try(scene.status, path, *rest)
            elif kind == "state":
                self._try(scene.state, path, *rest)
            else:
                self._try(scene.text, path, *rest)
        return bool(items)

    def _try(self, call: Any, *args: Any) -> None:
        try:
            call(*args)
        except Exception as error:  # an invalid item must not end the view
            self._rejected += 1
            _log.debug("live view rejected an item: %s", error)

    def _curve(self, path: str, time_s: Floats, values: Floats) -> None:
        channel, scene = self._layout.channels.get(path), self._scene
        if channel is not None and channel.step:
            # Draw the changes only, and at once; ``hold_steps`` extends the last value.
            known = np.concatenate(([scene.newest.get(path, np.nan)], values[:-1]))
            change = (values != known) & ~(np.isnan(values) & np.isnan(known))
            scene.series(path, *decimate_steps(time_s[change], values[change], BIN_S))
            return
        if path not in self._thinners:
            reduce = channel.reduce if channel else "minmax"
            bin_s = BIN_S if reduce == "minmax" else BIN_S / 2.0
            self._thinners[path] = (Thinner(bin_s, reduce), 0.0)
        thinner = self._thinners[path][0]
        self._thinners[path] = (thinner, time.monotonic())
        scene.series(path, *thinner.feed(time_s, values))


def serve(pipe: BinaryIO, out: TextIO) -> int:
    """Open the view that the first message describes and draw all others; the exit status."""

    def report(**words: Any) -> None:
        with contextlib.suppress(OSError):
            print(json.dumps(words), file=out, flush=True)

    begin = unpack(pipe)
    if begin is None:
        return 1
    given = begin[0]
    history = History(int(given["memory"]))
    files: dict[str, PageFile] = {}
    page_error = ""
    try:
        with ThreadPoolExecutor(1) as beside:
            page = beside.submit(page_files) if given["page"] else None
            screen = Screen(given["run_id"], layout_from(given["layout"]), history)
            try:
                files = page.result() if page is not None else {}
            except Exception as error:  # the viewer's own program can still read the data
                page_error = str(error)
        door = Door(history, files, int(given["port"]))
    except Exception as error:
        report(error=f"{type(error).__name__}: {error}")
        return 1
    report(url=door.url, data_url=door.data_url, port=door.port, page_error=page_error)
    try:
        _follow(pipe, screen, door, report)
    finally:
        history.end()
        end = time.monotonic() + LAST_DATA_S
        while door.viewers and time.monotonic() < end:
            time.sleep(PERIOD_S)
        door.close()
    return 0


def _follow(pipe: BinaryIO, screen: Screen, door: Door, report: Any) -> None:
    """Draw until the pipe ends. Few messages wait here: if drawing is slow, the test drops."""
    waiting: queue.Queue[Message | None] = queue.Queue(maxsize=4)

    def read() -> None:
        while (message := unpack(pipe)) is not None:
            waiting.put(message)
        waiting.put(None)

    threading.Thread(target=read, name="pipe", daemon=True).start()
    viewers = 0
    while True:
        message: Message | None = None
        try:
            message = waiting.get(timeout=PERIOD_S)
            if message is None:
                screen.draw(None, last=True)
                return
        except queue.Empty:
            pass
        screen.draw(message)
        if door.viewers != viewers:
            viewers = door.viewers
            report(viewers=viewers)


def main() -> int:
    """Serve on the pipes that the test has opened; nothing else writes to them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the test, which ends this process
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(NICENESS)
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    with open(os.devnull, "w") as nothing:
        os.dup2(nothing.fileno(), 1)
    return serve(sys.stdin.buffer, out)


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)  # threads that read or draw do not hold it up
