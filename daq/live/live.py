"""The live view: a process of its own that draws and serves, fed through a pipe.

A viewer may be absent, suspended or killed, and what listens for viewers may be flooded. None of
this happens in the process of the test. Every method here puts an item into a bounded queue, which
drops its oldest items (``LiveView.dropped`` counts them), and one thread writes what waits to the
pipe of the viewer's process (`daq.live.screen`). If that process is slow, the thread waits and the
queue drops; if it has ended, the test goes on without a view.
"""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Concatenate, ParamSpec

import numpy as np

from daq.live.layout import LiveLayout
from daq.live.page import has_screen
from daq.live.pipe import Floats, items_message, layout_words, pack
from daq.live.queue import DropQueue
from daq.live.scene import Line

PERIOD_S = 0.05  # time between two messages
START_S = 60.0  # typically 2 s; loading Rerun takes longer on a busy machine
CLOSE_S = 4.0
PORT = 9876
MEMORY = 256_000_000

P = ParamSpec("P")
_log = logging.getLogger(__name__)


def _never_raises(
    put: Callable[Concatenate[LiveView, P], None],
) -> Callable[Concatenate[LiveView, P], None]:
    """Count an item as dropped if the view is closed or the item is invalid."""

    @functools.wraps(put)
    def call(view: LiveView, /, *args: P.args, **kwargs: P.kwargs) -> None:
        try:
            if view._closed or view.error is not None:
                view._queue.drop()
            else:
                put(view, *args, **kwargs)
        except Exception as error:
            view._queue.drop()
            _log.debug("live view rejected an item: %s", error)

    return call


def _vectors(path: str, first: Any, second: Any) -> tuple[Floats, Floats]:
    """Two arguments of equal length as arrays, (n,)."""
    a = np.array(first, dtype=np.float64, ndmin=1)
    b = np.array(second, dtype=np.float64, ndmin=1)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(f"{path}: {a.shape} and {b.shape} do not match")
    return a, b


