"""A set before any air flows: bench constants, slots, replicates, mountings and their order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from blind.physics.bench import CONSTANTS, Trial, nominal, tolerances, with_keys
from blind.protocols import PROTOCOLS, SERVES, Habits, habits, slot, stairs

Rng = np.random.Generator
Floats = np.ndarray


@dataclass(frozen=True)
class Design:
    """What is done, on which muscle, and what the laboratory writes down about it."""

    stated: Floats
    true: Floats
    keys: dict[str, float]
    trials: tuple[Trial, ...]
    habits: Habits
    table: bool
    supply_channel: bool
    temperature_channel: bool
    changed: bool


def muscle_keys(rng: Rng, changed: bool) -> dict[str, float]:
    """Keys of a bench file: none, or another muscle (other sizes when changed)."""
    if not changed and rng.random() < 0.6:
        return {}
    if changed:
        braid = float(rng.choice([80.0, 97.0, 102.0]) + rng.uniform(-1.0, 1.0))
        turns = float(rng.uniform(2.1, 2.6))
    else:
        braid, turns = float(rng.uniform(84.0, 94.0)), float(rng.uniform(1.7, 2.0))
    keys = {
        "braid_length_mm": round(braid, 1),
        "turns": round(turns, 3),
        "length_min_mm": round(51.0 / 88.4 * braid, 1),
        "length_max_mm": round(72.5 / 88.4 * braid, 1),
    }
    if changed:
        keys["supply_kpa"] = float(rng.choice([450.0, 500.0, 620.0]))
        keys["dead_volume_ml"] = round(float(rng.uniform(0.4, 1.2)), 2)
    return keys


def true_constants(rng: Rng, stated: Floats) -> Floats:
    """The constants this bench really has: within the data sheets, two sd at most."""
    sd = tolerances(stated)
    out = stated + sd * np.clip(rng.standard_normal(len(sd)), -2.0, 2.0)
    for name, place, _, tolerance, _ in CONSTANTS:
        if tolerance == 0.0:
            out[place] = stated[place]
        elif name.endswith("critical_ratio"):
            out[place] = float(np.clip(out[place], 0.4, 0.6))
    return np.asarray(out)


def table_slot(rng: Rng, h: Habits, loaded: bool, up_down: bool) -> Trial:
    """Settled points of a pressure staircase."""
    levels = np.linspace(0.0, h.top_kpa, int(rng.integers(6, 11)))
    if up_down:
        levels = np.concatenate([levels, levels[-2::-1]])
    dwell = 8.0
    t, v = stairs(levels, dwell, 0.02)
    instants = np.arange(len(levels)) * (dwell + 0.02) + dwell - 0.2
    common: dict[str, Any] = {"regulator": (t, v), "settled_s": instants}
    if loaded:
        mass = round(float(rng.uniform(0.4, h.heaviest_kg)), 1)
        return Trial(
            "", "", "isotonic", 0, 0, 0, float(t[-1]), load_kg=mass, force_hz=0.0, **common
        )
    length = round(float(rng.uniform(h.low_mm + 1.0, h.high_mm - 2.0)) * 2.0) / 2.0
    name = "hysteresis" if up_down else "isometric"
    return Trial("", "", name, 0, 0, 0, float(t[-1]), held_mm=length, **common)


def slots_for(need: str, count: int, rng: Rng, h: Habits, table: bool) -> list[Trial]:
    """Slots of a set: those the need asks for, then a mix; in a random order."""
    if table:
        loaded = need in ("load", "camera") or rng.random() < 0.25
        some = [
            table_slot(rng, h, loaded and i % 2 == 0, need == "cycle" or rng.random() < 0.4)
            for i in range(count)
        ]
    else:
        names = list(SERVES[need])[:count]
        mix = ["isometric", "step", "square", "triangle", "hysteresis", "isotonic", "isobaric"]
        rest = rng.permutation([*mix, "hold", "decay"]).tolist()
        while len(names) < count:
            names.append(rest.pop(0) if rest else str(rng.choice(list(PROTOCOLS))))
        some = [slot(str(name), rng, h) for name in names]
    if need == "warm" or rng.random() < 0.3:
        grid = [35.0, 50.0] if h.odd else [15.0, 30.0, 40.0]
        warmed = 0
        for i, one in enumerate(some):
            slow = one.regulator is not None
            if slow and (warmed < 1 or rng.random() < 0.5):
                some[i] = replace(one, temperature_c=float(grid[warmed % len(grid)]))
                warmed += 1
    return [some[i] for i in rng.permutation(len(some))]


def slots_of(rng: Rng, needs: list[str], count: int, h: Habits, table: bool) -> list[Trial]:
    """So many slots in all, shared out evenly to what the set must be able to show."""
    slots: list[Trial] = []
    for need in needs:
        share = count - len(slots) if need == needs[-1] else count // len(needs)
        slots += slots_for(need, share, rng, h, table)
    return slots


def sequence(rng: Rng, slots: list[Trial], replicates: int) -> list[Trial]:
    """All trials in the order in which they are run: replicates follow each other, and one or two
    of each slot come after a new mounting.
    """
    trials: list[Trial] = []
    clock, order = float(rng.uniform(0.0, 3000.0)), int(rng.integers(1, 20))
    mountings = 2
    at = 0
    for mounting in range(mountings):
        turns = list(enumerate(slots))
        if mounting:
            turns = [turns[i] for i in rng.permutation(len(turns))]
        first = replicates - 1 if replicates == 3 else 2
        times = first if mounting == 0 else replicates - first
        for index, one in turns:
            for k in range(times):
                replicate = k + 1 + (0 if mounting == 0 else first)
                at += 1
                trials.append(
                    replace(
                        one, trial=f"t{at:03d}", slot=f"s{index + 1:02d}", replicate=replicate,
                        mounting=mounting + 1, order=order, start_s=round(clock, 1),
                    )
                )  # fmt: skip
                clock += one.duration_s + float(rng.uniform(20.0, 60.0))
                order += int(rng.integers(1, 4))
        clock += 3600.0
    return trials


def other_trials(rng: Rng, design: Design, needs: list[str]) -> Design:
    """The same bench and habits with other slots, as many as before."""
    count = len({trial.slot for trial in design.trials})
    replicates = max(trial.replicate for trial in design.trials)
    slots = slots_of(rng, needs, count, design.habits, design.table)
    trials = sequence(rng, slots, replicates)
    measured = design.temperature_channel or any(t.temperature_c != 21.0 for t in trials)
    return replace(design, trials=tuple(trials), temperature_channel=measured)


def draw_design(rng: Rng, needs: list[str], changed: bool, table: bool, small: bool) -> Design:
    """Draw a set that can show each of `needs`."""
    keys = muscle_keys(rng, changed)
    stated = with_keys(nominal(), keys)
    true = true_constants(rng, stated)
    h = habits(rng, stated, changed)
    replicates = 3 if rng.random() < 0.7 else 4
    most = 16 if small else int(rng.choice([18, 24, 33, 44]))
    count = max(most // replicates, 4)
    slots = slots_of(rng, needs, count, h, table)
    trials = sequence(rng, slots, replicates)
    warm = any(t.temperature_c != 21.0 for t in trials)
    return Design(
        stated, true, keys, tuple(trials), h, table,
        supply_channel=bool(rng.random() < 0.5) and not table,
        temperature_channel=warm or bool(rng.random() < 0.3), changed=changed,
    )  # fmt: skip
