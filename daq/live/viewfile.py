"""A view file of a recorded run: the panels of the live view over the whole record.

``view.rrd`` is a derived file: it may be deleted and created again. For an interrupted run it
shows all data with a correct CRC.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import RecordError
from daq.link.causes import CAUSES, cause_of, event_words
from daq.live.decimate import decimate
from daq.live.door import Door
from daq.live.history import ViewFile
from daq.live.layout import (
    PREDICTION,
    PREDICTION_FEEDS,
    Channel,
    EventFeed,
    Feed,
    LiveLayout,
    Panel,
    PointFeed,
)
from daq.live.page import PageFile, page_files
from daq.live.scene import APPLICATION, Line, Scene
from daq.live.status import (
    DONE,
    FAULT,
    STOPPED,
    Phases,
    Status,
    from_zero,
    joined,
    problem_and_remedy,
    with_target,
)
from daq.record.disk import disk_error
from daq.record.segments import Columns
from daq.store.derive import VALVE_STREAMS, Maker, engineering
from daq.store.run import Run

Edges = Callable[[bytes], list[Line]]

FILE = "view.rrd"
STATUS = "status"
PORT = 9090
CHUNK_ROWS = 65_536
MOST_ROWS = 1_000_000
MOST_FRAMES = 1_000
_QUIET = {"state", "point", "result", "length", "command", "clockfit", "zero", "trial"}
_LEVELS = {"fault": "ERROR", "vent_unconfirmed": "ERROR", "gap": "WARN", "end": "WARN"}


def view_maker(layout: LiveLayout | None = None, edges: Edges | None = None) -> Maker:
    """A maker for ``daq.store.derive.derive``: writes ``view.rrd`` into the derived files."""

    def make(run: Run, folder: Path) -> Path:
        return build_view(run, folder / FILE, layout, edges)

    return make


def build_view(
    run: Run,
    path: Path,
    layout: LiveLayout | None = None,
    edges: Edges | None = None,
    most_rows: int = MOST_ROWS,
) -> Path:
    """Write the view file of a run.

    Args:
        run: finished or interrupted.
        path: the file to write; it never holds partial content.
        layout: the panels; None shows every column of every stream.
        edges: finds the lines to draw over a stored frame; None draws none.
        most_rows: a longer series is reduced to its min/max envelope; the record keeps all
            samples.

    Raises:
        RecordError: run.json is damaged, or the file cannot be written.
    """
    import rerun as rr

    layout = layout or plain_layout(run)
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        rec = rr.RecordingStream(APPLICATION, recording_id=run.run_id)
        rec.save(partial)
        try:
            _fill(Scene(rec, layout), run, layout, edges, most_rows)
        finally:
            rec.flush(timeout_sec=60.0)
            rec.disconnect()
        os.replace(partial, path)
    except OSError as error:
        raise disk_error(path, "the view cannot be written", error) from error
    except RuntimeError as error:  # rerun's error after a failed write
        raise RecordError(
            str(path), f"the view cannot be written: {error}", "make room, then rebuild the run"
        ) from error
    finally:
        partial.unlink(missing_ok=True)
    return path


def plain_layout(run: Run) -> LiveLayout:
    """Default layout: one panel per stream with all columns."""
    panels: list[Panel] = []
    feeds: list[Feed] = []
    for stream in run.streams:
        columns, units = engineering(run, stream)
        names = [n for n in columns if n not in ("time_s", "seq", "row")] if columns else []
        if "time_s" not in columns or not names:
            continue
        channels = tuple(
            Channel(f"{stream}/{n}", f"{n} ({units[n]})" if n in units else n) for n in names
        )
        panels.append(Panel(stream, "series", stream, channels))
        feeds += [Feed(f"{stream}/{n}", stream, n) for n in names]
    states = Panel("State", "states", "state", (Channel("state/protocol", "state"),), share=0.4)
    return LiveLayout(
        title=str(run.manifest.get("protocol", "run")),
        columns=((*panels, states), (Panel("Camera", "camera", "camera"),
                                     Panel("Messages", "log", "log"))),
        shares=(2.0, 1.0),
        feeds=tuple(feeds),
        event_feeds=(EventFeed("state/protocol", "state", "state"),),
    )  # fmt: skip


def _fill(scene: Scene, run: Run, layout: LiveLayout, edges: Edges | None, most_rows: int) -> None:
    scene.start()
    start_ns = int(run.manifest["started"]["monotonic_ns"])
    tables = {name: engineering(run, name)[0] for name in run.streams}
    _add_live_columns(run, tables)
    frame_ns = {int(f["frame"]): int(f["host_ns"]) for f in run.frames}
    for feed in layout.feeds:
        _series(scene, tables.get(feed.stream, {}), feed, layout, most_rows)
    for feed in PREDICTION_FEEDS:
        _series(scene, _stated(tables.get(PREDICTION, {}), feed.column), feed, layout, most_rows)
    source = str(run.manifest.get("length_source") or "")
    for events in layout.event_feeds:
        if source in tables and events.quantity == "length_mm":
            by_reader = Feed(events.path, source, "length_mm")
            _series(scene, tables[source], by_reader, layout, most_rows)
            continue
        _event_series(scene, run, events, frame_ns, start_ns, layout)
    for points in layout.points:
        _points(scene, run, tables, points)
    _results(scene, run, layout)
    if any(panel.kind == "status" for panel in layout.panels):
        _status(scene, run, tables)
    _frames(scene, run, layout.camera, frame_ns, start_ns, edges)
    for event in run.events:
        if event["kind"] not in _QUIET:
            level = _LEVELS.get(event["kind"], "INFO")
            level = "INFO" if event.get("outcome") == "stopped" else level
            scene.text("log", event["t_ns"] / 1e9, _summary(event), level)
    for problem in run.problems:
        scene.text("log", 0.0, f"record: {problem}", "ERROR")
    scene.text("log", scene.newest_s, f"outcome: {run.outcome}", "INFO")
    scene.finish()


def _add_live_columns(run: Run, tables: dict[str, Columns]) -> None:
    """Columns that the live view shows in another form than the record."""
    for stream in VALVE_STREAMS:
        if {"setpoint_kpa", "outlet_cmd"} <= tables.get(stream, {}).keys():
            tables[stream] = with_target(tables[stream])
    balance = tables.get("balance", {})
    if {"time_s", "force_n"} <= balance.keys():
        tare_s = next((e["t_ns"] / 1e9 for e in run.events if e["kind"] == "tare"), None)
        force = np.asarray(balance["force_n"], dtype=np.float64)
        times = np.asarray(balance["time_s"], dtype=np.float64)
        tables["balance"] = {**balance, "zeroed_n": from_zero(times, force, tare_s)}


def _stated(table: Columns, column: str) -> Columns:
    """The rows of a table that have a value in a column."""
    if column not in table:
        return {}
    use = ~np.isnan(table[column])
    return {name: values[use] for name, values in table.items()}


def _status(scene: Scene, run: Run, tables: dict[str, Columns]) -> None:
    """State, step and points of the run over its time, and at the end its outcome."""
    changes = _changes(run, tables)
    made = sum(what == "point" for _, what, _ in changes)
    status = Status("", planned=made if run.outcome == "clean" else 0)
    phases: dict[str, str] = {}
    for at_s, what, text in changes:
        if what == "step":
            status = replace(status, step=text)
        elif what == "point":
            status = replace(status, done=status.done + 1)
        elif what == "fault":
            cause = cause_of(text)
            problem, remedy = CAUSES[cause] if cause else (event_words(text), "")
            status = status if status.problem else replace(status, problem=problem, remedy=remedy)
        else:
            phases = dict(sorted({**phases, what: text}.items()))
            status = replace(status, phase=joined(phases))
        scene.status(STATUS, at_s, status.markdown())
    phase = {"clean": DONE, "stopped": STOPPED}.get(run.outcome, FAULT)
    problem, remedy = problem_and_remedy(str((run.final or {}).get("reason") or ""))
    if phase == FAULT and not problem:
        problem = f"the run ended {run.outcome}"
    last = replace(status, phase=phase, problem=problem, remedy=remedy)
    scene.status(STATUS, scene.newest_s, last.markdown())


def _changes(run: Run, tables: dict[str, Columns]) -> list[tuple[float, str, str]]:
    """What the status depends on, in order of time: time in s, kind or controller, text."""
    changes: list[tuple[float, str, str]] = []
    for stream in VALVE_STREAMS:
        table = tables.get(stream, {})
        if "time_s" in table:
            changes += [(t, stream, p) for t, p in Phases().feed(table["time_s"], table)]
    for event in run.events:
        kind, at_s = event["kind"], event["t_ns"] / 1e9
        if kind == "state":
            changes.append((at_s, "step", str(event.get("state", ""))))
        elif kind in ("point", "skipped") and event.get("take", 1) == 1:
            changes.append((at_s, "point", ""))
        elif kind == "fault":
            changes.append((at_s, "fault", str(event.get("text", ""))))
    return sorted(changes, key=lambda change: change[0])


def _series(scene: Scene, table: Columns, feed: Feed, layout: LiveLayout, most_rows: int) -> None:
    if feed.column not in table or "time_s" not in table:
        return
    time_s = np.asarray(table["time_s"], dtype=np.float64)
    values = np.asarray(table[feed.column], dtype=np.float64) * feed.scale
    channel = layout.channels.get(feed.path)
    if channel is not None and channel.step and len(values):  # keep only the steps of a step curve
        both_none = np.isnan(values[1:]) & np.isnan(values[:-1])
        changes = np.flatnonzero((values[1:] != values[:-1]) & ~both_none) + 1
        keep = np.unique(np.concatenate(([0], changes, [len(values) - 1])))
        time_s, values = time_s[keep], values[keep]
    if len(time_s) > most_rows:
        span = float(time_s[-1] - time_s[0])
        time_s, values = decimate(time_s, values, 2.0 * span / most_rows)
    for first in range(0, len(time_s), CHUNK_ROWS):
        part = slice(first, first + CHUNK_ROWS)
        scene.series(feed.path, time_s[part], values[part])


def _event_series(
    scene: Scene,
    run: Run,
    feed: EventFeed,
    frame_ns: dict[int, int],
    start_ns: int,
    layout: LiveLayout,
) -> None:
    panel = layout.panel_of(feed.path)
    calibration = run.calibrations.get(feed.quantity) if feed.quantity else None
    if feed.quantity and calibration is None:
        return
    times, values = [], []
    for event in run.events:
        if event["kind"] != feed.kind or event.get(feed.field) is None:
            continue
        if feed.only and not event.get(feed.only):
            continue
        frame = event.get("frame")
        at_s = (frame_ns[frame] - start_ns if frame in frame_ns else event["t_ns"]) / 1e9
        if panel is not None and panel.kind == "states":
            scene.state(feed.path, at_s, event_words(str(event[feed.field])))
        else:
            raw = float(event[feed.field])
            values.append(float(calibration.apply(raw)) if calibration else raw)
            times.append(at_s)
    scene.series(feed.path, np.array(times), np.array(values))


def _points(scene: Scene, run: Run, tables: dict[str, Columns], feed: PointFeed) -> None:
    lengths = _frame_lengths(run) if "camera" in (feed.x[0], feed.y[0]) else {}
    for event in run.events:
        if event["kind"] != feed.kind or (feed.needs and event.get(feed.needs) is None):
            continue
        x = _mean(tables, _length_of(run, feed.x), event, lengths)
        y = _mean(tables, _length_of(run, feed.y), event, lengths)
        if x is None or y is None:
            continue
        try:
            label = feed.label.format(**event)
        except (KeyError, ValueError, TypeError):  # an imported row may lack the field
            label = str(event.get("slot") or f"trial {event.get('trial', '?')}")
        scene.points(feed.path, event["t_ns"] / 1e9, label, np.array([x]), np.array([y]))


def _results(scene: Scene, run: Run, layout: LiveLayout) -> None:
    """What the test showed in its points panel as it ran; ``Scene`` ignores it without one."""
    for event in run.events:
        if event["kind"] != "result":
            continue
        origin = str(event.get("chart") or "points")
        x, y, label = event.get("x"), event.get("y"), str(event.get("label", ""))
        if isinstance(x, (int, float)) and isinstance(y, (int, float)):
            at_s = event["t_ns"] / 1e9
            scene.points(f"{origin}/result", at_s, label, np.array([x]), np.array([y]))


def _frame_lengths(run: Run) -> dict[int, float]:
    """Length in each measured picture, as measured during the test."""
    calibration = run.calibrations.get("length_mm")
    if calibration is None:
        return {}
    return {
        event["frame"]: float(calibration.apply(event["pixels"]))
        for event in run.events
        if event["kind"] == "length" and event.get("trusted")
    }


def _length_of(run: Run, where: tuple[str, str]) -> tuple[str, str]:
    """Stream and column; those of the instrument where one reads the length, not the camera."""
    source = run.manifest.get("length_source")
    return (str(source), where[1]) if source and where[0] == "camera" else where


def _mean(
    tables: dict[str, Columns],
    where: tuple[str, str],
    event: dict[str, Any],
    lengths: dict[int, float],
) -> float | None:
    """Mean of a column over the rows named by ``event``; None if they are missing."""
    stream, column = where
    span: Any
    if stream == "camera" and "row" not in event:
        seen = [lengths[n] for n in event.get("frames", ()) if n in lengths]
        return float(np.mean(seen)) if seen else None
    if stream not in tables and "points" in tables and "row" in event:
        stream, key, span = "points", "row", [event["row"], event["row"] + 1]
    else:
        key = "seq" if "seq" in tables.get(stream, {}) else "row"
        span = event.get(f"{stream}_seq") or event.get(f"{stream}_rows")
        if column == "length_mm":  # an instrument reads it
            span = event.get("length_rows")
    table = tables.get(stream, {})
    if column not in table or key not in table or span is None:
        return None
    use = (table[key] >= span[0]) & (table[key] < span[1])
    return float(np.mean(table[column][use])) if use.any() else None


def _frames(
    scene: Scene, run: Run, path: str, frame_ns: dict[int, int], start_ns: int, edges: Edges | None
) -> None:
    numbers = sorted(frame_ns)
    for number in numbers[:: max(1, -(-len(numbers) // MOST_FRAMES))]:
        try:
            jpeg = run.frame_bytes(number)
            lines = edges(jpeg) if edges else []
        except RecordError:
            continue  # listed in run.problems, shown as message
        except ValueError:  # show a frame without measurement
            lines = []
        scene.image(path, (frame_ns[number] - start_ns) / 1e9, jpeg, lines)


def _summary(event: dict[str, Any]) -> str:
    if event["kind"] in ("controller", "fault"):
        return event_words(str(event.get("text", "")))
    if event["kind"] == "prediction":
        stopped = event.get("stopped")
        return f"prediction stopped: {stopped}" if stopped else f"prediction by {event.get('file')}"
    skip = ("n", "t_ns", "kind", "crc")
    rest = ", ".join(
        f"{k} {v:.6g}" if isinstance(v, float) else f"{k} {v}"
        for k, v in event.items()
        if k not in skip
    )
    return f"{event['kind']}: {rest}"[:200]


class RunPage:
    """The viewer's page with the view of a recorded run, on 127.0.0.1 until ``close``.

    Args:
        path: the view file.
        files: of the page.
        port: of the page; if it is in use, another free one.
        temporary: a folder to delete at the end.
    """

    def __init__(
        self,
        path: Path,
        files: dict[str, PageFile],
        port: int,
        temporary: tempfile.TemporaryDirectory[str] | None = None,
    ) -> None:
        self._temporary = temporary
        self._door = Door(ViewFile(path), files, port)
        self.url = self._door.url
        self.message = f"open {self.url} in a browser; Ctrl-C ends"

    def wait(self) -> None:
        """Wait until the user presses Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()

    def close(self) -> None:
        """Stop serving. May be repeated."""
        self._door.close()
        if self._temporary is not None:
            self._temporary.cleanup()


def open_view(
    run: Run, layout: LiveLayout | None = None, edges: Edges | None = None, port: int = PORT
) -> RunPage:
    """Serve a run as a page on this machine, behind a token.

    A run without a valid view file gets a temporary one. The caller prints ``.message``, calls
    ``.wait()`` and finally ``.close()``.

    Args:
        run: finished or interrupted.
        layout, edges: see :func:`build_view`.
        port: of the page.

    Raises:
        RecordError: the view file cannot be created.
        ViewerError: the viewer cannot start.
    """
    made: tempfile.TemporaryDirectory[str] | None = None
    try:
        path = run.derived(FILE)
    except RecordError:  # interrupted or not derived yet; do not add to derived/
        made = tempfile.TemporaryDirectory(prefix="pamrig-view-")
        path = build_view(run, Path(made.name) / FILE, layout, edges)
    try:
        return RunPage(path, page_files(), port, made)
    except BaseException:
        if made is not None:
            made.cleanup()
        raise
