"""A small bench for the tests of the diagnosis: runs of the plant, read by noisy sensors.

It shares the plant with the diagnosis, so it can show that the machinery works, never how well it
names effects of another form; that is measured on the blind bench.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from plant.constants import nominal
from plant.effects.effects import Effects
from plant.simulator.simulate import Commands, commands, run_commands

Array = npt.NDArray[np.float64]

_STEP_KPA = (100.0, 200.0, 300.0, 400.0, 500.0)


def staircase(width_s: float = 0.012, count: int = 8, period_s: float = 1.0) -> list[Any]:
    """Fill in bursts, then vent in bursts, each with a pause to settle."""
    events: list[Any] = []
    for k in range(count):
        events += [(0.3 + k * period_s, "inlet", 1.0), (0.3 + k * period_s + width_s, "inlet", 0.0)]
    down = 0.3 + count * period_s
    for k in range(count):
        begin = down + k * period_s
        events += [(begin, "outlet", 1.0), (begin + 1.6 * width_s, "outlet", 0.0)]
    end = down + count * period_s
    return [*events, (end, "outlet", 1.0), (end + 0.8, "outlet", 0.0)]


def fill_and_vent(hold_s: float = 2.0) -> list[Any]:
    """One long fill, a wait, one long vent."""
    return [
        (0.2, "inlet", 1.0), (0.7, "inlet", 0.0),
        (0.7 + hold_s, "outlet", 1.0), (1.7 + hold_s, "outlet", 0.0),
    ]  # fmt: skip


def regulated(levels: tuple[float, ...], dwell_s: float) -> list[Any]:
    """A regulator stepped up and down through `levels`, the inlet open all the time."""
    path = [*levels, *levels[-2::-1], 0.0]
    events: list[Any] = [(0.0, "inlet", 1.0)]
    return events + [(0.2 + k * dwell_s, "regulator_kpa", level) for k, level in enumerate(path)]


PLAN: tuple[tuple[str, float, float, str, list[Any], float], ...] = (
    *(("isometric", L, 0.0, "valve", staircase(), 18.0) for L in (54.0, 60.0, 66.0)),
    *(("step", L, 0.0, "valve", fill_and_vent(), 4.5) for L in (56.0, 64.0)),
    ("hold", 60.0, 0.0, "valve", fill_and_vent(25.0), 28.0),
    *(("hysteresis", L, 0.0, "regulator", regulated(_STEP_KPA, 4.0), 44.0) for L in (55.0, 63.0)),
    *(("isotonic", 70.0, m, "regulator", regulated(_STEP_KPA, 4.0), 44.0) for m in (1.0, 2.0)),
)


def write_set(
    folder: Path,
    effects: Mapping[str, Any] | None = None,
    seed: int = 0,
    replicates: int = 3,
    overrides: Mapping[str, Any] | None = None,
    late_s: float = 0.0,
    opens_late_s: Sequence[float] = (),
    rate_hz: float = 500.0,
    weighed: bool = False,
) -> Path:
    """Write a data set in the dataset format with `effects` of the plant switched on.

    Each replicate's commands come `late_s` later than those of the one before it; the outlet opens
    `opens_late_s` later at its first stroke of each trial, at its second, ..., than its command.
    With `weighed` a force cell reads the muscle's pull where a load hangs on it as well.
    """
    rng = np.random.default_rng(seed)
    constants = _drawn(rng)
    on = Effects.from_config(effects)
    folder.mkdir(parents=True, exist_ok=True)
    trials: list[dict[str, Any]] = []
    samples: list[pd.DataFrame] = []
    runs = [(slot, k) for k in range(replicates) for slot in range(len(PLAN))]
    for order, (slot, replicate) in enumerate(runs):
        protocol, length, mass, source, events, duration = PLAN[slot]
        name = f"t{order:02d}"
        inputs = commands([(at + late_s * replicate, *to) for at, *to in events])
        acted = commands(
            [(at + late_s * replicate, *to) for at, *to in uneven(events, opens_late_s)]
        )
        truth = run_commands(
            constants, acted, duration, rate_hz, on, source=source, load="isotonic" if mass else
            "isometric", length_m=length * 1e-3, mass_kg=mass or 1.0,
        )  # fmt: skip
        trials.append(
            {
                "trial": name, "slot": f"s{slot}", "replicate": str(replicate),
                "protocol": protocol, "mounting": f"m{replicate % 2}", "order": order,
                "held_length_mm": None if mass else length, "load_kg": mass or None,
                "temperature_c": 21.0,
            }
        )  # fmt: skip
        samples.append(_read(rng, name, truth, inputs, source, bool(mass), weighed))
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_parquet(folder / "samples.parquet", index=False)
    if overrides:
        lines = [f"{key} = {value}" for key, value in overrides.items()]
        (folder / "bench.toml").write_text("\n".join(lines) + "\n")
    return folder


def uneven(events: list[Any], opens_late_s: Sequence[float]) -> list[Any]:
    """Events with each opening of the outlet later by the next of `opens_late_s`, over and over."""
    late = itertools.cycle(opens_late_s or (0.0,))
    return [
        (at + next(late), *to) if tuple(to) == ("outlet", 1.0) else (at, *to) for at, *to in events
    ]


def _drawn(rng: np.random.Generator) -> Any:
    """Constants within their tolerances."""
    base = nominal()
    changes = {}
    for key, (field, scale) in {
        "braid_length_mm": ("braid_length_m", 1.0), "turns": ("turns", 1.0),
        "inlet_conductance_m3_s_pa": ("inlet_conductance_m3_s_pa", 1.0),
        "outlet_conductance_m3_s_pa": ("outlet_conductance_m3_s_pa", 1.0),
        "dead_volume_ml": ("dead_volume_m3", 1.0), "inlet_on_ms": ("inlet_on_s", 1.0),
        "supply_kpa": ("supply_pa", 1.0), "critical_ratio": ("critical_ratio", 1.0),
    }.items():  # fmt: skip
        sd = base.tolerance_si(key) * scale
        changes[field] = getattr(base, field) + 0.7 * sd * rng.standard_normal()
    return dataclasses.replace(base, **changes)


def _slow(rng: np.random.Generator, time_s: Array, sd: float, tau_s: float) -> Array:
    noise = rng.standard_normal(len(time_s))
    out = np.empty(len(time_s))
    out[0] = noise[0]
    for i in range(1, len(time_s)):
        a = np.exp(-(time_s[i] - time_s[i - 1]) / tau_s)
        out[i] = a * out[i - 1] + np.sqrt(1.0 - a * a) * noise[i]
    return sd * out


def _read(
    rng: np.random.Generator, name: str, truth: Any, inputs: Commands, source: str, hung: bool,
    weighed: bool,
) -> pd.DataFrame:  # fmt: skip
    t = truth.time_s
    p = truth.pressure_kpa * (1 + 0.003 * rng.standard_normal()) + 0.3 * rng.standard_normal()
    p = np.round((p + 0.5 * rng.standard_normal(len(t))) / 0.244) * 0.244
    parts = [pd.DataFrame({"time_s": t, "pressure_kpa": p})]
    if hung:
        tc = np.arange(0.003, t[-1], 0.02)
        value = np.interp(tc, t, truth.length_mm)
        value = value * (1 + 0.0005 * rng.standard_normal()) + 0.02 * rng.standard_normal()
        value = value + 0.01 * rng.standard_normal(len(tc))
        parts.append(pd.DataFrame({"time_s": tc, "length_mm": value}))
    if not hung or weighed:
        tf = np.arange(0.005, t[-1], 0.0125)
        value = np.interp(tf, t, truth.force_n) * (1 + 0.003 * rng.standard_normal())
        value += 0.2 * rng.standard_normal() + 0.05 * rng.standard_normal(len(tf))
        value += _slow(rng, tf, 0.2, 2.0)
        parts.append(pd.DataFrame({"time_s": tf, "force_n": np.round(value, 2)}))
    if source == "valve":
        for channel, column in (("inlet", "inlet_cmd"), ("outlet", "outlet_cmd")):
            here = [i for i, c in enumerate(inputs.channel) if c == channel]
            times = np.r_[0.0, inputs.time_s[here]]
            parts.append(pd.DataFrame({"time_s": times, column: np.r_[0.0, inputs.value[here]]}))
    table = pd.concat(parts)
    table = table.groupby("time_s", as_index=False).first()
    table.insert(0, "trial", name)
    return table
