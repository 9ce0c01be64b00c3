"""The live view: Rerun with a bounded queue and its own thread.

A viewer may be absent, suspended or killed. Direct logging into Rerun then blocks for ever once
its buffers are full. The acquisition therefore never calls Rerun: every method here puts an
item into a bounded queue, which drops its oldest items (``LiveView.dropped`` counts them), and
one thread draws. The thread logs to a server in this process on 127.0.0.1, and viewers connect
to that server. A viewer that does not read uses at most the server's memory limit.
"""

from __future__ import annotations

import functools
import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec

import numpy as np
import numpy.typing as npt

from daq.live.decimate import Thinner, decimate
from daq.live.layout import LiveLayout
from daq.live.queue import DropQueue, Item
from daq.live.scene import Line, Scene
from daq.live.web import WebViewer, free_port, has_client, has_screen

LOOPBACK = "127.0.0.1"
PERIOD_S = 0.05  # drawing period
BIN_S = 0.02  # min/max envelope: at most 100 points per second
IDLE_FLUSH_S = 0.2  # an incomplete bin is drawn after this time without data
READOUT_S = 0.25
HOLD_BEHIND_S = 0.25
START_S = 60.0  # typically 1 s; loading Rerun takes longer on a busy machine
CLOSE_S = 4.0
APPLICATION = "pamrig"

