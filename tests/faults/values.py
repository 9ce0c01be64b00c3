"""The numbers of a faulted run's table against the simulation's truth, and the run gone on with."""

from __future__ import annotations

import math
import shutil
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from analysis.run_table import reduce_run
from cli.protocols.resume import continue_run
from daq.errors import PamrigError
from daq.store.run import open_run

from .judge import SIGMAS, Bytes, Verdict
from .places import CLASSES
from .trial import BENCH_SEEDS, Truth, run_trial

AROUND_US = 250_000
UNTOUCHED = ("wire", "instrument", "camera", "disk", "process", "clock", "sensor")
"""Faults that do not change what the bench does, only what is seen of it."""
WORDS = ("order", "trial", "repeat", "n_samples", "settled", "set_", "from_", "u_", "switchings")
ALLOWED: dict[str, float] = {}
STEP_TIMES = ("rise_s", "settle_s")
BAND_KPA = 0.03 * 550.0
"""A step has settled within 3 % of the supply that step-short names."""
STEP_US = 1_000_000
"""Each step of step-short has so long, also where the program hung and looked at less of it."""
SMOOTH_MS = 5
"""Over so many samples a step's table averages before it takes times."""
HUNG_MOST_US = 3_050_000
"""As long as a hung program stands still at most."""
FLOW_US = 1_000_000
MASS_KG = 0.002
"""What a dead weight may differ from the one that is read at the load cell's resolution."""


def check_values(truth: Truth, verdict: Verdict, work: Path) -> None:
    """Look at every row of the table that claims to be good."""
    if not truth.folder:
        return
    try:
        reduction = reduce_run(open_run(truth.folder))
    except PamrigError as error:
        if not any(f.layer == "disk" and f.hits for f in truth.faults):
            verdict.wrong.append(f"no table: {error}")
        return
    table = reduction.table
    verdict.points = len(table)
    events = {e["order"]: e for e in Bytes(Path(truth.folder)).kind("point")}
    for row in table.to_dict("records"):
        point = events[row["order"]]
        if CLASSES[truth.protocol] == "static":
            _static(truth, row, point, verdict)
        elif not _bench_as_ever(truth, point):
            continue
        elif truth.protocol == "flow":
            _flow(truth, row, point, verdict)
        elif truth.protocol == "ram":
            _ram(truth, row, point, verdict)
        else:
            if truth.protocol == "step":
                check_step(truth, row, point, verdict)
            _like_without_fault(truth, row, work, verdict)


def _static(truth: Truth, row: dict[str, Any], point: dict[str, Any], verdict: Verdict) -> None:
    """Mean truth over the window of the point, in the unit of each column."""
    if not truth.taken.get("valve"):
        return
    window = _window_us(truth, point)
    restarts = [f.begun_us for f in truth.faults if f.layer == "controller" and f.begun_us >= 0]
    if restarts and min(restarts) < window[1]:
        # A test that was armed ends there; before that device time begins anew.
        if any(armed and us < restart for restart in restarts for us, armed in truth.beats):
            verdict.wrong.append(f"point {row['order']} after the controller had restarted")
        return
    inside = (truth.us >= window[0]) & (truth.us < window[1])
    wide = (truth.us >= window[0] - AROUND_US) & (truth.us < window[1] + AROUND_US)
    if not inside.any():
        return
    if not _reads_nothing(truth, window):
        _compare(
            row, "pressure_kpa", truth.kpa[inside].mean(), np.ptp(truth.kpa[wide]), 0.3, verdict
        )
    track = np.array(truth.track)
    near = (track[:, 0] >= window[0] - AROUND_US) & (track[:, 0] < window[1] + AROUND_US)
    pull, hung = track[near, 2], track[near, 3]
    if "mass_kg" not in row or row.get("mass_kg") is None or math.isnan(row["mass_kg"]):
        _compare(row, "force_n", pull.mean(), np.ptp(pull), 0.05, verdict)
    elif abs(row["mass_kg"] - hung.mean()) > MASS_KG + SIGMAS * row["u_force_n"] / 9.8:
        verdict.wrong.append(
            f"point {row['order']}: {row['mass_kg']:.4g} kg, {hung.mean():.4g} hung"
        )
    exposed = {number: length for number, _, length in truth.frames}
    seen = [exposed[number] for number in point["frames"] if number in exposed]
    if seen:
        _compare(row, "length_mm", np.mean(seen), np.ptp(seen), 0.01, verdict)


