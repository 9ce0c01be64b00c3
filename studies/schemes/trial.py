"""Steps of the set-point with one scheme: the scheme object of the firmware on the plant.

The scheme runs as in the firmware (one step per millisecond, on noisy 12-bit readings, with valve
times counted down), but without wire, telemetry and monitoring, so that a study of thousands of
steps takes minutes. `tests/test_study_trial.py` compares it with the complete firmware, tick by
tick.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.physics.layout import LENGTH, PRESSURE
from plant.simulator.bench import FINE_STEP_SHARE, BenchSim
from rigs.virtual.board import as_printed as asprinted
from rigs.virtual.board.pressure_sensor import ADC_TOP
from rigs.virtual.board.tuning import burst_parameters
from valvefw.config import defaults
from valvefw.schemes.bothduty import BothDuty
from valvefw.schemes.burst import Burst
from valvefw.schemes.inletduty import InletDuty
from valvefw.schemes.scheme import Scheme
from valvefw.schemes.sliding import Sliding
from valvefw.schemes.twoposition import TwoPosition
from valvefw.schemes.valves import Valves

SCHEMES: dict[str, Callable[[int], Scheme]] = {
    "two": lambda baud: TwoPosition(),
    "duty_in": lambda baud: InletDuty(),
    "duty": lambda baud: BothDuty(),
    "slide": lambda baud: Sliding(),
    "burst": lambda baud: Burst(),
    "two_as_printed": asprinted.TwoPositionAsPrinted,
    "duty_in_as_printed": asprinted.InletDutyAsPrinted,
    "duty_as_printed": asprinted.BothDutyAsPrinted,
    "slide_as_printed": asprinted.SlidingAsPrinted,
}
INTENDED = ("two", "duty_in", "duty", "slide")
TITLES = {
    "two": "two-position",
    "duty_in": "PWM of the inlet",
    "duty": "PWM of both",
    "slide": "sliding mode",
    "burst": "bursts (pamrig)",
}
TICK_US = 1000


@dataclass(frozen=True)
class Bench:
    """Plant, load, firmware parameters and converter of a trial.

    `load` is "held" (at `length_mm`) or "hung" (`mass_kg`). `range_kpa` is the full scale of the
    converter, `baud` the rate of the serial output in the listings, `step_share` the integration
    step relative to the normal step.
    """

    constants: PlantConstants
    load: str = "held"
    length_mm: float = 60.0
    mass_kg: float = 3.0
    noise_kpa: float = 0.5
    range_kpa: float = 1000.0
    baud: int = asprinted.BAUD
    step_share: float = FINE_STEP_SHARE
    parameters: Mapping[str, int] = field(default_factory=dict)

    def plant(self) -> BenchSim:
        """A fresh plant, vented."""
        if self.load == "hung":
            return BenchSim(
                self.constants,
                load="isotonic",
                length_m=0.070,
                mass_kg=self.mass_kg,
                step_share=self.step_share,
            )
        return BenchSim(self.constants, length_m=self.length_mm * 1e-3, step_share=self.step_share)


@dataclass(frozen=True)
class Trace:
    """True state every millisecond from the start of the step; kPa, mm, solenoids 0 or 1."""

    goal_kpa: float
    supply_kpa: float
    pressure_kpa: Array
    length_mm: Array
    inlet: npt.NDArray[np.bool_]
    vent: npt.NDArray[np.bool_]

    def figures(self, last_s: float = 1.0) -> dict[str, float]:
        """Figures of merit, in % of supply except times and switchings.

        Over the last `last_s`: error of the mean, rms difference from the set-point, ripple (range
        of the pressure), switchings per second, length_ripple_mm (range of the length). Over the
        step: overshoot beyond the set-point, rise_s until first within 5 % of supply, settle_s
        until it stays there (NaN if it does not).
        """
        n = round(last_s * 1000)
        tail = self.pressure_kpa[-n:]
        off = self.pressure_kpa - self.goal_kpa
        start = self.pressure_kpa[0] - self.goal_kpa
        past = off.max() if start < 0 else -off.min()
        near = np.abs(off) <= 0.05 * self.supply_kpa
        share = 100.0 / self.supply_kpa
        away = np.flatnonzero(~near)
        settle = (away[-1] + 1) * 1e-3 if len(away) else 0.0
        edges = sum(int(np.count_nonzero(np.diff(v[-n:].astype(int)) > 0)) for v in
                    (self.inlet, self.vent))  # fmt: skip
        return {
            "error": abs(float(tail.mean()) - self.goal_kpa) * share,
            "rms": float(np.sqrt(np.mean((tail - self.goal_kpa) ** 2))) * share,
            "ripple": float(np.ptp(tail)) * share,
            "overshoot": max(0.0, float(past)) * share,
            "rise_s": float(np.argmax(near)) * 1e-3 if near.any() else float("nan"),
            "settle_s": settle if settle < len(off) * 1e-3 - 0.2 else float("nan"),
            "switchings": edges / last_s,
            "length_ripple_mm": float(np.ptp(self.length_mm[-n:])),
        }


def run_trial(
    bench: Bench,
    scheme: str,
    steps: tuple[float, ...],
    step_s: float = 3.0,
    seed: int = 1,
    plant: Any = None,
) -> list[Trace]:
    """Run set-points (relative to supply) one after the other; returns one trace each."""
    c = bench.constants
    plant = plant or bench.plant()
    law = SCHEMES[scheme](bench.baud)
    law.start(
        {**defaults(), **burst_parameters(c, full_scale_kpa=bench.range_kpa), **bench.parameters}
    )
    rng = np.random.default_rng([seed, 77])
    supply = c.supply_pa * 1e-3
    ticks = round(step_s * 1000)
    advance, state, params = plant._advance, plant.state, plant.params
    read, step = state.item, law.step
    per_kpa = ADC_TOP / bench.range_kpa
    per_pa = per_kpa * 1e-3
    valves = Valves()
    counts = 0
    found = []
    for share in steps:
        goal_x16 = round(share * supply * per_kpa * 16)
        noise = (rng.standard_normal(ticks) * bench.noise_kpa * per_kpa + 0.5).tolist()
        pressure, length = np.empty(ticks), np.empty(ticks)
        inlet, vent = np.zeros(ticks, np.bool_), np.zeros(ticks, np.bool_)
        for tick in range(ticks):
            # As the firmware: what was requested at the reading before takes effect now.
            inlet_us, vent_us = valves.inlet_us, valves.vent_us
            valves.inlet_us = inlet_us - TICK_US if inlet_us > TICK_US else 0
            valves.vent_us = vent_us - TICK_US if vent_us > TICK_US else 0
            step(counts, goal_x16, TICK_US, valves)
            inlet[tick], vent[tick] = inlet_us > 0, vent_us > 0
            advance(
                state,
                params,
                1e-3,
                1e-3 if inlet_us >= TICK_US else inlet_us * 1e-6,
                1e-3 if vent_us >= TICK_US else vent_us * 1e-6,
            )
            pa = read(PRESSURE)
            pressure[tick], length[tick] = pa, read(LENGTH)
            counts = min(max(int(pa * per_pa + noise[tick]), 0), ADC_TOP)
        found.append(Trace(share * supply, supply, pressure * 1e-3, length * 1e3, inlet, vent))
    return found


def summary(traces: list[Trace]) -> dict[str, tuple[float, float, int]]:
    """Mean, standard deviation and number of each figure over traces, without NaN."""
    rows = [t.figures() for t in traces]
    out = {}
    for key in rows[0]:
        values = np.array([row[key] for row in rows])
        values = values[np.isfinite(values)]
        if len(values):
            sd = float(values.std(ddof=1)) if len(values) > 1 else 0.0
            out[key] = (float(values.mean()), sd, len(values))
        else:
            out[key] = (float("nan"), float("nan"), 0)
    return out
