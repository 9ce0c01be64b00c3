"""Whether a faulted run kept every promise, judged by the bench's truth and the bytes on disk.

Nothing here asks the code that is judged, but for two questions that are about it:
`daq.store.verify` (does the product itself call the record sound?) and the table (is a number in
it wrong?). Rows are read with pyarrow, events and final.json as the JSON they are, times and
pressures are the simulation's own.
"""

from __future__ import annotations

import json
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from daq.errors import RecordError

from .kinds import FOR_GOOD, Fault
from .places import EMPTY_KPA, empty_s, tellable_kpa
from .trial import Truth

COMMANDED_US = 350_000
OVER_PRESSURE_US = 10_000
SIGMAS = 6.0
BLIND_KPA = 200.0
"""Filled at most by this before it is vented, where the sensor reads nothing (safety contract)."""
TICK_US = 1000
STRETCH_MS = 100
HOST_SILENT_US = 290_000
NO_BEAT = "no heartbeat"
LOOK_US = 20_000
"""The bench is looked at every 20 ms: so much later a fault may have ended."""
RANGE_KPA = (5.0, 990.0)
"""Between the ends of the converter, where it shows what there is."""
SAMPLE_SIGMAS = 8.0
LEAST_SAMPLES = 200
LEAST_SPAN_KPA = 50.0
"""Over less than this the noise of the samples tells nothing of the gain."""


@dataclass
class Verdict:
    """What was found of one run.

    Attributes:
        untold: faults that left no trace in record or message.
        late: vents beyond a deadline, in words.
        unreadable, wrong, stuck: rows that are gone, wrong numbers in the table, and why the test
            cannot be gone on with, in words.
        worst_commanded_s, worst_empty_s: slowest command after an event that has to end in one,
            and slowest emptying after a command.
    """

    untold: list[str] = field(default_factory=list)
    late: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    stuck: list[str] = field(default_factory=list)
    crashed: str = ""
    worst_commanded_s: float = 0.0
    worst_empty_s: float = 0.0
    points: int = 0
    continued: bool = False

    @property
    def sound(self) -> bool:
        """Whether nothing was found."""
        lists = (self.untold, self.late, self.unreadable, self.wrong, self.stuck)
        return not any(lists) and not self.crashed


