"""The hysteresis test: cycles up and down, at a held length or under a load (thesis 4.17-4.22)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.findings.hysteresis import HYSTERESIS
from analysis.reduction.muscle.energy import Air
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.isotonic import read_masses
from rigs.protocols.parts.air import read_air
from rigs.protocols.parts.method import Method, read_method
from rigs.protocols.parts.trials import Logbook, Path
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad
from rigs.steps.steps import State


@dataclass(frozen=True)
class Hysteresis(ProtocolParameters):
    """Parameters of a hysteresis test; either list of what is held may be empty.

    The two methods differ in their settling alone: one watches the force, one the length.
    """

    name: str
    lengths_mm: tuple[float, ...]
    masses_kg: tuple[float, ...]
    cycles_kpa: tuple[float, ...]
    step_kpa: float
    slack_length_mm: float
    held: Method
    hung: Method
    air: Air | None = None
    source: str = ""

    @property
    def frames(self) -> int:
        """Pictures at a point."""
        return self.hung.frames

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json, without a table that the file does not have."""
        return {k: v for k, v in super().as_dict().items() if k != "air" or v is not None}

    def cycle(self, top_kpa: float) -> Path:
        """Set-points from nothing to the turn and back, each pressure once each way."""
        up = [float(p) for p in np.arange(0.0, top_kpa - 1e-9, self.step_kpa)] + [top_kpa]
        return [("up", p) for p in up] + [("down", p) for p in reversed(up)]

    def steps(self) -> Steps:
        """The method: each length through each cycle, then each load through each cycle."""
        book = Logbook(self.held, "hysteresis", self.slack_length_mm)
        if self.lengths_mm:
            yield from book.opening(sum(self.lengths_mm) / len(self.lengths_mm))
        settings = [(held, top) for held in self.lengths_mm for top in self.cycles_kpa]
        for place, (length, top) in self.held.trials(settings):
            yield from book.remount(place)
            yield from book.isometric(place, length, self.cycle(top), top)
        if self.masses_kg:
            book.method = self.hung
            yield State("first load")
            yield HangLoad(self.masses_kg[0])
            yield from book.opening(None)
        settings = [(held, top) for held in self.masses_kg for top in self.cycles_kpa]
        for place, (mass, top) in self.hung.trials(settings):
            yield from book.remount(place)
            yield from book.isotonic(place, mass, self.cycle(top), top)
        yield State("done")
        if self.masses_kg:
            yield HangLoad(0.0)


def read(name: str, config: RigConfig) -> Hysteresis:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("hysteresis",))
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    lengths = t.numbers("lengths_mm", low, high, (), unit="mm", least=0)
    masses = read_masses(t, config) if "masses_kg" in t else ()
    if not lengths and not masses:
        raise t.fail("lengths_mm", "neither a length nor a mass to hold", "name some of either")
    held = read_method(t, config.limits, drift_n=0.05, drift_mm=0.02)
    out = Hysteresis(
        name=t.text("name", "hysteresis"),
        lengths_mm=lengths,
        masses_kg=masses,
        cycles_kpa=t.numbers("cycles_kpa", 20, config.limits.pressure_kpa, unit="kPa"),
        step_kpa=t.number("step_kpa", 5, config.limits.pressure_kpa, 50.0, unit="kPa"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        held=replace(held, settle=replace(held.settle, drift_mm=None)),
        hung=replace(held, settle=replace(held.settle, drift_n=None), leak=None),
        acceptance=read_acceptance(t, HYSTERESIS.results),
        air=read_air(t),
        source=t.source,
    )
    t.finish()
    return out


PROCEDURE = Procedure(
    HYSTERESIS, read,
    # A load that moves squeezes the air that is shut in: no leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
