"""Inertial and transport delay of a valve: effect on the schemes, and how to distinguish them.

Inertial: a valve opens only if the command is longer than the delay. Transport: every command
acts, with a delay. Tables D-1 to D-3 of the thesis have long commands only, which cannot
distinguish them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant.constants import PlantConstants, nominal
from plant.physics.valve import open_time_s
from plant.simulator.simulate import pulse_train, run_commands
from studies.schemes.command import Progress
from studies.schemes.result import Grid, Study
from studies.schemes.schemes import LOAD_WORDS, LOADS, STEPS, Merit, measure, standard_error
from studies.schemes.trial import INTENDED, TITLES, Bench

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODES = ("inertial", "transport")
WIDTHS_MS = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 10.5, 11.0, 11.5, 12.0, 14.0, 16.0, 20.0)
UNITS_US = (1000, 100, 20)
"""Lengths of a PWM unit. With a shorter unit, more pulses are shorter than the on-delay."""


def bench_of(mode: str) -> PlantConstants:
    """The bench of the thesis with one kind of delay."""
    return nominal().with_overrides({"delay_mode": mode})


def answer_kpa(mode: str, width_ms: float) -> float:
    """Pressure in the vented muscle at 60 mm after one inlet pulse."""
    traces = run_commands(bench_of(mode), pulse_train("inlet", 0.0, width_ms * 1e-3), 0.2)
    return float(traces.pressure_kpa[-1])


def run(full: bool, progress: Progress) -> Study:
    """Run the study; `full` with all steps, loads and four noise realizations."""
    steps, seeds = (STEPS, 4) if full else (STEPS[:3], 1)
    loads = LOADS if full else LOADS[:1]
    cases = [(load, s, unit) for load in loads for s in (*INTENDED, "burst")
             for unit in (UNITS_US if s.startswith("duty") else UNITS_US[:1])]  # fmt: skip
    rows, apart = [], 0
    for load, scheme, unit in progress.over(cases, "delays"):
        both = [
            measure(
                Bench(bench_of(mode), load, parameters={"duty_unit_us": unit}), scheme, steps, seeds
            )
            for mode in MODES
        ]
        cells = []
        for key in ("ripple", "error", "overshoot"):
            cells += [f"{m[key][0]:.1f} ± {m[key][1]:.1f}" for m in both]
        differ = any(_differ(both[0][k], both[1][k]) for k in ("ripple", "error", "overshoot"))
        apart += differ
        name = TITLES[scheme] + (f", unit {unit / 1000:g} ms" if scheme.startswith("duty") else "")
        rows.append((LOAD_WORDS[load], name, *cells, "yes" if differ else "no"))
    heads = ("load", "scheme", *(f"{k}, {m}, %" for k in ("ripple", "error", "overshoot")
                                 for m in MODES), "differ")  # fmt: skip
    pulses = tuple(
        (f"{w:g}", *(f"{answer_kpa(mode, w):.1f}" for mode in MODES),
         *(f"{open_time_s('inlet', w * 1e-3, 550e3, bench_of(mode)) * 1e3:.2f}" for mode in MODES))
        for w in WIDTHS_MS
    )  # fmt: skip
    return Study(
        "delay",
        "Inertial or transport delay: does it matter, and how can they be distinguished?",
        (),
        (
            Grid("Schemes under either delay, valve of the thesis", heads, tuple(rows)),
            Grid("One inlet pulse into the vented muscle at 60 mm",
                 ("pulse, ms", "inertial, kPa", "transport, kPa", "open inertial, ms",
                  "open transport, ms"), pulses),
        ),
        {"delay": _figure},
        (
            f"{apart} of {len(rows)} rows differ by more than twice the standard error of their "
            "difference. A pulse shorter than the on-delay (10.87 ms at 550 kPa) distinguishes "
            "them: with an inertial delay no air arrives. Long commands, as in "
            "`pamrig switching-time` and in the thesis, do not distinguish them.",
        ),
    )  # fmt: skip


def _differ(a: Merit, b: Merit) -> bool:
    if not (a[2] and b[2]):
        return a[2] != b[2]
    return bool(abs(a[0] - b[0]) > max(2.0 * standard_error(a, b), 0.1))


def _figure() -> Figure:
    """Pressure after one pulse, against its length."""
    from analysis.figures.drawing import MEASURED, SET, new_figure, style

    widths = np.arange(0.5, 20.01, 0.25)
    with style():
        figure, ax = new_figure(6.4, 3.6)
        for mode, colour, dash in zip(MODES, (MEASURED, SET), ("-", "--"), strict=True):
            values = [answer_kpa(mode, float(w)) for w in widths]
            ax.plot(widths, values, dash, color=colour, label=f"{mode} delay")
        ax.axvline(10.8725, color="#8a8a8a", linewidth=0.8, linestyle=":")
        ax.text(10.7, ax.get_ylim()[1] * 0.93, "on-delay", ha="right", fontsize=8)
        ax.set_xlabel("length of the inlet pulse (ms)")
        ax.set_ylabel("pressure after it (kPa)")
        ax.legend(loc="upper left")
    return figure
