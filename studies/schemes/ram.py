"""Section 5.9 in simulation: is the ram held, and on which parameters does this depend.

The ram (bore 50 mm, stroke 200 mm, 5 kg, friction 20 N) is lifted by the firmware scheme `ram`
until a proximity switch triggers, from several starts. The four schemes of 5.7 control its pressure
with the piston at its upper end, and that of the muscle.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants, nominal
from plant.finger.reader import valve_changes
from plant.scene.ram import Ram, RamConstants
from plant.simulator.bench import FINE_STEP_SHARE
from rigs.virtual.board.pressure_sensor import ADC_TOP
from studies.schemes.command import Progress
from studies.schemes.result import CONFIRMED, CONTRADICTED, PARTLY, Grid, Statement, Study
from studies.schemes.schemes import Merit, Summary
from studies.schemes.trial import INTENDED, TITLES, Bench, run_trial, summary
from valvefw.config import defaults
from valvefw.schemes.ram import Ram as RamScheme
from valvefw.schemes.valves import Valves

if TYPE_CHECKING:
    from matplotlib.figure import Figure


STARTS_MM = (60.0, 80.0, 100.0, 120.0)
SWITCH_MM = 150.0
SETPOINT_KPA = 250.0
RUN_S = 3.0
HELD_MM = 10.0
"""Held means at rest within this distance of the switch, 5 % of the stroke."""
STEPS = (0.25, 0.55, 0.4, 0.7)
RAM_STEP_S = 10.0
"""Duration of a step of the pressure of the ram; its chamber takes seconds to fill."""


@dataclasses.dataclass(frozen=True)
class Lift:
    """One lift: true height (mm) and pressure (kPa) every ms."""

    height_mm: Array
    pressure_kpa: Array

    @property
    def rest_mm(self) -> float:
        """Mean height over the last half second."""
        return float(self.height_mm[-500:].mean())

    @property
    def moved_mm(self) -> float:
        """Range of the height in that time."""
        return float(np.ptp(self.height_mm[-500:]))

    @property
    def arrival_mm_s(self) -> float:
        """Speed when it first reached the height of the switch; NaN if it did not."""
        above = np.flatnonzero(self.height_mm >= SWITCH_MM)
        if not len(above) or above[0] < 5:
            return float("nan")
        at = int(above[0])
        return float(self.height_mm[at] - self.height_mm[at - 5]) / 5e-3

    @property
    def held(self) -> bool:
        """True if it is at rest near the switch."""
        return self.moved_mm < 0.1 and abs(self.rest_mm - SWITCH_MM) < HELD_MM


def lift(c: PlantConstants, ram: RamConstants, start_mm: float, seed: int = 1) -> Lift:
    """Lift the ram with the firmware scheme from a start between its switches."""
    plant = Ram(c, ram, height_mm=start_mm, step_share=FINE_STEP_SHARE)
    plant.state[1] = ram.balance_kpa() * 1e3  # carries its weight
    scheme = RamScheme()
    scheme.start(defaults())
    valves = Valves()
    rng = np.random.default_rng([seed, 5])
    per_kpa = ADC_TOP / 1000.0
    ticks = round(RUN_S * 1000)
    noise = rng.standard_normal(ticks) * 0.5
    goal = round(SETPOINT_KPA * per_kpa * 16)
    height, pressure = np.empty(ticks), np.empty(ticks)
    counts = int(ram.balance_kpa() * per_kpa)
    for tick in range(ticks):
        valves.inlet_us = max(0, valves.inlet_us - 1000)
        valves.vent_us = max(0, valves.vent_us - 1000)
        valves.prox = plant.prox_bits
        inlet_us, vent_us = valves.inlet_us, valves.vent_us  # requested at the reading before
        scheme.step(counts, goal, 1000, valves)
        plant.advance(1e-3, min(inlet_us, 1000) * 1e-6, min(vent_us, 1000) * 1e-6)
        height[tick], pressure[tick] = plant.height_mm, plant.pressure_kpa
        counts = min(max(int((pressure[tick] + noise[tick]) * per_kpa + 0.5), 0), ADC_TOP)
    return Lift(height, pressure)


def run(full: bool, progress: Progress) -> Study:
    """Run the study; `full` with all starts, draws and variations."""
    starts, seeds = (STARTS_MM, 3) if full else (STARTS_MM[:2], 1)
    variations = _variations() if full else _variations()[:3]
    rows, lifts = [], {}
    for words, changes, plant_changes in progress.over(variations, "ram"):
        c = nominal().with_overrides(plant_changes)
        found = [
            lift(c, dataclasses.replace(RamConstants(), **changes), start, seed)
            for start in starts
            for seed in range(seeds)
        ]
        lifts[words] = found
        off = np.array([f.rest_mm - SWITCH_MM for f in found])
        rows.append(
            (
                words,
                f"{sum(f.held for f in found)} of {len(found)}",
                f"{off.mean():+.1f} ± {off.std():.1f}",
                f"{max(f.moved_mm for f in found):.2f}",
                _speed(found),
            )
        )
    pressures = {name: _pressures(name, full, progress) for name in INTENDED}
    pressure_rows = tuple(_pressure_row(name, *pair) for name, pair in pressures.items())
    bursts = _bursts()
    base = lifts["as given"]
    return Study(
        "ram",
        "Was the ram of section 5.9 held because it is large?",
        _statements(base, lifts, pressures, bursts),
        (
            Grid("Lifts to the switch at 150 mm", ("changed", "held", "rest minus switch, mm",
                 "movement in the last 0.5 s, mm", "arrives at, mm/s"), tuple(rows)),
            Grid("Pressure held by the schemes of 5.7, valve of the thesis",
                 ("scheme", "ripple muscle, %", "ripple ram, %", "error muscle, %",
                  "error ram, %"), pressure_rows),
            Grid("Smallest burst of the valve of the thesis",
                 ("chamber", "gas volume, ml", "effect, % of supply"), bursts),
        ),
        {"ram": lambda: _figure(base)},
        (
            f"Lifts begin at {', '.join(f'{s:g}' for s in starts)} mm; held means at rest within "
            f"{HELD_MM:g} mm of the switch. The pressure rows are with the piston at its upper end "
            "(413 ml) and with the muscle at 60 mm (6.3 ml), set-points of 25 to 70 % of supply.",
        ),
    )  # fmt: skip


def _speed(found: Sequence[Lift]) -> str:
    speeds = np.array([f.arrival_mm_s for f in found])
    speeds = speeds[np.isfinite(speeds)]
    return f"{speeds.mean():.0f}" if len(speeds) else "never"


def _variations() -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Parameters of ram, switch and valve that are not printed in the thesis."""
    out: list[tuple[str, dict[str, Any], dict[str, Any]]] = [("as given", {}, {})]
    out += [(f"switch reaches {v:g} mm", {"switch_reach_m": v * 1e-3}, {}) for v in (2, 10, 15)]
    out += [(f"friction {v:g} N", {"friction_n": float(v)}, {}) for v in (0, 5, 60)]
    out += [(f"mass {v:g} kg", {"mass_kg": float(v)}, {}) for v in (1, 20)]
    out += [(f"bore {v:g} mm", {"bore_m": v * 1e-3}, {}) for v in (16, 25, 100)]
    out += [("small, fast valve", {}, valve_changes("cured"))]
    out += [("transport delays", {}, {"delay_mode": "transport"})]
    return out