def _window_us(truth: Truth, point: dict[str, Any]) -> list[int]:
    """Bench time of a point's range of samples, before any restart."""
    valve = truth.taken["valve"]
    seq0, us0 = int(valve["seq"][0]), int(valve["device_us"][0]) - truth.start0_us
    return [us0 + (s - seq0) * 1000 for s in point["valve_seq"]]


def _reads_nothing(truth: Truth, window: list[int]) -> bool:
    """A wire that broke where 0 may be a pressure: nobody can tell (safety contract)."""
    return any(
        f.layer == "sensor" and f.kind == "low"
        and 0 <= f.begun_us < window[1] and f.end_s * 1e6 > window[0]
        for f in truth.faults
    )  # fmt: skip


def _compare(
    row: dict[str, Any], name: str, true: float, moved: float, least: float, verdict: Verdict
) -> None:
    value = row[name]
    if not math.isfinite(value):
        return  # said to be missing
    allowed = SIGMAS * row[f"u_{name}"] + moved + least
    if abs(value - true) > allowed:
        verdict.wrong.append(
            f"point {row['order']}: {name} {value:.4g}, true {true:.4g}, allowed {allowed:.2g}"
        )


def _flow(truth: Truth, row: dict[str, Any], point: dict[str, Any], verdict: Verdict) -> None:
    """Pressure falls while velocity is read: at some moment of the opening both were as stated."""
    if not row["settled"]:
        return
    until_us = truth.bench_us(point["t_ns"])
    track = np.array(truth.track)
    from_us = until_us - FLOW_US - _stood_still_us(truth, until_us)
    near = track[(track[:, 0] > from_us) & (track[:, 0] <= until_us)]
    middle = (near[1:, 0] + near[:-1, 0]) / 2
    speed = np.diff(near[:, 4]) / (np.diff(near[:, 0]) * 1e-6)
    kpa = truth.kpa[np.minimum(np.searchsorted(truth.us, middle), len(truth.us) - 1)]
    off = [
        np.abs(seen - row[name]) / (SIGMAS * row[f"u_{name}"] + 0.01 * row[name])
        for name, seen in (("pressure_kpa", kpa), ("velocity_m_s", speed))
    ]
    worst = np.maximum(*off).min()
    if worst > 1.0:
        verdict.wrong.append(
            f"point {row['order']}: {row['velocity_m_s']:.4g} m/s at {row['pressure_kpa']:.4g} kPa"
            f" never was: {worst:.2g} times what is allowed"
        )


def _stood_still_us(truth: Truth, until_us: float) -> float:
    """For how long the program hung before that: its point is recorded later by as much."""
    hung = [f for f in truth.faults if (f.layer, f.kind) == ("process", "hung") and f.hits]
    return sum(HUNG_MOST_US for f in hung if 0 <= f.begun_us < until_us)


def _ram(truth: Truth, row: dict[str, Any], point: dict[str, Any], verdict: Verdict) -> None:
    """When the proximity switch really came on, and what the pressure was at the end."""
    if not row["settled"]:
        return
    asked_us, until_us = truth.bench_us(point["asked_t_ns"]), truth.bench_us(point["t_ns"])
    bit = {"A": 1, "B": 2}[row["switch"]]
    came, was_on = math.nan, False
    for us, bits in truth.prox:
        on = bool(bits & bit)
        if asked_us <= us <= until_us and on and not was_on:
            came = us
            break
        was_on = on
    reach = (came - asked_us) * 1e-6
    allowed = SIGMAS * row["u_reach_s"] + 0.003
    if not abs(row["reach_s"] - reach) <= allowed:
        verdict.wrong.append(
            f"point {row['order']}: reach_s {row['reach_s']:.4g}, true {reach:.4g}, "
            f"allowed {allowed:.2g}"
        )
        return
    end_us = came + row["hold_s"] * 1e6
    inside = (truth.us >= end_us - 0.2e6 * row["hold_s"]) & (truth.us < end_us)
    if inside.any():
        kpa = truth.kpa[inside]
        _compare(row, "pressure_kpa", kpa.mean(), np.ptp(kpa), 0.3, verdict)


