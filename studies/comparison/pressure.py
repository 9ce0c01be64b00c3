"""Pressure control of one muscle at constant length: firmware schemes, and a PID on the host.

The PID (Equation 1-4) has no scheme in the firmware. In each period the host reads the telemetry
(4 ms old) and requests one pulse on one valve with the scheme `open`. The output is a net opening
time in ms to fill or vent. The pulse is longer than that by the difference between opening and
closing delay. An output below half of the shortest opening gives no pulse. The period is 20 ms, or
four times the closing time of the valve. The gains follow the rules of Ziegler and Nichols, from
the critical gain on the same bench.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.finger.reader import load_valve
from plant.simulator.bench import FINE_STEP_SHARE, BenchSim
from rigs.virtual.board.board import SimBoard
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from studies.comparison.spread import Spread, spread
from studies.controllers.pid import Gains, ziegler_nichols
from studies.controllers.tuning import Critical, critical_gain
from valvefw.config import config_crc
from valvefw.wire import encode_frame

LENGTH_M = 0.062
LATE_MS = 4
MARGIN_US = 150
COUNTS_PER_KPA = 4.095
STAIRCASE_KPA = (200.0, 350.0, 450.0, 300.0, 150.0)
STEP_S = 2.0
LAST_S = 0.5
BAND_KPA = 5.0
FIGURES = (
    "error_mean_kpa", "error_worst_kpa", "ripple_worst_kpa", "overshoot_worst_kpa",
    "settling_worst_s", "switchings_per_s",
)  # fmt: skip
PRESSURE_LAWS = ("two", "duty_in", "duty", "slide", "ram", "burst", "pid")


@dataclass(frozen=True)
class PressureFigures:
    """Figures of merit over a staircase of set-points, from the true pressure in kPa.

    Error of the mean and ripple (range) are over the last half second of each 2 s; overshoot is
    beyond the set-point; settling is the time until the pressure stays within 5 kPa, None if a
    step does not settle. Worst and mean are over the steps.
    """

    law: str
    valve: str
    error_mean_kpa: float
    error_worst_kpa: float
    ripple_worst_kpa: float
    overshoot_worst_kpa: float
    settling_worst_s: float | None
    switchings_per_s: float
    fault: str


def rest_ms(c: PlantConstants) -> int:
    """Time after which a valve is closed, with a margin."""
    return max(2, int(np.ceil(1.1e3 * max(c.inlet_off_s, c.outlet_off_s))))


def period_ms(c: PlantConstants) -> int:
    """Period of the PID."""
    return max(20, 4 * rest_ms(c))


class PressureBench:
    """One muscle at a constant length, its board, and a host with heartbeats and requests."""

    def __init__(self, constants: PlantConstants, scheme: str, seed: int = 1) -> None:
        self.board = SimBoard(
            BenchSim(constants, length_m=LENGTH_M, step_share=FINE_STEP_SHARE),
            np.random.default_rng([seed, 83]),
            truth_every=1,
            outlet_normally_open=constants.outlet_normally == "open",
        )
        self._past = deque([0] * (LATE_MS + 1), maxlen=LATE_MS + 1)
        self._beats = 0
        self._ms = 0
        self.switchings = 0
        self._open = [False, False]
        controller = self.board.controller
        controller.values.update(
            {**burst_parameters(constants, 62.0), **safety_parameters(constants)}
        )
        controller.values["inlet_max_ms"] = 2000
        controller.values["inlet_rest_ms"] = rest_ms(constants)
        self.run(50)
        self.request(f"arm {config_crc(controller.values):04x} {controller.telemetry.boot_id}")
        self.run(2)
        self.request(f"scheme {scheme}")
        self.run(2)

    def request(self, text: str) -> None:
        """Send a request; the firmware executes it at the next tick."""
        self.board.feed(encode_frame(f"Q1 {text}".encode()))

    def run(self, ms: int) -> None:
        """Advance the simulation, with heartbeats."""
        for _ in range(ms):
            if self._ms % 100 == 0 and self._ms:
                self._beats += 1
                self.request(f"hb {self._beats}")
            self._ms += 1
            self.board.run_until_us(self.board.bench_us + 1000)
            self._past.append(self.board.adc())
            for side, left in enumerate((self.board._inlet_us, self.board._vent_us)):
                self.switchings += left > 0 and not self._open[side]
                self._open[side] = left >= 1000

    @property
    def reading_kpa(self) -> float:
        """The newest telemetry that the host has."""
        return self._past[0] / COUNTS_PER_KPA

    @property
    def truth_kpa(self) -> Array:
        """True pressure every millisecond since power-on."""
        return np.array(self.board.truth_kpa)


class PulsePid:
    """PID with a net opening time in ms as output: above 0 fill, below 0 vent. Gains: ms/kPa, s."""

    def __init__(self, constants: PlantConstants, gains: Gains) -> None:
        c = constants
        self.gains = gains
        self.period_ms = period_ms(c)
        pressure = (c.inlet_on_s_per_pa - c.inlet_off_s_per_pa) * c.supply_pa
        self._longer_us = [
            1e6 * (c.inlet_on_s - c.inlet_off_s + pressure),
            1e6 * (c.outlet_on_s - c.outlet_off_s),
        ]
        self._least_us = [1e6 * c.inlet_off_s + MARGIN_US, 1e6 * c.outlet_off_s + MARGIN_US]
        # The firmware accepts a pulse only after the last one and its rest time.
        self._most_ms = self.period_ms - rest_ms(c) - 1.0
        self._integral = 0.0
        self._last: float | None = None

    def pulse(self, wanted_kpa: float, reading_kpa: float) -> tuple[str, int]:
        """Valve and width (us) of the next pulse; width 0 for none."""
        step = self.period_ms * 1e-3
        g = self.gains
        error = wanted_kpa - reading_kpa
        slope = 0.0 if self._last is None else (reading_kpa - self._last) / step
        self._last = reading_kpa
        most = self._most_ms
        free = g.kp * (error - g.td_s * slope) + self._integral
        net = min(max(free, -most), most)
        if net == free or error * free < 0.0:
            self._integral += g.kp / g.ti_s * step * error
        side = 0 if net > 0.0 else 1
        open_us = abs(net) * 1e3
        if open_us < 0.5 * self._least_us[side]:
            return "inlet", 0
        open_us = max(open_us, self._least_us[side])
        width = min(open_us + self._longer_us[side], most * 1e3)
        return ("inlet", "vent")[side], int(width // 5 * 5)


def run_pid(
    constants: PlantConstants, gains: Gains, goals_kpa: tuple[float, ...], step_s: float, seed: int
) -> PressureBench:
    """A staircase under the PID."""
    bench = PressureBench(constants, "open", seed)
    law = PulsePid(constants, gains)
    for goal in goals_kpa:
        left = round(step_s * 1000)
        while left > 0:
            valve, width = law.pulse(goal, bench.reading_kpa)
            if width:
                bench.request(f"pulse {valve} {width}")
            bench.run(min(law.period_ms, left))
            left -= law.period_ms
    return bench


def pressure_critical(constants: PlantConstants, rounds: int = 8) -> Critical:
    """Critical gain (ms/kPa) of the pulses in proportion, at 300 kPa after a step of 30."""

    def respond(gain: float) -> tuple[Array, Array]:
        bench = run_pid(constants, Gains(gain, float("inf"), 0.0), (270.0, 300.0), 4.0, 1)
        tail = bench.truth_kpa[-4000:]
        return np.asarray(np.arange(len(tail)) * 1e-3), tail

    return critical_gain(respond, 1e-3, 10.0, 2.0, rounds)


def pressure_case(
    constants: PlantConstants, valve: str, law: str, found: Critical | None = None, seed: int = 1
) -> PressureFigures:
    """Figures of merit of one controller over the staircase."""
    if law == "pid":
        critical = found or pressure_critical(constants)
        gains = ziegler_nichols(critical.gain, critical.period_s)
        bench = run_pid(constants, gains, STAIRCASE_KPA, STEP_S, seed)
    else:
        bench = PressureBench(constants, law, seed)
        for goal in STAIRCASE_KPA:
            bench.request(f"sp {round(goal * COUNTS_PER_KPA * 16)}")
            bench.run(round(STEP_S * 1000))
    samples = round(STEP_S * 1000)
    truth = bench.truth_kpa[-samples * len(STAIRCASE_KPA) :].reshape(len(STAIRCASE_KPA), samples)
    last = truth[:, -round(LAST_S * 1000) :]
    goals = np.array(STAIRCASE_KPA)
    error = np.abs(last.mean(axis=1) - goals)
    before = np.concatenate([[0.0], goals[:-1]])
    past = np.where(goals > before, truth.max(axis=1) - goals, goals - truth.min(axis=1))
    settled: float | None = 0.0
    for row, goal in zip(truth, goals, strict=True):
        outside = np.flatnonzero(np.abs(row - goal) > BAND_KPA)
        if len(outside) and outside[-1] == samples - 1:
            settled = None
            break
        assert settled is not None
        settled = max(settled, (float(outside[-1]) + 1.0) * 1e-3 if len(outside) else 0.0)
    faults = bench.board.controller.safety.faults
    return PressureFigures(
        law,
        valve,
        float(error.mean()),
        float(error.max()),
        float(np.ptp(last, axis=1).max()),
        max(0.0, float(past.max())),
        settled,
        bench.switchings / (STEP_S * len(STAIRCASE_KPA)),
        faults[0][0] if faults else "",
    )


@dataclass(frozen=True)
class PressureOutcome:
    """One controller on one valve over all draws; `figures` by the names of `PressureFigures`."""

    law: str
    valve: str
    draws: int
    figures: dict[str, Spread]
    faults: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Plain values for JSON: each figure as [median, lowest, highest]."""
        plain = {**vars(self), **{key: value.as_list() for key, value in self.figures.items()}}
        del plain["figures"]
        return plain


def pressure_table(
    valves: Iterable[str] = ("thesis", "cured"),
    seeds: Iterable[int] = (1,),
    progress: Callable[[str], None] | None = None,
) -> Iterator[PressureOutcome]:
    """All pressure controllers on these valve blocks, one after the other. Raises `PlantError`."""
    draws = list(seeds)
    for valve in valves:
        constants = load_valve(valve)
        for law in PRESSURE_LAWS:
            if progress is not None:
                progress(f"{valve} valve, {law}")
            found = pressure_critical(constants) if law == "pid" else None
            rows = [pressure_case(constants, valve, law, found, seed) for seed in draws]
            yield PressureOutcome(
                law,
                valve,
                len(rows),
                {key: spread(getattr(row, key) for row in rows) for key in FIGURES},
                tuple(sorted({row.fault for row in rows if row.fault})),
            )