class LiveView:
    """A window on a running test; the test never waits for it.

    No method raises. No method waits, except ``close`` (at most 6 s), ``wait_for_viewer`` and
    the constructor (starts the process, about 2 s; call it before arming). If the viewer cannot
    start, or when it has ended, ``error`` gives the reason and all later items are counted as
    dropped.

    Args:
        run_id: id of the recording; the name of the run folder.
        layout: panels, names, units and colours.
        port: on 127.0.0.1; if it is in use, another free one.
        open_browser: open the page in the default browser, if there is a screen.
        page: serve the page, not only the data for the viewer's own program.
        memory: bytes of data kept for viewers that connect later.
        queue: a queue with other limits than the default.

    Attributes:
        url: address of the page, with its token.
        data_url: address of the data, with the same token.
        page_error: why there is no page; empty if there is one.
        viewers: number of connected viewers.
    """

    def __init__(
        self,
        run_id: str,
        layout: LiveLayout,
        port: int = PORT,
        open_browser: bool = False,
        *,
        page: bool = True,
        memory: int = MEMORY,
        queue: DropQueue | None = None,
    ) -> None:
        self.run_id = run_id
        self.layout = layout
        self.error: str | None = None
        self.url = self.data_url = self.page_error = ""
        self.port = port
        self.viewers = 0
        self._queue = queue or DropQueue()
        self._stop = threading.Event()
        self._started = threading.Event()
        self._closed = False
        self._process: subprocess.Popen[bytes] | None = None
        self._sender = threading.Thread(target=self._send, name="live view", daemon=True)
        self._listener = threading.Thread(target=self._listen, name="viewer", daemon=True)
        begin = {"run_id": run_id, "layout": layout_words(layout), "port": port,
                 "page": page, "memory": memory}  # fmt: skip
        try:
            self._process = _start()
            _write(_pipe(self._process.stdin), pack(begin))
        except OSError as error:
            self._fail(f"the viewer's process did not start: {error}")
            return
        self._listener.start()
        if not self._started.wait(START_S):
            self._fail(f"the viewer did not start within {START_S:g} s")
            self._process.kill()
        if self.error is None:
            self._sender.start()
            if open_browser and not self.page_error and has_screen():
                import webbrowser

                # webbrowser.open may block, so call it on another thread.
                threading.Thread(target=webbrowser.open, args=(self.url,), daemon=True).start()

    # -- called by the test ----------------------------------------------------

    @property
    def dropped(self) -> int:
        """Number of items that were not sent to the viewer: the queue was full or closed."""
        return self._queue.dropped

    @property
    def pid(self) -> int:
        """Id of the viewer's process; 0 if it did not start."""
        return self._process.pid if self._process is not None else 0

    @_never_raises
    def series(self, path: str, time_s: Any, values: Any) -> None:
        """Add samples of a curve: (n,) s since the start of the run, and (n,) values.

        The full sample rate is allowed; at most 100 points per second are drawn (min/max
        envelope of 20 ms bins). Unknown paths are drawn too.
        """
        t, v = _vectors(path, time_s, values)
        self._queue.put_bulk(t.nbytes + v.nbytes, (str(path), t, v))

    @_never_raises
    def points(self, path: str, x: Any, y: Any, label: str, time_s: float | None = None) -> None:
        """Add points (scalars or arrays) to the curve ``label`` of a points panel."""
        when = None if time_s is None else float(time_s)
        self._queue.put_event(("points", str(path), when, str(label), *_vectors(path, x, y)))

    @_never_raises
    def image(
        self, path: str, time_s: float, jpeg_bytes: bytes, lines: list[Line] | None = None
    ) -> None:
        """Show a JPEG as stored, with ``lines`` ((x0, y0), (x1, y1), label) in pixels.

        Of several pictures within 50 ms only the newest is drawn.
        """
        drawn = [
            ((float(a[0]), float(a[1])), (float(b[0]), float(b[1])), str(text))
            for a, b, text in (lines or [])
        ]
        self._queue.put_picture(str(path), (str(path), float(time_s), bytes(jpeg_bytes), drawn))

    @_never_raises
    def state(self, path: str, time_s: float, text: str) -> None:
        """Set the state of ``path`` from ``time_s`` on; an empty text for none."""
        self._queue.put_event(("state", str(path), float(time_s), str(text)))

    @_never_raises
    def text(self, time_s: float, text: str, level: str = "INFO", path: str = "log") -> None:
        """Add a line to the log; level INFO, WARN or ERROR."""
        self._queue.put_event(("text", str(path), float(time_s), str(text), str(level).upper()))

    @_never_raises
    def status(self, time_s: float, text: str, path: str = "status") -> None:
        """Show a text in Markdown in the panel "Status" from ``time_s`` on."""
        self._queue.put_event(("status", str(path), float(time_s), str(text)))

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Wait until a viewer has connected; False on time-out.

        For tests on the virtual clock, which can end before the page has loaded.
        """
        pause, end = threading.Event(), time.monotonic() + timeout_s
        while self.error is None and time.monotonic() < end:
            if self.viewers:
                return True
            pause.wait(0.1)
        return False

    def close(self) -> None:
        """Send the remaining items and end the process, within 6 s in any case.

        May be repeated.
        """
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        process = self._process
        if process is None:
            return
        end = time.monotonic() + CLOSE_S
        if self._sender.is_alive():
            self._sender.join(CLOSE_S)
        if not self._sender.is_alive():
            with contextlib.suppress(OSError):
                _pipe(process.stdin).close()
        try:
            process.wait(max(0.1, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            self.error = self.error or "the viewer did not accept the last data in time"
            process.kill()
            process.wait()
        for thread in (self._sender, self._listener):  # both end with the process
            if thread.is_alive():
                thread.join(1.0)
        for pipe in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):
                _pipe(pipe).close()
        self._queue.discard_all()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _fail(self, why: str) -> None:
        if self.error is None:
            self.error = why
            _log.info("live view: %s", why)  # the test states it on the terminal
        self._queue.discard_all()
        self._started.set()

    # -- on threads of their own ---------------------------------------------------

    def _send(self) -> None:
        """Write what waits, twenty times a second. A viewer that does not read stops this thread.

        The queue then drops.
        """
        assert self._process is not None
        pipe = _pipe(self._process.stdin)
        stopping = False
        while not stopping and self.error is None:
            stopping = self._stop.wait(PERIOD_S)
            bulk, pictures, events = self._queue.drain()
            if not (bulk or pictures or events):
                continue
            try:
                _write(pipe, items_message(bulk, pictures, events, self.dropped))
            except (OSError, ValueError):  # it has ended: the listener states how
                self._queue.drop()
                return

    def _listen(self) -> None:
        """Take what the viewer's process reports, until it ends."""
        assert self._process is not None
        pipe = _pipe(self._process.stdout)
        for line in iter(lambda: pipe.readline(10_000), b""):
            with contextlib.suppress(ValueError, TypeError):
                self._heard(json.loads(line))
        status = self._process.wait()
        if not self._closed:
            self._fail(f"the viewer's process ended (status {status})")

    def _heard(self, words: dict[str, Any]) -> None:
        if "error" in words:
            self._fail(str(words["error"]))
        if "url" in words:
            self.url, self.data_url = str(words["url"]), str(words["data_url"])
            self.port, self.page_error = int(words["port"]), str(words["page_error"])
            self._started.set()
        self.viewers = int(words.get("viewers", self.viewers))


def _start() -> subprocess.Popen[bytes]:
    """The viewer's process, with this program's own modules and in a session of its own."""
    house = str(Path(__file__).resolve().parents[2])
    places = [house, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "daq.live.screen"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        bufsize=0,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
        start_new_session=True,
    )


def _pipe(end: Any) -> BinaryIO:
    assert end is not None
    pipe: BinaryIO = end
    return pipe


def _write(pipe: BinaryIO, data: bytes) -> None:
    """Write all of it: a pipe may take a part."""
    rest = memoryview(data)
    while rest:
        rest = rest[pipe.write(rest) :]