class Bytes:
    """A run folder as plain JSON and Arrow, without the package."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """Whole lines of events.jsonl but the first, which names the run."""
        path = self.folder / "events.jsonl"
        lines = path.read_bytes().split(b"\n") if path.exists() else []
        return [json.loads(line) for line in lines[1:-1]]

    @cached_property
    def final(self) -> dict[str, Any]:
        """final.json, or nothing."""
        path = self.folder / "final.json"
        return dict(json.loads(path.read_bytes())) if path.exists() else {}

    def rows(self, stream: str) -> dict[str, Any]:
        """Every row of a stream that can still be read, by column."""
        tables = []
        for path in sorted((self.folder / "samples" / stream).glob("*.arrows")):
            batches = list(_batches(path.read_bytes()))
            if batches:
                tables.append(pa.Table.from_batches(batches))
        if not tables:
            return {}
        table = pa.concat_tables(tables)
        return {name: table[name].to_numpy() for name in table.column_names}

    def pictures(self) -> dict[int, bytes]:
        """JPEGs by number, cut out of their files as the index says."""
        path = self.folder / "frames.jsonl"
        lines = path.read_bytes().split(b"\n")[1:-1] if path.exists() else []
        out, files = {}, dict[str, bytes]()
        for line in map(json.loads, lines):
            name = line["file"]
            data = files.setdefault(name, (self.folder / name).read_bytes())
            out[line["frame"]] = data[line["offset"] : line["offset"] + line["length"]]
        return out

    def kind(self, kind: str) -> list[dict[str, Any]]:
        """All events of a kind."""
        return [event for event in self.events if event["kind"] == kind]


def _batches(data: bytes) -> Iterator[Any]:
    try:
        stream = pa.ipc.open_stream(pa.py_buffer(data))
        while True:
            yield stream.read_next_batch()
    except (StopIteration, pa.ArrowInvalid, OSError):  # the end, or bytes that were being written
        return


def judge(truth: Truth) -> Verdict:
    """All that can be said of a run; the table and going on with it are judged elsewhere."""
    verdict = Verdict(crashed=truth.crashed)
    if not truth.folder:
        if not truth.crashed:
            verdict.stuck.append(f"did not begin: {truth.error or truth.outcome}")
        return verdict
    record = Bytes(Path(truth.folder))
    for fault in truth.faults:
        if fault.must_tell and not told(fault, truth, record):
            verdict.untold.append(fault.name)
    _vents(truth, record, verdict)
    _readable(truth, record, verdict)
    return verdict


# ---- told ---------------------------------------------------------------------------

JUST_BEFORE_US = 2_500_000
"""A fault that begins so shortly before another one ends the run may not be noticed any more."""
WORDS = {"controller": "valve controller", "process": "valve controller|nobody expected",
         "camera": "camera", "disk": "written|disk"}  # fmt: skip


def told(fault: Fault, truth: Truth, record: Bytes) -> bool:
    """Whether record or message show that something was wrong, where the fault was."""
    final = record.final
    if _too_late_to_matter(fault, truth, record):
        return True
    if not final and truth.error and any(f.layer == "disk" and f.hits for f in truth.faults):
        return True  # the counters could not be written any more, and the terminal says so
    if truth.killed:
        return not final  # it reads as interrupted; what was counted is gone
    if final.get("outcome") != "clean" and not truth.error:
        return False  # nothing tells the person at the terminal
    ended = truth.outcome not in ("clean", "stopped") and bool(truth.error)
    if ended and re.search(WORDS.get(fault.layer, fault.device), truth.error):
        return True
    if ended and len(truth.faults) > 1 and truth.done_us - fault.first_us < JUST_BEFORE_US:
        return True
    if fault.layer == "wire" and _vent_unsure(record):
        return True
    if fault.layer in ("wire", "instrument", "camera"):
        counters = (final.get("counters") or {}).get(fault.device or "camera") or {}
        fine = ("frames", "samples", "lines", "rows")
        if any(v for k, v in counters.items() if k not in fine and isinstance(v, int)):
            return True
        if fault.layer == "camera":
            return any(not e["trusted"] for e in record.kind("length"))
        return False
    faults = [*record.kind("fault"), *record.kind("vent_unconfirmed")]
    if fault.layer == "other program" and record.kind("foreign_commands"):
        return True
    return bool(faults) or any(not e["settled"] for e in record.kind("point") if "settled" in e)


def _vent_unsure(record: Bytes) -> bool:
    """Whether the record says that nobody knows of the closing vent."""
    unsure = [e for e in record.kind("vented") if not e["confirmed"]]
    return bool(unsure or record.kind("vent_unconfirmed"))


def _too_late_to_matter(fault: Fault, truth: Truth, record: Bytes) -> bool:
    """Whether it began when there was nothing left that it could do or that could show it."""
    if fault.begun_us < 0:
        return False
    if fault.begun_us >= truth.closed_us > 0:
        return True
    if fault.layer == "wire" and fault.first_us > truth.closed_us - 2 * LOOK_US > 0:
        return True  # no later message came that would have shown that one is missing
    if (fault.layer, fault.kind) in (("process", "hung"), ("disk", "slow")):
        was = [armed for us, armed in truth.armed if us <= fault.begun_us]
        return bool(was) and not was[-1]  # the controller is disarmed and vents
    sure = [e for e in record.kind("vented") if e["confirmed"]]
    if fault.layer == "controller" and sure:  # the muscle is empty, and the run over
        return fault.begun_us > truth.bench_us(sure[-1]["t_ns"]) - 2 * LOOK_US
    return False


# ---- vented -------------------------------------------------------------------------


def _vents(truth: Truth, record: Bytes, verdict: Verdict) -> None:
    for what, event_us, limit_us in _must_vent(truth):
        commanded = _venting_from(truth, event_us)
        if commanded is None and truth.done_us + 3_000_000 < event_us + limit_us:
            continue
        wait_us = math.inf if commanded is None else max(0, commanded - event_us)
        verdict.worst_commanded_s = max(verdict.worst_commanded_s, wait_us * 1e-6)
        if wait_us > limit_us + TICK_US:
            verdict.late.append(f"{what}: vent commanded after {wait_us * 1e-3:.0f} ms")
        # The host's own last vent follows its last heartbeat sooner than the deadline; and it may
        # come just after something else that the controller would have vented for.
        own_us = HOST_SILENT_US if what == NO_BEAT else 0
        vented = commanded is not None and commanded > event_us + own_us
        if vented and truth.latched and truth.outcome == "clean" and not record.kind("fault"):
            verdict.untold.append(f"{what}: the controller vented")
    _blind(truth, verdict)
    if _supply_left_low(truth):
        return
    _emptied(truth, verdict)
    air = truth.end_kpa >= EMPTY_KPA
    if air and not truth.sealed_in and not _still_emptying(truth):
        verdict.late.append(f"{truth.end_kpa:.0f} kPa in the muscle 3 s after the end")
    went_well = not truth.killed and truth.outcome in ("clean", "stopped")
    unsaid = not _vent_unsure(record) and not record.kind("fault")
    if air and truth.sealed_in and went_well and unsaid:
        verdict.untold.append(f"{truth.end_kpa:.0f} kPa left in the muscle")


def _supply_left_low(truth: Truth) -> bool:
    """A switching-voltage test whose program stops leaves the solenoids at its test voltage."""
    gone = any(f.layer == "process" and f.kind != "bug" and f.begun_us >= 0 for f in truth.faults)
    return truth.protocol == "switching-voltage" and gone


def _must_vent(truth: Truth) -> Iterator[tuple[str, int, int]]:
    """(what, bench us, limit in us) of all that has to end in a vent."""
    for (us, armed), (next_us, _) in pairwise([*truth.beats, (10**15, False)]):
        if armed and next_us - us > COMMANDED_US:
            yield NO_BEAT, us, COMMANDED_US
    armed_at = [us for us, armed in truth.beats if armed]
    for fault in truth.faults:
        if fault.begun_us < 0 or not armed_at:
            continue
        near = [us for us in armed_at if abs(us - fault.begun_us) < 250_000]
        lasts = fault.end_s - fault.begun_us * 1e-6
        if not near:
            continue
        if fault.layer == "controller":
            yield fault.name, fault.begun_us, COMMANDED_US
        elif fault.layer == "sensor" and lasts > 0.35:
            before = _kpa_at(truth, fault.begun_us)
            if (
                fault.kind in ("high", "silent")
                or (fault.kind == "frozen" and before > EMPTY_KPA)
                or (fault.kind == "low" and before > tellable_kpa(truth.protocol))
            ):
                yield fault.name, fault.begun_us, COMMANDED_US
    if not any(f.layer == "sensor" for f in truth.faults) and truth.us is not None:
        over = truth.kpa > truth.trip_kpa + 3.0
        runs = np.flatnonzero(over[2:] & over[1:-1] & over[:-2])
        if len(runs) and armed_at and armed_at[0] < truth.us[runs[0]] <= truth.done_us:
            yield "over-pressure", int(truth.us[runs[0]]), OVER_PRESSURE_US


def _blind(truth: Truth, verdict: Verdict) -> None:
    """A sensor that reads nothing must not have the muscle filled for long."""
    for fault in truth.faults:
        if fault.layer == "sensor" and fault.kind == "low" and fault.begun_us >= 0:
            inside = (truth.us >= fault.begun_us) & (truth.us < fault.end_s * 1e6)
            # What comes in while the inlet falls shut is the valve's.
            inside &= ~_venting(truth)
            rose = float(truth.kpa[inside].max() if inside.any() else 0.0) - _kpa_at(
                truth, fault.begun_us
            )
            if rose > BLIND_KPA:
                verdict.late.append(f"filled by {rose:.0f} kPa while the sensor read nothing")


def _venting(truth: Truth) -> Any:
    """Whether the outlet is told to stay open, for each of the bench's times."""
    at = np.searchsorted([us for us, _ in truth.vents], truth.us, side="right") - 1
    return np.array([venting for _, venting in truth.vents])[np.maximum(at, 0)] & (at >= 0)