P = ParamSpec("P")
Floats = npt.NDArray[np.float64]
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
            view._reject(error)

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
    the constructor (imports Rerun, about 1 s; call it before arming). If the viewer cannot
    start, ``error`` gives the reason and all later items are counted as dropped.

    Args:
        run_id: id of the recording; the name of the run folder.
        layout: panels, names, units and colours.
        port: of the server on 127.0.0.1; if it is in use, another free one.
        open_browser: open the web viewer in the default browser, if there is a screen.
        web: serve the web viewer on loopback (implied by ``open_browser``).
        memory: limit of the data that the server keeps for viewers that connect later.
        queue: a queue with other limits than the default.
    """

    def __init__(
        self,
        run_id: str,
        layout: LiveLayout,
        port: int = 9876,
        open_browser: bool = False,
        *,
        web: bool = False,
        memory: str = "256MB",
        queue: DropQueue | None = None,
    ) -> None:
        self.run_id = run_id
        self.layout = layout
        self.error: str | None = None
        self.url = ""
        self.web_url = ""
        self.port = port
        self._memory = memory
        self._queue = queue or DropQueue()
        self._stop = threading.Event()
        self._started = threading.Event()
        self._closed = False
        self._web: WebViewer | None = None
        self.web_error: str | None = None
        self._rec: Any = None
        self._thinners: dict[str, tuple[Thinner, float]] = {}
        self._worker = threading.Thread(target=self._work, name="live view", daemon=True)
        self._worker.start()
        if not self._started.wait(START_S):
            self._fail(f"the viewer's server did not start within {START_S:g} s")
        if (web or open_browser) and self.error is None:
            self._serve_web(open_browser)

    # -- called by the test ----------------------------------------------------

    @property
    def dropped(self) -> int:
        """Number of items that did not reach the viewer: the queue was full or closed."""
        return self._queue.dropped

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

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Wait until a viewer has connected; False on time-out.

        For tests on the virtual clock, which can end before the page has loaded.
        """
        pause, end = threading.Event(), time.monotonic() + timeout_s
        while self.error is None and time.monotonic() < end:
            if has_client(self.port):
                return True
            pause.wait(0.1)
        return False

    def close(self) -> None:
        """Draw the remaining items and stop, within 6 s in any case. May be repeated."""
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        self._worker.join(CLOSE_S)
        if self._worker.is_alive():
            # The thread is blocked in the viewer's code. As a daemon it does not keep the
            # process alive.
            self.error = self.error or "the viewer did not accept the last data in time"
        self._queue.discard_all()
        if self._web is not None:
            self._web.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _reject(self, error: Exception) -> None:
        self._queue.drop()
        _log.debug("live view rejected an item: %s", error)

    def _fail(self, why: str) -> None:
        self.error = self.error or why
        self._queue.discard_all()
        _log.warning("live view: %s", why)

    # -- called by the drawing thread ---------------------------------------------

    def _serve_web(self, open_browser: bool) -> None:
        try:
            self._web = WebViewer([self.url])
            self.web_url = self._web.url
            if open_browser and has_screen():
                import webbrowser

                # webbrowser.open may block, so call it on another thread.
                show = threading.Thread(target=webbrowser.open, args=(self.web_url,), daemon=True)
                show.start()
        except Exception as error:  # the native viewer can still connect
            _log.warning("live view: no web viewer: %s", error)
            self.web_error = str(error)

    def _work(self) -> None:
        try:
            scene = self._open()
        except Exception as error:
            self._fail(f"{type(error).__name__}: {error}")
            self._started.set()
            return
        self._started.set()
        next_readout, news = 0.0, False
        while True:
            stopping = self._stop.wait(PERIOD_S)
            bulk, pictures, events = self._queue.drain()
            flushed = self._draw(scene, bulk, events, last=stopping)
            for picture in pictures:
                self._try(scene.image, *picture)
            now = time.monotonic()
            news = news or flushed or bool(bulk or pictures or events)
            if news and (now >= next_readout or stopping):
                news = False
                next_readout = now + READOUT_S
                note = f"{self.dropped} items not shown (the viewer was slow)"
                self._try(scene.hold_steps, 0.0 if stopping else HOLD_BEHIND_S)
                self._try(scene.readout, note if self.dropped else "")
            if stopping:
                break
        self._try(self._rec.flush, timeout_sec=1.5)
        self._try(self._rec.disconnect)

    def _open(self) -> Scene:
        # Rerun then logs errors as warnings and raises no exceptions.
        os.environ.setdefault("RERUN_STRICT", "0")
        import rerun as rr

        self._rec = rr.RecordingStream(APPLICATION, recording_id=self.run_id)
        self.port = port = free_port(self.port)
        self._rec.set_sinks(
            rr.GrpcServerSink(bind_ip=LOOPBACK, port=port, server_memory_limit=self._memory)
        )
        self.url = f"rerun+http://{LOOPBACK}:{port}/proxy"
        scene = Scene(self._rec, self.layout)
        scene.start()
        return scene

    def _try(self, call: Any, *args: Any, **kwargs: Any) -> None:
        try:
            call(*args, **kwargs)
        except Exception as error:  # an invalid item must not end the view
            self._reject(error)

    def _draw(self, scene: Scene, bulk: list[Item], events: list[Item], last: bool) -> bool:
        """Draw curves and events; True if an incomplete bin was drawn too."""
        flushed = False
        curves: dict[str, list[Item]] = {}
        for item in bulk:
            curves.setdefault(item[0], []).append(item)
        now = time.monotonic()
        for path, items in curves.items():
            self._try(self._curve, scene, path, items, now)
        for path, (thinner, fed_at) in list(self._thinners.items()):
            if thinner.waiting and (last or now - fed_at > IDLE_FLUSH_S):
                self._try(scene.series, path, *thinner.flush())
                flushed = True
        for kind, path, time_s, *rest in events:
            if kind == "points":
                label, x, y = rest
                when = scene.newest_s if time_s is None else time_s
                self._try(scene.points, path, when, label, x, y)
            elif kind == "state":
                self._try(scene.state, path, time_s, *rest)
            else:
                self._try(scene.text, path, time_s, *rest)
        return flushed

    def _curve(self, scene: Scene, path: str, items: list[Item], now: float) -> None:
        time_s = np.concatenate([item[1] for item in items])
        values = np.concatenate([item[2] for item in items])
        channel = self.layout.channels.get(path)
        if channel is not None and channel.step:
            # Draw the changes only, and at once; ``hold_steps`` extends the last value.
            known = np.concatenate(([scene.newest.get(path, np.nan)], values[:-1]))
            change = values != known
            scene.series(path, *decimate(time_s[change], values[change], BIN_S))
            return
        if path not in self._thinners:
            reduce = channel.reduce if channel else "minmax"
            bin_s = BIN_S if reduce == "minmax" else BIN_S / 2.0
            self._thinners[path] = (Thinner(bin_s, reduce), now)
        thinner = self._thinners[path][0]
        self._thinners[path] = (thinner, now)
        scene.series(path, *thinner.feed(time_s, values))
