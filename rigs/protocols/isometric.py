"""The isometric test: length held, pressure stepped, force read (thesis 4.6.1).

The muscle hangs from a bar and its lower end is fixed to a mass that stands on a balance;
the balance moves so little that the length is held, and the muscle's pull is the weight it
takes off the balance. :func:`steps` is the laboratory method, top to bottom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.findings.isometric import ISOMETRIC
from rigs.execution.procedure import Procedure
from rigs.protocols.parts.method import read_leak, read_names
from rigs.rigfile.config import Limits, RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.leak_check import LeakCheck
from rigs.steps.mounting import Remount
from rigs.steps.schedule import ORDERS, Place, path
from rigs.steps.steps import (
    Dwell,
    EndTrial,
    Measure,
    SetLength,
    SetPressure,
    Settle,
    SettleCriterion,
    State,
    Tare,
    Trial,
    Vent,
    Zero,
)

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
    mountings: tuple[str, ...]
    slack_length_mm: float
    precondition_cycles: int
    precondition_kpa: float
    precondition_dwell_s: float
    settle: SettleCriterion
    measure_s: float
    frames: int
    zero_s: float
    seed: int
    leak: LeakCheck | None = None
    source: str = ""
    text: str = ""

    def schedule(self) -> list[tuple[Place, float, list[tuple[str, float]]]]:
        """Trials in order: (place, length in mm, [(direction, pressure in kPa), ...])."""
        rng = np.random.default_rng(self.seed)
        trials = []
        for replicate in range(1, self.repeats * len(self.mountings) + 1):
            m, k = divmod(replicate - 1, self.repeats)
            lengths = list(self.lengths_mm)
            if self.order == "random":
                lengths = [float(x) for x in rng.permutation(lengths)]
            elif self.order == "abba" and replicate % 2 == 0:
                lengths.reverse()
            for at, length in enumerate(lengths):
                place = Place(self.mountings[m], replicate, k == 0 and at == 0)
                trials.append((place, length, path(self.pressures_kpa, self.order, rng)))
        return trials

    def steps(self) -> Steps:
        """The method."""
        return steps(self)

    @property
    def points(self) -> int:
        """How many settled points the test has."""
        return sum(len(points) for *_, points in self.schedule())

    def as_dict(self) -> dict[str, Any]:
        """The parameters as they go into the record."""
        values = dict(vars(self))
        values["settle"] = self.settle.as_dict()
        values["leak"] = None if self.leak is None else dict(vars(self.leak))
        values["lengths_mm"] = list(self.lengths_mm)
        values["mountings"] = list(self.mountings)
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
        order=t.text("order", "up-down", choices=ORDERS),
        repeats=t.integer("repeats", 1, 1000, 2),
        mountings=read_names(t, "mountings", ("m1",)),
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
        leak=read_leak(t, top),
        source=t.source,
    )
    for table in (pre, settle, measure, t):
        table.finish()
    return out


def steps(p: Isometric) -> Steps:
    """The method.

    Leak check where one is asked for; precondition; then for each trial: slacken, breathe, vent,
    tare, hold the length, read the vented zero, step the pressures (each settled, then measured),
    vent, read zero again. Between two mountings the muscle is taken off and put back.
    """
    yield State("precondition")
    yield SetLength(sum(p.lengths_mm) / len(p.lengths_mm))
    if p.leak is not None:
        yield p.leak
        yield State("precondition")
    for _ in range(p.precondition_cycles):
        yield SetPressure(p.precondition_kpa)
        yield Dwell(p.precondition_dwell_s)
        yield Vent()
        yield Dwell(p.precondition_dwell_s)

    order = 0
    for trial, (place, length, points) in enumerate(p.schedule(), start=1):
        if place.first_of_mounting and place.mounting != p.mountings[0]:
            yield Remount(place.mounting)
        yield State(f"trial {trial}: {length:g} mm, replicate {place.replicate}")
        held = (("held_length_mm", length),)
        yield Trial(
            trial, f"L{length:g}", place.replicate, trial, place.mounting, "isometric", held
        )
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
                replicate=place.replicate,
                order=order,
                mounting=place.mounting,
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


def read(name: str, config: RigConfig) -> Isometric:
    """Its protocol file, held against the rig's limits."""
    return load_isometric(name, config.limits)


PROCEDURE = Procedure(ISOMETRIC, read)
