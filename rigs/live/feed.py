"""What a running test hands to the live view; the view may lose it, the test never waits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from analysis.layouts import layouts as paths
from analysis.layouts.layouts import edge_lines, profile_lines
from analysis.reduction.pictures import decode
from daq.clock import NS_PER_S
from daq.link.causes import event_words
from daq.live.layout import Feed, LiveLayout
from daq.live.live import LiveView
from daq.live.status import ForceZero, with_target
from daq.record.writer import RecordWriter
from daq.store.derive import VALVE_STREAMS, scaled
from rigs.bench.rig import Rig
from rigs.devices.valve_controller import ValveController
from rigs.execution.runner import Watch
from rigs.live.status import LiveStatus
from rigs.steps.steps import Measure
from rigs.steps.watching import Progress

if TYPE_CHECKING:
    from vision.marker.gap import GapMeasurement

Batch = dict[str, npt.NDArray[np.generic]]


class LiveFeed:
    """Joins a rig, its record and the runner's hooks to a live view.

    Args:
        view: where it goes.
        layout: which column of which stream becomes which curve, and what its points are.
    """

    def __init__(self, view: LiveView, layout: LiveLayout) -> None:
        self.view = view
        self._layout = layout
        self._feeds = layout.feeds
        self._start_ns = 0
        self._warn: Callable[[str], None] = lambda text: None
        self._ended = view.error is not None  # that it did not start was said
        self._zero = ForceZero()
        self._status: LiveStatus | None = None

    def attach(  # noqa: C901 - one small hook after another
        self, rig: Rig, record: RecordWriter, watch: Watch, progress: Progress
    ) -> None:
        """Listen to everything; called once before the run."""
        self._start_ns = record.start_ns
        self._rig = rig
        clock = rig.clock

        def now_s() -> float:
            return (clock.now_ns() - self._start_ns) / NS_PER_S

        names = [side.name for side in rig.sides]
        status = self._status = LiveStatus(self.view, progress, now_s, names)
        rig.event_loop.on_request.append(status.request)
        for side in rig.sides:
            side.valve.on_batch.append(self._listener(side.name))
            side.valve.on_event = self._event_listener(side.valve, now_s)
        rig.balance.on_rows.append(lambda batch: self._batch("balance", batch))
        self._feeds = (*self._feeds, *self._length_feeds(rig))
        for name, instrument in rig.instruments.items():
            if any(feed.stream == name for feed in self._feeds):
                instrument.on_rows.append(self._listener(name))
        self._calibrations = {
            **rig.config.calibrations,
            **{n: i.calibration for n, i in rig.instruments.items() if i.calibration is not None},
        }
        if rig.supply is not None and any(feed.stream == "supply" for feed in self._feeds):
            rig.supply.on_rows.append(self._listener("supply"))
        inner = replace(watch)
        self._warn = inner.log
        length = rig.config.calibrations.get("length_mm")

        def state(text: str) -> None:
            inner.state(text)
            self.view.state(paths.STATE, now_s(), text)
            status.step(text)

        def log(text: str) -> None:
            inner.log(text)
            self.view.text(now_s(), text, "WARN")

        def point(step: Measure, pressure_kpa: float, force_n: float, length_mm: float) -> None:
            inner.point(step, pressure_kpa, force_n, length_mm)
            status.point()
            values = {"pressure_kpa": pressure_kpa, "force_n": force_n, "length_mm": length_mm}
            for feed in self._layout.points:
                if (x := values.get(feed.x[1])) is None or (y := values.get(feed.y[1])) is None:
                    continue
                if feed.needs and getattr(step, feed.needs, None) is None:
                    continue
                label = feed.label.format(**vars(step))
                self.view.points(feed.path, x, y, label, time_s=now_s())

        def picture(host_ns: int, jpeg: bytes, gap: GapMeasurement) -> None:
            inner.picture(host_ns, jpeg, gap)
            time_s = (host_ns - self._start_ns) / NS_PER_S
            seen = gap.trusted and length is not None
            length_mm = float(length.apply(gap.pixels)) if seen else None  # type: ignore[union-attr]
            lines = edge_lines(gap, length_mm)
            gray = decode(jpeg)
            if gray is not None:
                lines += profile_lines(gray, gap.region)
            self.view.image(paths.CAMERA, time_s, jpeg, lines=lines)
            if length_mm is not None:
                self.view.series(paths.LENGTH, [time_s], [length_mm])

        def set_point(channel: str, value: float) -> None:
            inner.set_point(channel, value)
            # A test of the valve holds one length and has no panel for it.
            if channel == "length" and self._layout.panel_of(paths.SET_LENGTH) is not None:
                self.view.series(paths.SET_LENGTH, [now_s()], [value])

        def result(x: float, y: float, label: str, chart: str = "points") -> None:
            inner.result(x, y, label, chart)
            self.view.points(f"{chart}/result", x, y, label, time_s=now_s())

        watch.state, watch.log, watch.point = state, log, point
        watch.picture, watch.set_point, watch.result = picture, set_point, result
        watch.taring = _both(inner.taring, self._zero.taring)
        watch.tared = _both(inner.tared, self._zero.tared)

    def _event_listener(
        self, valve: ValveController, now_s: Callable[[], float]
    ) -> Callable[[str], None]:
        on_event = valve.on_event

        def event(text: str) -> None:
            if on_event is not None:
                on_event(text)
            fault, words = text.startswith("fault"), event_words(text)
            if fault:
                self.view.state(paths.FAULT, now_s(), words)
            self.view.text(now_s(), words, "ERROR" if fault else "INFO")
            if self._status is not None:
                self._status.event(text)

        return event

    def _length_feeds(self, rig: Rig) -> list[Feed]:
        """The length by an instrument, where the layout shows a length."""
        if rig.length_reader is None or self._layout.panel_of(paths.LENGTH) is None:
            return []
        return [Feed(paths.LENGTH, rig.config.length_source, "length_mm")]

    def _listener(self, stream: str) -> Callable[[Batch], None]:
        return lambda batch: self._batch(stream, batch)

    def _batch(self, stream: str, batch: Batch) -> None:
        if self.view.error is not None:
            self._state_end(self.view.error)
            return
        time_s = (self._host_ns(batch) - self._start_ns) / NS_PER_S
        columns, _ = scaled(stream, batch, self._calibrations, {})
        if stream in VALVE_STREAMS:
            columns = with_target(columns)
            if self._status is not None:
                self._status.batch(stream, time_s, columns)
        if "force_n" in columns and stream == "balance":
            columns = {**columns, "zeroed_n": self._zero.apply(columns["force_n"])}
        for feed in self._feeds:
            if feed.stream == stream:
                values = np.asarray(columns[feed.column]).astype(np.float64) * feed.scale
                self.view.series(feed.path, time_s, values)

    def _state_end(self, why: str) -> None:
        """State once that there is no view any more."""
        if not self._ended:
            self._ended = True
            self._warn(f"live view: {why}; the test continues without it")

    def _host_ns(self, batch: Batch) -> npt.NDArray[np.float64]:
        """Host times of a batch; with device times by their spacing up to its arrival."""
        host_ns = batch["host_ns"].astype(np.float64)
        if "device_us" not in batch:
            return host_ns
        device_us = batch["device_us"].astype(np.float64)
        return np.asarray(host_ns[-1] - (device_us[-1] - device_us) * 1000.0)

    def ended(self, outcome: str, error: BaseException | None) -> None:
        """Show how the run ended, and what to do about a fault."""
        if self._status is not None:
            self._status.ended(outcome, error)

    def close(self) -> None:
        """Close the view, within its own bound of time."""
        self.view.close()


def _both(first: Callable[[], None], second: Callable[[], None]) -> Callable[[], None]:
    """One hook after the other."""

    def call() -> None:
        first()
        second()

    return call


def open_live(run_id: str, layout: LiveLayout, open_browser: bool) -> LiveFeed:
    """Start the live view of a test on loopback."""
    return LiveFeed(LiveView(run_id, layout, open_browser=open_browser), layout)
