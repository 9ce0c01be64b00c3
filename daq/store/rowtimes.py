"""Rows of a controller of one's own (`pamrig record`): their times and quantities.

When was a row measured? By the controller's own time, or by the arrival of its line.

With its own time: delays only make lines later, so that the clock runs along the lower edge of
arrival against own time. The line below all points with the smallest sum of distances is the edge
of their lower convex hull above the mean time. The smallest delay itself cannot be seen: there is
no ping.

Without: a line was printed after the bytes before it had come and before it came itself.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.link.loweredge import lower_edge
from daq.store.run import Run

Array = npt.NDArray[np.float64]
STREAM = "columns"

BITS = 10
"""Of a byte on a serial line: start, eight, stop."""
LEAST = 20
"""Rows from which a clock is fitted."""
TYPICAL = 0.99


@dataclass(frozen=True)
class Times:
    """Times of all rows, and how well they are known.

    Attributes:
        method: "own time" or "arrival".
        time_s: host time of each row, s, shape (n,).
        bound_s: how much earlier each may have been, s, shape (n,).
        u_between_s: standard uncertainty of the time between two rows.
        u_host_s: that of the time of a row on the host's clock.
        drift_ppm: rate of its clock relative to the host's; nan where it has none.
        delay_s: 99 % of the lines came within this after the fastest; nan without own time.
    """

    method: str
    time_s: Array
    bound_s: Array
    u_between_s: float
    u_host_s: float
    drift_ppm: float
    delay_s: float

    def as_dict(self) -> dict[str, Any]:
        """All but the arrays, None for nan."""
        values = {k: v for k, v in asdict(self).items() if k not in ("time_s", "bound_s")}
        return {k: None if v != v else v for k, v in values.items()}


def line_s(characters: float, baud: int) -> float:
    """How long a line takes on a serial wire."""
    return characters * BITS / baud


def times(
    host_s: Array, waited_s: Array, own_s: Array, tick_s: float, wire_s: float, latency_s: float
) -> Times:
    """Times of rows.

    Args:
        host_s: arrival of each line, shape (n,).
        waited_s: time since the bytes before it, shape (n,).
        own_s: time that the controller printed, without overflow; nan where it has none.
        tick_s: smallest step of its own time.
        wire_s: how long a line takes on the wire.
        latency_s: how long the adapter may hold bytes back.
    """
    if len(host_s) < LEAST or np.isnan(own_s).any():
        bound = waited_s + latency_s
        typical = float(np.quantile(bound, TYPICAL)) if len(bound) else math.nan
        u_host = typical / math.sqrt(12.0)
        return Times(
            "arrival", host_s - wire_s - bound / 2.0, bound, u_host * math.sqrt(2.0), u_host,
            math.nan, math.nan,
        )  # fmt: skip
    begin, slope = lower_edge(own_s - own_s[0], host_s)
    fitted = begin + slope * (own_s - own_s[0])
    delay = float(np.quantile(host_s - fitted, TYPICAL))
    span = float(own_s[-1] - own_s[0])
    # The edge touches two points; each is late by at most a small part of the usual delay.
    quick = float(np.quantile(host_s - fitted, 0.05))
    u_between = math.hypot(tick_s * math.sqrt(2.0 / 12.0), quick / math.sqrt(12.0))
    u_host = math.hypot(latency_s / math.sqrt(12.0), u_between)
    return Times(
        "own time", fitted - wire_s - latency_s / 2.0, np.full(len(host_s), latency_s),
        u_between, u_host, (1.0 / slope - 1.0) * 1e6 if span > 0.0 else math.nan, delay,
    )  # fmt: skip


@dataclass(frozen=True)
class Rows:
    """All rows of a recording.

    Attributes:
        times: when each was measured.
        time_s: since the first row, s, shape (n,).
        first_s: time of the first row since the start of the run, on the computer's clock.
        quantities: in the order of the columns, shape (n,) each, by name with unit.
    """

    times: Times
    time_s: Array
    first_s: float
    quantities: dict[str, Array]


def recorded_rows(run: Run) -> Rows:
    """The rows of a run that `pamrig record` made, from its record alone.

    A recording of an earlier version states no ``timing``. Its times between rows are the same;
    the part of the uncertainty that the adapter adds is missing.

    Raises:
        RecordError: run.json is damaged.
        KeyError, TypeError, ValueError: another program wrote the record.
    """
    raw = run.samples(STREAM)
    timing = run.manifest.get("timing") or {"tick_s": 1e-3, "wire_s": 0.0, "latency_s": 0.0}
    own_s = np.asarray(raw.get("own_s", ()), dtype=np.float64)
    host_s = np.asarray(raw.get("host_ns", ()), dtype=np.float64) * 1e-9
    waited_s = np.asarray(raw.get("waited_ns", ()), dtype=np.float64) * 1e-9
    found = times(
        host_s, waited_s, own_s,
        float(timing["tick_s"]), float(timing["wire_s"]), float(timing["latency_s"]),
    )  # fmt: skip
    first_s = float(found.time_s[0]) if len(found.time_s) else 0.0
    calibrations = run.calibrations
    quantities = {
        name: np.asarray(calibrations[name].apply(np.asarray(raw[name], dtype=np.float64)))
        for name in run.manifest["columns"]
        if name in calibrations and name in raw
    }
    start_s = int(run.manifest["started"]["monotonic_ns"]) * 1e-9
    return Rows(found, found.time_s - first_s, first_s - start_s, quantities)