def _still_emptying(truth: Truth) -> bool:
    """Whether the air has had less time than it needs since it could go."""
    if not truth.vents[-1][1]:
        return False
    since_us = max(truth.sealed_us, truth.vents[-1][0])
    needs_s = empty_s(truth.protocol, _kpa_at(truth, since_us))
    return float(truth.us[-1]) < since_us + (needs_s * 1e6)


def _kpa_at(truth: Truth, us: int) -> float:
    at = int(np.searchsorted(truth.us, us))
    return float(truth.kpa[min(at, len(truth.kpa) - 1)])


def _venting_from(truth: Truth, event_us: int) -> int | None:
    """When the outlet was first told to stay open, at or after an event; the event if it was."""
    state = False
    for us, venting in truth.vents:
        if us <= event_us:
            state = venting
        elif state:
            return event_us
        elif venting:
            return us
    return event_us if state else None


def _emptied(truth: Truth, verdict: Verdict) -> None:
    """From each vent that lasts to below 20 kPa."""
    if truth.us is None or any(f.layer in ("valve", "supply") for f in truth.faults):
        return
    ends = [us for us, _ in truth.vents[1:]] + [10**15]
    for (us, venting), end_us in zip(truth.vents, ends, strict=True):
        inside = (truth.us >= us) & (truth.us < end_us) & (truth.us <= truth.done_us + 3_000_000)
        if not venting or not inside.any():
            continue
        # The inlet falls shut meanwhile: from the highest pressure of the first moments on.
        limit_s = empty_s(truth.protocol, float(truth.kpa[inside][:STRETCH_MS].max()))
        if inside.sum() < limit_s * 1000:
            continue
        high = np.flatnonzero(truth.kpa[inside] >= EMPTY_KPA)
        if not len(high):
            continue
        # Stretches of pressure: the first has to end in time, and none may follow. What lasts a
        # few milliseconds is a person who takes a load off the vented muscle.
        parts = np.split(high, np.flatnonzero(np.diff(high) > STRETCH_MS) + 1)
        back = [part for part in parts[1:] if len(part) > STRETCH_MS]
        if back:
            verdict.late.append(f"pressure came back for {len(back[0])} ms")
        took_s = float(parts[0][-1]) * 1e-3 if parts[0][0] < STRETCH_MS else 0.0
        verdict.worst_empty_s = max(verdict.worst_empty_s, took_s)
        if took_s > limit_s:
            verdict.late.append(f"still {EMPTY_KPA:g} kPa {took_s:.2f} s after the command")