def check_step(truth: Truth, row: dict[str, Any], point: dict[str, Any], verdict: Verdict) -> None:
    """When the true pressure rose and settled; where it grazes a bound, either side of that.

    A scheme's periods go on by the controller's clock: from one run to the next a set-point falls
    elsewhere into them, and the response is some milliseconds earlier or later.
    """
    asked_us = truth.bench_us(point["asked_t_ns"])
    until_us = max(_window_us(truth, point)[1], asked_us + STEP_US)
    kpa = truth.kpa[(truth.us >= asked_us) & (truth.us < until_us)]
    goal, before = point["set_pressure_kpa"], point["from_kpa"]
    graze = SIGMAS * math.hypot(row["u_error_kpa"], truth.noise_kpa / math.sqrt(SMOOTH_MS))
    way, off = (kpa - before) * math.copysign(1.0, goal - before), np.abs(kpa - goal)
    rise = [_first(way >= 0.9 * abs(goal - before) + g) for g in (-graze, graze)]
    settle = [len(kpa) - _first(off[::-1] > BAND_KPA + g) for g in (graze, -graze)]
    for name, (least, most) in (("rise_s", rise), ("settle_s", settle)):
        ms = 1e3 * row[name]
        if ms < least - SMOOTH_MS or ms > most + SMOOTH_MS:
            verdict.wrong.append(
                f"point {row['order']}: {name} {row[name]:.4g}, truly {least} to {most} ms"
            )


def _first(reached: Any) -> int:
    return int(np.argmax(reached)) if reached.any() else len(reached)


def _bench_as_ever(truth: Truth, point: dict[str, Any]) -> bool:
    """Whether up to this point the bench itself did what it does without a fault."""
    until_us = truth.bench_us(point["t_ns"])
    return all(
        f.begun_us < 0 or f.begun_us > until_us
        or (f.layer in UNTOUCHED and (f.layer, f.kind) != ("sensor", "low"))
        for f in truth.faults
    )  # fmt: skip


@lru_cache(maxsize=500)
def reference(protocol: str, bench: int, work: Path) -> dict[int, dict[str, Any]]:
    """Rows of the same bench without any fault, by order."""
    truth = run_trial(protocol, bench - BENCH_SEEDS, work, [])
    assert truth.outcome == "clean", (truth.error, truth.crashed)
    table = reduce_run(open_run(truth.folder)).table
    shutil.rmtree(work / "runs" / f"{protocol}-{bench - BENCH_SEEDS}", ignore_errors=True)
    return {row["order"]: row for row in table.to_dict("records")}


def _like_without_fault(truth: Truth, row: dict[str, Any], work: Path, verdict: Verdict) -> None:
    """As the same bench gives it without a fault: noise is all that differs."""
    if not row["settled"]:
        return
    known = reference(truth.protocol, truth.seed % BENCH_SEEDS, work)[row["order"]]
    for name, value in row.items():
        if not isinstance(value, float) or name.startswith(WORDS) or name in STEP_TIMES:
            continue
        other = known[name]
        if not math.isfinite(value) or not math.isfinite(other):
            continue
        u = math.hypot(row.get(f"u_{name}") or 0.0, known.get(f"u_{name}") or 0.0)
        allowed = SIGMAS * u + ALLOWED.get(name, 0.02 * abs(other) + 1e-3)
        if abs(value - other) > allowed:
            verdict.wrong.append(
                f"point {row['order']}: {name} {value:.4g}, without fault {other:.4g}, "
                f"allowed {allowed:.2g}"
            )


def check_continuing(truth: Truth, verdict: Verdict) -> None:
    """Where the run did not come to its end: it is gone on with, and the table is whole then."""
    if not truth.folder or truth.outcome == "clean":
        return
    try:
        run = open_run(truth.folder)
        if run.outcome == "clean":
            return
        result = continue_run(run)
        table = reduce_run(open_run(result.folder)).table
    except PamrigError as error:
        verdict.stuck.append(str(error))
        return
    verdict.continued = True
    if result.outcome != "clean":
        verdict.stuck.append(f"{result.outcome}: {result.error}")
    elif sorted(table["order"]) != list(range(1, truth.planned + 1)):
        verdict.stuck.append(f"points {sorted(table['order'])} of {truth.planned}")
