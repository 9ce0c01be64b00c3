"""The live view: Rerun behind a bounded queue and its own thread.

A viewer may be absent, frozen or killed. Logging straight into Rerun then blocks for ever
once its buffers are full, so nothing on the acquisition path calls it: every method here
puts an item into a bounded queue that drops its oldest (``LiveView.dropped`` counts them),
and one thread draws. The thread talks to a server inside this process on 127.0.0.1, which
viewers connect to; a viewer that stops reading costs the server's memory limit, no more.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.live.decimate import Thinner, decimate
from daq.live.layout import LiveLayout
from daq.live.queue import DropQueue, Item
from daq.live.scene import Line, Scene
from daq.live.web import WebViewer, free_port, has_client, has_screen

LOOPBACK = "127.0.0.1"
PERIOD_S = 0.05  # one batch of columns each
BIN_S = 0.02  # lowest and highest of each: at most 100 points a second
IDLE_FLUSH_S = 0.2  # an unfinished bin is shown after this long without news
READOUT_S = 0.25
HOLD_BEHIND_S = 0.25
START_S = 60.0  # some second; a busy machine takes long over loading Rerun
CLOSE_S = 4.0
APPLICATION = "pamrig"

Floats = npt.NDArray[np.float64]
_log = logging.getLogger(__name__)


class LiveView:
    """A window on a running test that the test never waits for.

    No method raises and none waits, but ``close`` (at most 6 s), ``wait_for_viewer`` and the
    constructor (which
    imports Rerun, about 1 s; make it before arming). If the viewer cannot start, ``error``
    says why and every later item is counted as dropped.

    Args:
        run_id: names the recording; the same id as the run folder's.
        layout: panels, names, units and colours.
        port: of the server on 127.0.0.1; another free one is taken if it is in use.
        open_browser: also open the web viewer in the default browser, where there is a screen.
        web: serve the web viewer on loopback (implied by ``open_browser``).
        memory: bound on what the server keeps for viewers that come late.
        queue: the queue, for other bounds than the usual ones.
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

    # ---------------------------------------------------------- called by the test

    @property
    def dropped(self) -> int:
        """Items that never reached the viewer because the queue was full or closed."""
        return self._queue.dropped

    def series(self, path: str, time_s: Any, values: Any) -> None:
        """Samples of a curve: (n,) s since the start of the run, and (n,) values.

        Full rate is welcome; at most 100 points a second are drawn (lowest and highest of
        each 20 ms). Paths no panel knows are drawn too.
        """
        try:
            t = np.array(time_s, dtype=np.float64, ndmin=1)
            v = np.array(values, dtype=np.float64, ndmin=1)
            if t.shape != v.shape or t.ndim != 1:
                raise ValueError(f"{path}: time {t.shape} and values {v.shape} do not match")
            self._bulk(t.nbytes + v.nbytes, (str(path), t, v))
        except Exception as error:
            self._refuse(error)

    def points(self, path: str, x: Any, y: Any, label: str, time_s: float | None = None) -> None:
        """Add points (scalars or arrays) to the curve ``label`` of a points panel."""
        try:
            xs = np.array(x, dtype=np.float64, ndmin=1)
            ys = np.array(y, dtype=np.float64, ndmin=1)
            if xs.shape != ys.shape or xs.ndim != 1:
                raise ValueError(f"{path}: x {xs.shape} and y {ys.shape} do not match")
            when = None if time_s is None else float(time_s)
            self._fact(("points", str(path), when, str(label), xs, ys))
        except Exception as error:
            self._refuse(error)

    def image(
        self, path: str, time_s: float, jpeg_bytes: bytes, lines: list[Line] | None = None
    ) -> None:
        """A JPEG as stored, with ``lines`` ((x0, y0), (x1, y1), label) in pixels over it.

        Of several pictures within 50 ms the newest is drawn.
        """
        try:
            drawn = [
                ((float(a[0]), float(a[1])), (float(b[0]), float(b[1])), str(text))
                for a, b, text in (lines or [])
            ]
            jpeg = bytes(jpeg_bytes)
            item = (str(path), float(time_s), jpeg, drawn)
            if self._closed or self.error is not None:
                self._queue.drop()
            else:
                self._queue.put_picture(str(path), item)
        except Exception as error:
            self._refuse(error)

    def state(self, path: str, time_s: float, text: str) -> None:
        """``path`` is in state ``text`` from ``time_s`` on; empty text for none."""
        try:
            self._fact(("state", str(path), float(time_s), str(text)))
        except Exception as error:
            self._refuse(error)

    def text(self, time_s: float, text: str, level: str = "INFO", path: str = "log") -> None:
        """A line for the log; level INFO, WARN or ERROR."""
        try:
            self._fact(("text", str(path), float(time_s), str(text), str(level).upper()))
        except Exception as error:
            self._refuse(error)

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Wait until a viewer has connected; False if none came in time.

        For tests that would be over before a page has loaded (the virtual clock).
        """
        pause, end = threading.Event(), time.monotonic() + timeout_s
        while self.error is None and time.monotonic() < end:
            if has_client(self.port):
                return True
            pause.wait(0.1)
        return False

    def close(self) -> None:
        """Draw what is left and stop, within 6 s whatever the viewer does. May be repeated."""
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        self._worker.join(CLOSE_S)
        if self._worker.is_alive():
            # It is inside the viewer's code and cannot be interrupted; being a daemon it
            # does not keep the process alive.
            self.error = self.error or "the viewer did not take its last data; left behind"
        self._queue.abandon()
        if self._web is not None:
            self._web.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _bulk(self, size: int, item: Item) -> None:
        if self._closed or self.error is not None:
            self._queue.drop()
        else:
            self._queue.put_bulk(size, item)

    def _fact(self, item: Item) -> None:
        if self._closed or self.error is not None:
            self._queue.drop()
        else:
            self._queue.put_fact(item)

    def _refuse(self, error: Exception) -> None:
        self._queue.drop()
        _log.debug("live view refused an item: %s", error)

    def _fail(self, why: str) -> None:
        self.error = self.error or why
        self._queue.abandon()
        _log.warning("live view: %s", why)

    # ---------------------------------------------------------------- viewer's side

    def _serve_web(self, open_browser: bool) -> None:
        try:
            self._web = WebViewer([self.url])
            self.web_url = self._web.url
            if open_browser and has_screen():
                import webbrowser

                # Some browsers are waited for, so not on the caller's thread.
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
            bulk, pictures, facts = self._queue.drain()
            flushed = self._draw(scene, bulk, facts, last=stopping)
            for picture in pictures:
                self._try(scene.image, *picture)
            now = time.monotonic()
            news = news or flushed or bool(bulk or pictures or facts)
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
        # Nothing that a viewer reports is to leave the machine.
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
        except Exception as error:  # a bad item must not end the view
            self._refuse(error)

    def _draw(self, scene: Scene, bulk: list[Item], facts: list[Item], last: bool) -> bool:
        """Draw curves and facts; True if a bin that had waited was drawn too."""
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
        for kind, path, time_s, *rest in facts:
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
            # Its changes only, and at once: ``hold_steps`` carries the value on.
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
