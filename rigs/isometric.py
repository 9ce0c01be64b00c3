"""The isometric test: length held, pressure stepped, force read (thesis 4.6.1).

The muscle hangs from a bar and its lower end is fixed to a mass that stands on a balance;
the balance moves so little that the length is held, and the muscle's pull is the weight it
takes off the balance. :func:`steps` is the laboratory method, top to bottom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rigs.config import Limits
from rigs.steps import (
    Dwell,
    EndTrial,
    Measure,
    SetLength,
    SetPressure,
    Settle,
    SettleCriterion,
    State,
    Steps,
    Tare,
    Trial,
    Vent,
    Zero,
)
from rigs.toml_reader import load_toml

BREATH_KPA = 20.0
BREATH_S = 0.5
VENTED_KPA = 5.0
"""Below this a set-point means "vented", not regulated: no valve holds 0 kPa gauge."""


@dataclass(frozen=True)
class Isometric:
    """Parameters of an isometric test, as read from its protocol file."""

    name: str
    lengths_mm: tuple[float, ...]
    pressures_kpa: tuple[float, ...]
    order: str
    repeats: int
    mounting: str
    slack_length_mm: float
    precondition_cycles: int
    precondition_kpa: float
    precondition_dwell_s: float
    settle: SettleCriterion
    measure_s: float
    frames: int
    zero_s: float
    seed: int
    source: str = ""
    text: str = ""

    def schedule(self) -> list[tuple[float, int, list[tuple[str, float]]]]:
        """Trials in order: (length in mm, replicate, [(direction, pressure in kPa), ...])."""
        rng = np.random.default_rng(self.seed)
        trials = []
        for replicate in range(1, self.repeats + 1):
            lengths = list(self.lengths_mm)
            if self.order == "random":
                lengths = [float(x) for x in rng.permutation(lengths)]
            for length in lengths:
                if self.order == "random":
                    points = [("single", float(p)) for p in rng.permutation(self.pressures_kpa)]
                else:
                    up = sorted(self.pressures_kpa)
                    points = [("up", p) for p in up] + [("down", p) for p in reversed(up)]
                trials.append((length, replicate, points))
        return trials

    def steps(self) -> Steps:
        """The method."""
        return steps(self)

    @property
    def points(self) -> int:
        """How many settled points the test has."""
        return sum(len(points) for _, _, points in self.schedule())

    def as_dict(self) -> dict[str, Any]:
        """The parameters as they go into the record."""
        values = dict(vars(self))
        values["settle"] = self.settle.as_dict()
        values["lengths_mm"] = list(self.lengths_mm)
        values["pressures_kpa"] = list(self.pressures_kpa)
        del values["text"]
        return values


def load_isometric(name: str, limits: Limits) -> Isometric:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("isometric",))
    low, high = limits.length_min_mm, limits.length_max_mm
    top = limits.pressure_kpa
    pre = t.table("precondition", optional=True)
    settle = t.table("settle", optional=True)
    measure = t.table("measure", optional=True)
    out = Isometric(
        name=t.text("name", "isometric"),
        lengths_mm=t.numbers("lengths_mm", low, high, unit="mm"),
        pressures_kpa=t.numbers("pressures_kpa", 0, top, unit="kPa"),
        order=t.text("order", "up-down", choices=("up-down", "random")),
        repeats=t.integer("repeats", 1, 1000, 2),
        mounting=t.text("mounting", "m1"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        precondition_cycles=pre.integer("cycles", 0, 1000, 3),
        precondition_kpa=pre.number("pressure_kpa", 0, top, min(400.0, top), unit="kPa"),
        precondition_dwell_s=pre.number("dwell_s", 0, 600, 1.0, unit="s"),
        settle=SettleCriterion(
            window_s=settle.number("window_s", 0.2, 60, 0.5, unit="s"),
            pressure_kpa=settle.number("pressure_kpa", 0.1, 100, 1.5, unit="kPa"),
            drift_kpa=settle.number("drift_kpa", 0.05, 100, 0.5, unit="kPa"),
            drift_n=settle.number("drift_n", 0.001, 100, 0.05, unit="N"),
            timeout_s=settle.number("timeout_s", 0.5, 3600, 20.0, unit="s"),
        ),
        measure_s=measure.number("seconds", 0.2, 600, 1.0, unit="s"),
        frames=measure.integer("frames", 0, 1000, 1),
        zero_s=measure.number("zero_s", 0.2, 600, 0.5, unit="s"),
        seed=t.integer("seed", 0, 2**63 - 1, 1),
        source=t.source,
    )
    for table in (pre, settle, measure, t):
        table.finish()
    return out


def steps(p: Isometric) -> Steps:
    """The method.

    Precondition; then for each trial: slacken, breathe, vent, tare, hold the length, read the
    vented zero, step the pressures (each settled, then measured), vent, read zero again.
    """
    yield State("precondition")
    yield SetLength(sum(p.lengths_mm) / len(p.lengths_mm))
    for _ in range(p.precondition_cycles):
        yield SetPressure(p.precondition_kpa)
        yield Dwell(p.precondition_dwell_s)
        yield Vent()
        yield Dwell(p.precondition_dwell_s)

    order = 0
    for trial, (length, replicate, points) in enumerate(p.schedule(), start=1):
        yield State(f"trial {trial}: {length:g} mm, replicate {replicate}")
        held = (("held_length_mm", length),)
        yield Trial(trial, f"L{length:g}", replicate, trial, p.mounting, "isometric", held)
        yield Vent()
        yield SetLength(p.slack_length_mm)
        # Shortening draws a slight vacuum that an outlet need not let go; a breath of air
        # does away with it, so that the tare is one at no pressure.
        yield SetPressure(BREATH_KPA)
        yield Dwell(BREATH_S)
        yield Vent()
        yield Tare()
        yield SetLength(length)
        yield Zero(trial, "before", p.zero_s)
        for direction, pressure in points:
            if pressure < VENTED_KPA:
                yield Vent()
            else:
                yield SetPressure(pressure)
            answer = yield Settle(p.settle, pressure)
            settled, waited = answer if answer is not None else (True, 0.0)
            order += 1
            yield Measure(
                trial=trial,
                slot=f"L{length:g}",
                replicate=replicate,
                order=order,
                mounting=p.mounting,
                direction=direction,
                set_pressure_kpa=pressure,
                set_length_mm=length,
                seconds=p.measure_s,
                frames=p.frames,
                settled=settled,
                waited_s=waited,
            )
        yield Vent()
        yield Zero(trial, "after", p.zero_s)
        yield EndTrial(trial)
    yield State("done")