def _pressures(scheme: str, full: bool, progress: Progress) -> tuple[Summary, Summary]:
    """Figures of merit of the pressure of muscle and ram with one scheme."""
    seeds = range(3 if full else 1)
    muscle, ram = [], []
    for seed in progress.over(seeds, f"pressure, {scheme}"):
        muscle += run_trial(Bench(nominal()), scheme, STEPS, seed=seed)
        ram += run_trial(Bench(full_ram()), scheme, STEPS, RAM_STEP_S, seed=seed)
    return summary(muscle), summary(ram)


def _pressure_row(scheme: str, muscle: Summary, ram: Summary) -> tuple[str, ...]:
    cells = [_pm(m[key]) for key in ("ripple", "error") for m in (muscle, ram)]
    return (TITLES[scheme], *cells)


def _pm(value: Merit) -> str:
    return f"{value[0]:.2f} ± {value[1]:.2f}"


def full_ram() -> PlantConstants:
    """The bench with the full cylinder of the ram as its chamber: 413 ml, constant."""
    ram = RamConstants()
    volume = ram.dead_volume_m3 + ram.area_m2 * ram.stroke_m
    # The bench adds the volume of a held braid; it is subtracted here.
    from plant.physics.muscle import volume as braid

    c = nominal()
    return dataclasses.replace(c, dead_volume_m3=volume - float(braid(0.060, c)))