# ---- readable -----------------------------------------------------------------------


def _readable(truth: Truth, record: Bytes, verdict: Verdict) -> None:
    """All that the record took is on the disk as it was, by Arrow and JSON and by the package."""
    from daq.store.run import open_run
    from daq.store.verify import verify

    run = open_run(record.folder)
    broken_disk = any(f.layer == "disk" and f.hits for f in truth.faults)
    for problem in verify(run):
        if not problem.tail and not (broken_disk and "writing failed" in problem.what):
            verdict.unreadable.append(str(problem))
    for stream, taken in truth.taken.items():
        first = truth.first_row[stream]
        last = first + len(next(iter(taken.values())))
        for how, rows in (("arrow", record.rows(stream)), ("pamrig", run.samples(stream))):
            there = len(next(iter(rows.values()))) if rows else 0
            if there < last:
                verdict.unreadable.append(f"{last - there} rows of {stream} are gone ({how})")
                continue
            for name, values in taken.items():
                if not np.array_equal(rows[name][first:last], values):
                    verdict.unreadable.append(f"{stream}.{name} reads otherwise ({how})")
    kinds = {e["n"]: e["kind"] for e in record.events}
    gone = [f"{kind} ({n})" for n, kind in truth.events if kinds.get(n) != kind]
    if gone:
        verdict.unreadable.append(f"{len(gone)} events are gone, the first: {gone[0]}")
    pictures = record.pictures()
    for number, crc, _ in truth.frames:
        found = {pictures.get(number, b""), _stored(run, number)}
        if {zlib.crc32(jpeg) for jpeg in found} != {crc}:
            verdict.unreadable.append(f"picture {number} is gone or reads otherwise")
    _counts(truth, verdict)


def _stored(run: Any, number: int) -> bytes:
    try:
        return bytes(run.frame_bytes(number))
    except RecordError:
        return b""


def _counts(truth: Truth, verdict: Verdict) -> None:
    """Recorded pressure counts against the true pressure of the same millisecond."""
    valve = truth.taken.get("valve")
    if not valve:
        return
    us = valve["device_us"] - truth.start0_us
    seen = (valve["boot"] == valve["boot"][0]) & (us >= truth.us[0])
    for fault in truth.faults:
        if fault.layer == "sensor" and fault.begun_us >= 0:
            after = (us > fault.ended_us + TICK_US) & (fault.ended_us >= 0)
            seen &= (us < fault.begun_us - TICK_US) | after
    at = np.minimum(np.searchsorted(truth.us, us), len(truth.us) - 1)
    strange = seen & (truth.us[at] != us)
    if strange.any():
        verdict.wrong.append(f"{int(strange.sum())} samples bear times at which none was taken")
    true, read = truth.kpa[at], valve["counts"] * (1000.0 / 4095.0)
    seen &= ~strange & (true > RANGE_KPA[0]) & (true < RANGE_KPA[1])
    if seen.sum() < LEAST_SAMPLES:
        return
    # The bench's own zero and gain error is in all of them.
    line = _zero_and_gain(true[seen], read[seen])
    off = np.abs(read - np.polyval(line, true))[seen]
    if off.max() > SAMPLE_SIGMAS * truth.noise_kpa + 1.0 or abs(line[0] - 1.0) > 0.05:
        verdict.wrong.append(f"a pressure sample is {off.max():.1f} kPa off")


def _zero_and_gain(true: Any, read: Any) -> Any:
    """Gain and zero of the bench's sensor; where the pressure hardly changed, the zero alone."""
    if np.ptp(true) < LEAST_SPAN_KPA:
        return np.array([1.0, np.mean(read - true)])
    return np.polyfit(true, read, 1)


__all__ = ["FOR_GOOD", "SIGMAS", "Bytes", "Verdict", "judge", "told"]
