"""The library of experiments that may be advised, also where the data hold none of their kind.

Each is a protocol of `configs/protocols` with settings, and a picture of what it would record: a
few trials simulated with the plant as it is best known. The picture serves to foresee which rivals
the experiment would tell apart; the settings make the protocol file that `pamrig` runs.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import Channel, Trial
from gap.design.config import DESIGN
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.validation.improved_plant import improved_plant
from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.simulator.readings import read_force, read_pressure
from plant.simulator.simulate import commands, run_commands

Event = tuple[float, Any, float]

RATES = {"regulated": (20.0, 10.0, 10.0), "valves": (500.0, 80.0, 50.0)}
"""Samples a second of pressure, force and pictures where the data set does not say."""
STAGE_MM_S = 3.0
DWELL_S = 3.0
SETTING_UP_S = 20.0


@dataclass(frozen=True)
class LibraryExperiment:
    """An experiment: its protocol and settings, and what one repeat of it would record.

    `settings` are keys of the protocol's file; `what` states what is special about it.
    """

    protocol: str
    what: str
    settings: Mapping[str, Any]
    trials: tuple[Trial, ...]
    minutes: float


@dataclass(frozen=True)
class _Bench:
    """What the simulated trials are made with."""

    constants: PlantConstants
    effects: Effects
    rates: Mapping[str, tuple[float, float, float]]
    low_mm: float
    high_mm: float
    top_kpa: float
    order: float
    kg: tuple[float, float]
    warm_c: tuple[float, float]
    made: list[int] = field(default_factory=lambda: [0])


def library_experiments(problem: FitProblem, best: FitResult) -> list[LibraryExperiment]:
    """All experiments of the library for the bench that the data come from."""
    bench = _bench(problem, best)
    low, high, top = bench.low_mm, bench.high_mm, bench.top_kpa
    lengths = [round(low + share * (high - low), 1) for share in (0.05, 0.45, 0.85)]
    levels = [round(share * top, -1) for share in (0.15, 0.3, 0.5, 0.75, 1.0)]
    two = [levels[1], levels[4]]
    # A cylinder does not lift what hangs.
    pulls = problem.data.constants.actuator == "muscle"
    masses = [round(kg, 2) for kg in bench.kg] if pulls else []
    made: list[tuple[str, str, dict[str, Any], list[Trial]]] = [
        (
            "isometric", "pressures at short, middle and long length",
            {"lengths_mm": lengths, "pressures_kpa": levels},
            [_held(bench, "isometric", x, levels, DWELL_S) for x in lengths],
        ),
        (
            "isometric", "a minute at each of two pressures",
            {"lengths_mm": lengths[1:2], "pressures_kpa": two, "measure": {"seconds": 60.0}},
            [_held(bench, "isometric", lengths[1], two, 60.0)],
        ),
        (
            "hysteresis", "cycles up and down at two lengths",
            {"lengths_mm": lengths[:2], "masses_kg": None, "cycles_kpa": [levels[4]],
             "step_kpa": round(levels[4] / 6.0, -1)},
            [_cycle(bench, x, top) for x in lengths[:2]],
        ),
        (
            "isobaric", "lengths back and forth at two pressures",
            {"pressures_kpa": two, "lengths_mm": [round(x, 1) for x in np.linspace(low, high, 6)]},
            [_staged(bench, p) for p in two],
        ),
        (
            "isotonic", "pressures up and down under two loads",
            {"masses_kg": masses, "pressures_kpa": levels},
            [_hung(bench, kg, levels) for kg in masses],
        ),
        (
            "isothermal", "the same pressures cold and warm, soaked",
            {"temperatures_c": list(bench.warm_c), "lengths_mm": lengths[1:2],
             "pressures_kpa": levels, "isobaric": None},
            [
                _held(bench, "isothermal", lengths[1], levels, DWELL_S, warm)
                for warm in bench.warm_c
            ],
        ),
        (
            "step", "steps up and down, valves fully open",
            {"schemes": ["two"], "length_mm": lengths[1], "pressures_kpa": [
                levels[2], levels[4], levels[1], levels[3], levels[0]]},
            [_steps(bench, lengths[1], (0.02, 0.05, 0.1, 0.3))],
        ),
        (
            "step", "small steps in short bursts",
            {"schemes": ["burst"], "length_mm": lengths[1], "pressures_kpa": levels},
            [_bursts(bench, lengths[1])],
        ),
        (
            "step", "the chamber shut for half a minute at two pressures",
            {"schemes": ["two"], "length_mm": lengths[1], "pressures_kpa": two,
             "step_s": DESIGN.shut_s},
            [_shut(bench, lengths[1])],
        ),
    ]  # fmt: skip
    return [
        LibraryExperiment(protocol, what, settings, tuple(trials), _minutes(trials))
        for protocol, what, settings, trials in made
        if trials
    ]


def _minutes(trials: Sequence[Trial]) -> float:
    seconds = sum(
        SETTING_UP_S + max((float(c.time_s[-1]) for c in t.channels.values()), default=0.0)
        for t in trials
    )
    soaks = sum(t.protocol == "isothermal" for t in trials)
    return (seconds + 900.0 * soaks) / 60.0


def _bench(problem: FitProblem, best: FitResult) -> _Bench:
    constants = problem.constants(best.shift)
    table = tomllib.loads(improved_plant(problem, best))
    try:
        effects = Effects.from_config(table.get("effects", {}))
    except PlantError:
        effects = Effects.from_config({})
    reach = [
        float(t["pressure_kpa"].value.max())
        for t in problem.data.trials
        if "pressure_kpa" in t and len(t["pressure_kpa"])
    ]
    top = min(max(reach, default=500.0), 0.93 * constants.supply_pa * 1e-3)
    low, high = constants.length_min_m * 1e3 + 2.0, constants.length_max_m * 1e3 - 3.0
    loads = [t.load_kg for t in problem.data.trials if np.isfinite(t.load_kg) and t.load_kg > 0.0]
    heaviest = max(loads, default=2.0)
    return _Bench(
        constants, effects, {kind: _rates(problem, kind) for kind in RATES}, low, high,
        round(max(top, 100.0), -1), problem.model.order.max(initial=0.0) + 1.0,
        (0.5 * heaviest, heaviest), _warmth(problem),
    )  # fmt: skip


def _warmth(problem: FitProblem) -> tuple[float, float]:
    room = [t.temperature_c for t in problem.data.trials if np.isfinite(t.temperature_c)]
    usual = float(np.median(room)) if room else 21.0
    return round(usual, 0), round(usual + 15.0, 0)


def _rates(problem: FitProblem, kind: str) -> tuple[float, float, float]:
    """Samples a second of pressure, force and length as the data set has them for such trials."""
    made = []
    for at, name in enumerate(("pressure_kpa", "force_n", "length_mm")):
        found = [
            1.0 / float(np.median(np.diff(t[name].time_s)))
            for t, regulated in zip(problem.data.trials, problem.grid.regulated, strict=True)
            if regulated == (kind == "regulated") and name in t and len(t[name]) > 5
            and not t.settled and float(np.median(np.diff(t[name].time_s))) > 0.0
        ]  # fmt: skip
        made.append(float(np.median(found)) if found else RATES[kind][at])
    return made[0], made[1], made[2]


def _simulated(  # noqa: PLR0913 - what a simulated experiment is made of
    bench: _Bench, protocol: str, events: list[Event], seconds: float, *, kind: str,
    length_mm: float = np.nan, mass_kg: float = np.nan, warm_c: float = 21.0, moves: bool = False,
) -> Trial:  # fmt: skip
    """One trial of the plant as it is best known, read without noise."""
    inputs = commands(events)
    hung = bool(np.isfinite(mass_kg))
    traces = run_commands(
        bench.constants, inputs, seconds, 1000.0, bench.effects,
        source="valve" if kind == "valves" else "regulator",
        load="isotonic" if hung else "isometric",
        length_m=(bench.high_mm if hung else length_mm) * 1e-3, mass_kg=mass_kg if hung else 1.0,
        temperature_c=warm_c, trials=bench.order,
    )  # fmt: skip
    readings = {
        "pressure_kpa": read_pressure(traces.pressure_read_kpa, bench.effects),
        "force_n": read_force(traces.force_n, bench.effects),
        "length_mm": traces.length_mm,
    }
    channels: dict[str, Channel] = {}
    for name, rate in zip(readings, bench.rates[kind], strict=True):
        if name == "length_mm" and not (hung or moves):
            continue
        t = np.arange(0.0, seconds, 1.0 / min(max(rate, 2.0), 1000.0))
        channels[name] = Channel(t, np.interp(t, traces.time_s, readings[name]))
    if kind == "valves":
        for name in ("inlet", "outlet"):
            own = [i for i, c in enumerate(inputs.channel) if c == name]
            channels[f"{name}_cmd"] = Channel(
                np.r_[0.0, inputs.time_s[own]], np.r_[0.0, inputs.value[own]]
            )
    bench.made[0] += 1
    label = f"advised {bench.made[0]}"
    return Trial(
        label, label, "1", protocol, "m1", bench.order, np.nan if moves or hung else length_mm,
        mass_kg, warm_c, np.nan, False, channels, np.empty(0, dtype=np.int64),
    )  # fmt: skip


def _stairs(levels: Sequence[float], dwell_s: float) -> tuple[list[Event], float]:
    """A regulator led up and down through `levels`, and how long it takes."""
    path = [0.0, *levels, *list(levels)[-2::-1], 0.0]
    events: list[Event] = [(0.0, "inlet", 1.0)]
    events += [(0.1 + k * dwell_s, "regulator_kpa", level) for k, level in enumerate(path)]
    return events, 0.1 + len(path) * dwell_s


def _held(
    bench: _Bench, protocol: str, length: float, levels: Sequence[float], dwell_s: float,
    warm_c: float = 21.0,
) -> Trial:  # fmt: skip
    events, seconds = _stairs(levels, dwell_s)
    return _simulated(
        bench, protocol, events, seconds, kind="regulated", length_mm=length, warm_c=warm_c
    )


def _cycle(bench: _Bench, length: float, top: float) -> Trial:
    levels = [round(share * top) for share in np.linspace(1.0 / 6.0, 1.0, 6)]
    events, seconds = _stairs(levels, DWELL_S)
    return _simulated(bench, "hysteresis", events, seconds, kind="regulated", length_mm=length)


def _hung(bench: _Bench, mass: float, levels: Sequence[float]) -> Trial:
    events, seconds = _stairs(levels, DWELL_S)
    return _simulated(bench, "isotonic", events, seconds, kind="regulated", mass_kg=mass)


def _staged(bench: _Bench, pressure: float) -> Trial:
    """Lengths in steps there and back at one pressure."""
    events: list[Event] = [(0.0, "inlet", 1.0), (0.0, "regulator_kpa", pressure)]
    step = (bench.high_mm - bench.low_mm) / 5.0
    now = 2.0
    for way in (1.0, -1.0):
        for _ in range(5):
            events += [
                (now, "length_rate_mm_s", way * STAGE_MM_S),
                (now + step / STAGE_MM_S, "length_rate_mm_s", 0.0),
            ]
            now += step / STAGE_MM_S + 2.0
    return _simulated(
        bench, "isobaric", events, now, kind="regulated", length_mm=bench.low_mm, moves=True
    )


def _steps(bench: _Bench, length: float, fills: Sequence[float]) -> Trial:
    events: list[Event] = []
    now = 0.2
    for fill in fills:
        vent = now + fill + 0.7
        events += [
            (now, "inlet", 1.0), (now + fill, "inlet", 0.0),
            (vent, "outlet", 1.0), (vent + 0.6 * fill, "outlet", 0.0),
            (vent + 0.6 * fill + 0.5, "outlet", 1.0), (vent + 0.6 * fill + 1.2, "outlet", 0.0),
        ]  # fmt: skip
        now = vent + 0.6 * fill + 1.4
    return _simulated(bench, "step", events, now, kind="valves", length_mm=length)


def _bursts(bench: _Bench, length: float) -> Trial:
    events: list[Event] = []
    now = 0.2
    for valve, width in (("inlet", 0.012), ("outlet", 0.016)):
        for _ in range(8):
            events += [(now, valve, 1.0), (now + width, valve, 0.0)]
            now += 0.2
    return _simulated(bench, "step", events, now + 0.3, kind="valves", length_mm=length)


def _shut(bench: _Bench, length: float) -> Trial:
    """Two fillings, after each of which both valves stay shut."""
    events: list[Event] = []
    now = 0.2
    for fill in (0.1, 0.2):
        events += [(now, "inlet", 1.0), (now + fill, "inlet", 0.0)]
        now += fill + DESIGN.shut_s
    return _simulated(bench, "step", events, now, kind="valves", length_mm=length)


def as_data(problem: FitProblem, trials: Sequence[Trial]) -> DataSet:
    """Simulated trials as a data set of the same bench."""
    return dataclasses.replace(problem.data, origin="advice", trials=tuple(trials), notes=())