def _bursts() -> tuple[tuple[str, float, float], ...]:
    """Pressure that the shortest opening of the inlet (one off-delay) adds to each chamber."""
    from plant.simulator.simulate import pulse_train, run_commands

    rows = []
    ram = RamConstants()
    for words, c in (
        ("muscle at 60 mm", nominal()),
        ("ram, piston at 150 mm", None),
        ("ram, piston at 200 mm", full_ram()),
    ):
        if c is None:
            volume = ram.dead_volume_m3 + ram.area_m2 * 0.150
            c = dataclasses.replace(full_ram(), dead_volume_m3=volume - 5.848e-6)
        pulse = pulse_train("inlet", 0.0, 0.0109)
        traces = run_commands(c, pulse, 0.1)
        share = traces.pressure_kpa[-1] / (c.supply_pa * 1e-3) * 100.0
        gas = (c.dead_volume_m3 + 5.848e-6) * 1e6
        rows.append((words, round(gas, 1), round(float(share), 2)))
    return tuple(rows)


def _statements(
    base: Sequence[Lift],
    lifts: dict[str, list[Lift]],
    pressures: dict[str, tuple[Summary, Summary]],
    bursts: Sequence[tuple[str, float, float]],
) -> tuple[Statement, ...]:
    held = sum(f.held for f in base)
    verdict = CONFIRMED if held == len(base) else PARTLY if held else CONTRADICTED
    holding = [w for w, found in lifts.items() if all(f.held for f in found)]
    pairs = pressures.values()
    steady = all(ram["ripple"][0] < 2.0 and ram["error"][0] < 2.0 for _, ram in pairs)
    better = any(ram["ripple"][0] < muscle["ripple"][0] for muscle, ram in pairs)
    quarter = CONFIRMED if 15.0 < bursts[0][2] < 30.0 else CONTRADICTED
    return (
        Statement(
            "the ram moved until the proximity sensor was triggered and held its position there",
            "5.9", verdict,
            f"{held} of {len(base)} lifts rest within {HELD_MM:g} mm of the switch, "
            f"{np.mean([f.rest_mm - SWITCH_MM for f in base]):+.1f} mm from it on average. The "
            "ram is held by the enclosed gas and by friction, without movement. But it arrives at "
            f"{np.nanmean([f.arrival_mm_s for f in base]):.0f} mm/s, and with valves that take "
            "8.5 ms to close it may leave the range of the switch (± 5 mm), and the scheme starts "
            "to fill again. "
            + (f"Held in every lift with: {', '.join(holding) or 'none of the variations'}"),
        ),
        Statement(
            "all schemes controlled the pressure of a large commercial ram", "5.15",
            CONFIRMED if steady else PARTLY if better else CONTRADICTED,
            "ripple and error of the ram's pressure "
            + "; ".join(
                f"{TITLES[name]} {_pm(ram['ripple'])} and {_pm(ram['error'])} %"
                for name, (_, ram) in pressures.items()
            )
            + ". Both PWM schemes have not settled after "
            f"{RAM_STEP_S:g} s: a pulse proportional to the error adds too little to so large "
            "a chamber"
            + f". The smallest burst adds {bursts[0][2]:g} % of supply in the muscle and "
            f"{bursts[2][2]:g} % in the ram, whose chamber is "
            f"{bursts[2][1] / bursts[0][1]:.0f} times as large",
        ),
        Statement(
            "the minimum air burst filled a quarter of the muscle's volume", "5.10", quarter,
            f"{bursts[0][2]:g} % of supply in a vented muscle",
        ),
    )  # fmt: skip


def _figure(base: Sequence[Lift]) -> Figure:
    """Height and pressure of each lift against time."""
    from analysis.figures.drawing import SET, new_figure, sequence, style

    with style():
        figure, (top, bottom) = new_figure(7.2, 4.6, rows=2, sharex=True)
        for found, colour in zip(base, sequence(len(base)), strict=True):
            t = np.arange(len(found.height_mm)) * 1e-3
            top.plot(t, found.height_mm, color=colour, linewidth=1.0)
            bottom.plot(t, found.pressure_kpa, color=colour, linewidth=0.8)
        reach = RamConstants().switch_reach_m * 1e3
        top.axhspan(SWITCH_MM - reach, SWITCH_MM + reach, color=SET, alpha=0.35, linewidth=0)
        top.text(0.02, SWITCH_MM + reach + 3, "switch", fontsize=8)
        top.set_ylabel("height (mm)")
        bottom.set_ylabel("pressure (kPa)")
        bottom.set_xlabel("time (s)")
        figure.align_ylabels([top, bottom])
    return figure
