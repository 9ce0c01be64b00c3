"""The isometric test: length held, pressure stepped, force read (thesis 4.6.1).

The muscle hangs from a bar and its lower end is fixed to a mass that stands on a balance;
the balance moves so little that the length is held, and the muscle's pull is the weight it
takes off the balance. :func:`steps` is the laboratory method, top to bottom.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from analysis.findings.isometric import ISOMETRIC
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.parts.method import Method, read_method
from rigs.protocols.parts.trials import VENTED_KPA, Logbook
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import Limits, RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.leak_check import LeakCheck
from rigs.steps.schedule import Place, path
from rigs.steps.steps import (
    Dwell,
    SetLength,
    SetPressure,
    SettleCriterion,
    State,
    Trial,
    Vent,
    Zero,
)


@dataclass(frozen=True)
class Isometric(ProtocolParameters):
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

    @property
    def method(self) -> Method:
        """What it has in common with other tests."""
        return Method(**{field.name: getattr(self, field.name) for field in fields(Method)})


def load_isometric(name: str, limits: Limits) -> Isometric:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("isometric",))
    low, high = limits.length_min_mm, limits.length_max_mm
    out = Isometric(
        name=t.text("name", "isometric"),
        lengths_mm=t.numbers("lengths_mm", low, high, unit="mm"),
        pressures_kpa=t.numbers("pressures_kpa", 0, limits.pressure_kpa, unit="kPa"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        acceptance=read_acceptance(t, ISOMETRIC.results),
        source=t.source,
        **vars(read_method(t, limits, drift_n=0.05)),
    )
    t.finish()
    return out


def steps(p: Isometric) -> Steps:
    """The method.

    Leak check where the file has one; precondition; then for each trial: slacken, breathe, vent,
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

    book = Logbook(p.method, "isometric", p.slack_length_mm)
    for book.trial, (place, length, points) in enumerate(p.schedule(), start=1):
        slot = f"L{length:g}"
        yield from book.remount(place)
        yield State(f"trial {book.trial}: {length:g} mm, replicate {place.replicate}")
        yield Trial(
            book.trial, slot, place.replicate, book.trial, place.mounting, "isometric",
            (("held_length_mm", length),),
        )  # fmt: skip
        yield from book.tared()
        yield SetLength(length)
        yield Zero(book.trial, "before", p.zero_s)
        for direction, pressure in points:
            yield Vent() if pressure < VENTED_KPA else SetPressure(pressure)
            yield from book.point(place, slot, direction, pressure, length_mm=length)
        yield Vent()
        yield from book.end()
    yield State("done")


def read(name: str, config: RigConfig) -> Isometric:
    """Its protocol file, held against the rig's limits."""
    return load_isometric(name, config.limits)


PROCEDURE = Procedure(ISOMETRIC, read)
