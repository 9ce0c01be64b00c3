"""Record a set: readings with noise and defects, merged into the rows of a data folder."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from blind.defects import Channels, spoil
from blind.noise import shake_force, shake_length, shake_pressure
from blind.physics.bench import Trial
from blind.physics.readings import read_settled, read_trial
from blind.sets import STREAMS, BlindSet

Floats = np.ndarray


@dataclass(frozen=True)
class Recorded:
    """The two tables of a data folder and the keys of its bench file."""

    trials: pd.DataFrame
    samples: pd.DataFrame
    bench: dict[str, float]


def clock(rate: float, end: float, phase: float) -> Floats:
    """Sampling instants, s, to the microsecond."""
    if rate <= 0.0:
        return np.zeros(0)
    return np.asarray(np.round(np.arange(phase, end, 1.0 / rate), 6))


def merged(channels: Channels) -> dict[str, Floats]:
    """Columns on the union of all instants; nan where a channel has no sample."""
    instants = np.unique(np.concatenate([t for t, _ in channels.values()]))
    columns: dict[str, Floats] = {"time_s": instants}
    for name, (t, v) in channels.items():
        column = np.full(len(instants), np.nan)
        column[np.searchsorted(instants, t)] = v
        columns[name] = column
    return columns


def commands(trial: Trial) -> Channels:
    """Both commands at the start and at every edge."""
    out: Channels = {}
    for side, name in enumerate(("inlet_cmd", "outlet_cmd")):
        own = trial.edges[trial.edges[:, 1] == side]
        out[name] = (
            np.round(np.concatenate([[0.0], own[:, 0]]), 6),
            np.concatenate([[0.0], own[:, 2]]),
        )
    return out


def directions(values: Floats) -> list[str]:
    """Up or down for each settled point: which way the pressure came."""
    way = np.sign(np.diff(values, prepend=values[0] - 1.0))
    return ["up" if w >= 0 else "down" for w in way]


def record_trial(one: BlindSet, trial: Trial, rng: np.random.Generator) -> dict[str, object]:
    """Columns of one trial's rows."""
    q, design, e = one.noise, one.design, one.effects()
    shift = q.mounting_mm * float(
        np.random.default_rng([STREAMS[one.stream], one.number, trial.mounting]).standard_normal()
    )
    real = trial
    if trial.held_mm is not None:
        real = replace(trial, held_mm=trial.held_mm + shift)
    balance = q.balance and trial.force_hz <= 10.0
    if trial.settled_s is not None:
        t = trial.settled_s
        r = read_settled(real, design.true, e)
        columns: dict[str, object] = {"pressure_kpa": shake_pressure(rng, q, t, r.pressure)}
        if trial.load_kg > 0.0:
            columns["length_mm"] = shake_length(rng, replace(q, dropped_share=0.0), r.length)
        else:
            columns["force_n"] = shake_force(rng, q, t, r.force, balance)
        if design.temperature_channel:
            noise = q.temperature_k * rng.standard_normal(len(t))
            columns["temperature_c"] = trial.temperature_c + noise
        columns["direction"] = directions(trial.regulator[1][::2] if trial.regulator else t)
        return columns
    end = trial.duration_s
    tp = clock(trial.pressure_hz, end, 0.0)
    tf = clock(trial.force_hz, end, 0.0 if trial.force_hz <= 10.0 else 0.0031)
    tl = clock(trial.camera_hz, end, 0.0047)
    r = read_trial(real, design.true, e, tp, tf, tl)
    channels: Channels = {"pressure_kpa": (tp, shake_pressure(rng, q, tp, r.pressure))}
    if len(tf):
        channels["force_n"] = (tf, shake_force(rng, q, tf, r.force, balance))
    if len(tl):
        channels["length_mm"] = (tl, shake_length(rng, q, r.length))
    if design.supply_channel and trial.valved:
        ts = clock(10.0, end, 0.0)
        steady = design.true[0] - design.true[1] + 0.3 * rng.standard_normal()
        channels["supply_kpa"] = (ts, steady + 0.5 * rng.standard_normal(len(ts)))
    if design.temperature_channel:
        tt = clock(1.0, end, 0.0)
        mean = trial.temperature_c + 0.2 * rng.standard_normal()
        channels["temperature_c"] = (tt, mean + q.temperature_k * rng.standard_normal(len(tt)))
    if one.defect:
        strength = float(np.random.default_rng([one.number, 7]).random())
        channels = spoil(channels, one.defect, strength, trial.order, rng)
    if trial.valved:
        channels.update(commands(trial))
    return dict(merged(channels))


def record(one: BlindSet) -> Recorded:
    """All trials of a set as recorded."""
    frames = []
    for i, trial in enumerate(one.design.trials):
        rng = np.random.default_rng(np.random.SeedSequence([STREAMS[one.stream], one.number, i, 1]))
        columns = record_trial(one, trial, rng)
        frame = pd.DataFrame(columns)
        frame.insert(0, "trial", trial.trial)
        frames.append(frame)
    samples = pd.concat(frames, ignore_index=True)
    order = [
        "trial", "time_s", "inlet_cmd", "outlet_cmd", "supply_kpa", "pressure_kpa", "length_mm",
        "force_n", "temperature_c", "direction",
    ]  # fmt: skip
    samples = samples[[name for name in order if name in samples.columns]]
    rows = [
        {
            "trial": t.trial,
            "slot": t.slot,
            "replicate": str(t.replicate),
            "protocol": t.protocol,
            "mounting": f"m{t.mounting}",
            "order": t.order,
            "held_length_mm": t.held_mm,
            "load_kg": t.load_kg if t.load_kg > 0.0 else None,
            "temperature_c": t.temperature_c if one.design.temperature_channel else None,
            "start_s": t.start_s,
        }
        for t in one.design.trials
    ]
    trials = pd.DataFrame(rows).dropna(axis=1, how="all")
    return Recorded(trials, samples, one.design.keys)
