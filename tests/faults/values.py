"""The numbers of a faulted run's table against the simulation's truth, and the run gone on with."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import PamrigError
from daq.run import open_run
from rigs.continuing import continue_run
from rigs.segments import reduce_run

from .judge import SIGMAS, Bytes, Verdict
from .places import CLASSES
from .trial import Truth, run_trial

AROUND_US = 250_000
REFERENCES = 6
UNTOUCHED = ("wire", "instrument", "camera", "disk", "process", "clock")
"""Faults that do not change what the bench does, only what is seen of it."""
WORDS = ("order", "trial", "repeat", "n_samples", "settled", "set_", "from_", "u_", "switchings")


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
    static = CLASSES[truth.protocol] == "static"
    for row in table.to_dict("records"):
        if static:
            _static(truth, row, events[row["order"]], verdict)
        elif all(f.layer in UNTOUCHED for f in truth.faults):
            _like_the_others(truth, row, work, verdict)


def _static(truth: Truth, row: dict[str, Any], point: dict[str, Any], verdict: Verdict) -> None:
    """Mean truth over the window of the point, in the unit of each column."""
    valve = truth.taken["valve"]
    if not valve:
        return
    seq0, us0 = int(valve["seq"][0]), int(valve["device_us"][0]) - truth.start0_us
    window = [us0 + (s - seq0) * 1000 for s in point["valve_seq"]]
    if any(f.layer == "controller" and f.hits for f in truth.faults):
        return  # device time begins anew; the run ends there
    inside = (truth.us >= window[0]) & (truth.us < window[1])
    wide = (truth.us >= window[0] - AROUND_US) & (truth.us < window[1] + AROUND_US)
    if not inside.any():
        return
    lied_to = any(f.layer == "sensor" and f.hits for f in truth.faults)
    if not lied_to:
        _compare(
            row, "pressure_kpa", truth.kpa[inside].mean(), np.ptp(truth.kpa[wide]), 0.3, verdict
        )
    track = np.array(truth.track)
    near = (track[:, 0] >= window[0] - AROUND_US) & (track[:, 0] < window[1] + AROUND_US)
    if "mass_kg" not in row or row.get("mass_kg") is None or math.isnan(row["mass_kg"]):
        _compare(row, "force_n", track[near, 2].mean(), np.ptp(track[near, 2]), 0.05, verdict)
    seen = [truth.frame_mm[f - truth.first_frame] for f in point["frames"]
            if 0 <= f - truth.first_frame < len(truth.frame_mm)]  # fmt: skip
    if seen:
        now = track[near, 1]
        _compare(row, "length_mm", now.mean(), np.ptp([*now, *seen]), 0.02, verdict)


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


@lru_cache
def references(protocol: str, work: Path) -> dict[int, list[dict[str, Any]]]:
    """Rows of runs without any fault, by order."""
    out: dict[int, list[dict[str, Any]]] = {}
    for seed in range(REFERENCES):
        truth = run_trial(protocol, -1 - seed, work, [])
        assert truth.outcome == "clean", (truth.error, truth.crashed)
        for row in reduce_run(open_run(truth.folder)).table.to_dict("records"):
            out.setdefault(row["order"], []).append(row)
    return out


def _like_the_others(truth: Truth, row: dict[str, Any], work: Path, verdict: Verdict) -> None:
    """Within what runs without a fault spread, several times over."""
    if not row["settled"]:
        return
    others = references(truth.protocol, work)[row["order"]]
    for name, value in row.items():
        if not isinstance(value, float) or name.startswith(WORDS) or not math.isfinite(value):
            continue
        known = np.array([o[name] for o in others if math.isfinite(o[name])])
        if not len(known):
            continue
        u = row.get(f"u_{name}") or 0.0
        allowed = SIGMAS * (u + np.ptp(known)) + 0.05 * abs(known.mean())
        if abs(value - known.mean()) > allowed:
            verdict.wrong.append(
                f"point {row['order']}: {name} {value:.4g}, without fault {known.mean():.4g}, "
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
        result = continue_run(run, derive=False)
        table = reduce_run(open_run(result.folder)).table
    except PamrigError as error:
        verdict.stuck.append(str(error))
        return
    verdict.continued = True
    if result.outcome != "clean":
        verdict.stuck.append(f"{result.outcome}: {result.error}")
    elif sorted(table["order"]) != list(range(1, len(table) + 1)):
        verdict.stuck.append(f"points {sorted(table['order'])}")
