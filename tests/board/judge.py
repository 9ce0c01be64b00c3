"""Acceptance figures: limits, and what of the results misses them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

SAMPLING_US = 20.0  # p99.9 of the deviation from 1 ms
STEP_US = 150.0
BUSY = 0.70
VENT_MS = 3.0  # after the third reading above the limit
SILENT_MS = (300.0, 310.0)
PULSE_US = 20.0  # edge to edge, from the width asked for
RELEASED_MS = 21.0  # after the last word: 20 ms, and the tick it was in
CAUSES = {
    "over": ("over_pressure",),
    "silent": ("host_silent",),
    "garbage": ("host_silent",),
    "rail": ("over_pressure", "sensor_saturated"),
    "constant": ("sensor_stuck",),
    "zero": ("sensor_jump",),
    "hung": ("loop_stalled",),
}
TRIAL_MS = {
    "over": (0.0, VENT_MS),
    "silent": SILENT_MS,
    "garbage": SILENT_MS,
    "rail": (0.0, 6.0),  # from the first wrong reading: three of five
    "constant": (198.0, 205.0),  # stuck_ms; the reading before may by chance be the same
    "zero": (0.0, 15.0),
    "hung": (45.0, 53.0),  # LOOP, from the last pass of the loop on
}


def misses(results: dict[str, dict[str, Any]]) -> list[str]:
    """One line for each figure that misses its limit."""
    out: list[str] = []
    for name, result in results.items():
        if "crashed" in result:
            out.append(f"{name}: no result: {result['crashed'].splitlines()[-1]}")
            continue
        kind = name.partition(":")[0]
        out += [f"{name}: {line}" for line in _OF[kind](result)]
    return out


def _scheme(r: dict[str, Any]) -> Iterator[str]:
    if r["deviation_us"]["p999"] > SAMPLING_US:
        yield f"sampling p99.9 {r['deviation_us']['p999']} us off, limit {SAMPLING_US}"
    for key in ("lost", "cut", "longer", "gaps", "damaged", "overrun"):
        if r[key]:
            yield f"{key} {r[key]}"
    if r["step_us"]["max"] > STEP_US:
        yield f"safety core {r['step_us']['max']} us, limit {STEP_US}"
    if r["busy"] > BUSY:
        yield f"busy {100 * r['busy']:.1f} %, limit {100 * BUSY:.0f} %"
    yield from (*r["errors"], *r["faults"])


def _trials(r: dict[str, Any]) -> Iterator[str]:
    if r["failed"]:
        yield r["failed"]
    low, high = TRIAL_MS[r["trial"]]
    rows = r["rows"]
    outside = [row for row in rows if row["ms"] is None or not low <= row["ms"] <= high]
    if outside:
        times = [row["ms"] for row in outside if row["ms"] is not None]
        span = f", {min(times)} to {max(times)} ms" if times else ""
        yield f"{len(outside)} of {len(rows)} vents outside {low:g} to {high:g} ms{span}"
    wrong = [row["cause"] for row in rows if row["cause"] not in CAUSES[r["trial"]]]
    if wrong:
        yield f"{len(wrong)} of {len(rows)} with another cause: {sorted(set(map(str, wrong)))}"
    early = [row["early"] for row in rows if row.get("early")]
    if early:
        yield f"{len(early)} faults while heartbeats arrived: {sorted(set(early))}"
    late = [row["deviation_us"] for row in rows if row.get("deviation_us", 0.0) > 1000.0]
    if late:
        yield f"{len(late)} times a conversion was lost"
    step = max((row["step_us"] for row in rows), default=0.0)
    if step > STEP_US:
        yield f"safety core {step} us in the step of the fault, limit {STEP_US}"
    if r["errors"]:
        yield f"refused: {sorted(set(r['errors']))[:3]}"


def _pulses(r: dict[str, Any]) -> Iterator[str]:
    for name, figures in r["widths_us"].items():
        wanted = float(name.split()[1])
        if figures is None:
            yield f"{name} us: no whole pulse"
        elif max(figures["max"] - wanted, wanted - figures["min"]) > PULSE_US:
            yield f"{name} us: {figures['min']} to {figures['max']} us at the pin"
    if r["spoiled"]:
        names = sorted({f"{s['valve']} {s['us']}" for s in r["spoiled"]})
        yield f"{len(r['spoiled'])} pulses with other edges than two: {', '.join(names)}"
    for name, edges in r["held_edges"].items():
        if edges:
            yield f"{edges} edges while {name} was held"
    for name, figures in r["released_ms"].items():
        if figures is None or figures["max"] > RELEASED_MS:
            yield f"{name}: coils off after {figures and figures['max']} ms, limit {RELEASED_MS}"


def _memory(r: dict[str, Any]) -> Iterator[str]:
    for scheme, span in r["spans"].items():
        if any(span["bytes"]):
            yield f"{scheme}: {span['per_tick']} B a tick"
    yield from (*r["faults"], *r["errors"])


def _conformance(r: dict[str, Any]) -> Iterator[str]:
    for wrong in r["wrong"]:
        yield f"{wrong['conversation']}, call {wrong['call']}: other bytes than CPython's"


_OF = {
    "schemes": _scheme,
    "inputs": lambda r: _memory(r) if "spans" in r else _scheme(r),
    "trials": _trials,
    "pulses": _pulses,
    "memory": _memory,
    "conformance": _conformance,
}
