"""The hysteresis test: cycles up and down, at a held length or under a load (thesis 4.17-4.22)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.hysteresis import hysteresis_findings
from analysis.reduction.points import Reduction, reduce_points
from daq.live.layout import LiveLayout
from rigs.execution.actions.loads import HangLoad
from rigs.execution.actions.setpoint import at_set_pressure
from rigs.execution.procedure import Findings, Procedure
from rigs.execution.steps import State, Steps
from rigs.protocols.isotonic import read_masses
from rigs.protocols.method import Method, read_method
from rigs.protocols.trials import Logbook, Path
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml

if TYPE_CHECKING:
    from daq.store.run import Run

EXTRA = {"mass_kg": "float64", "cycle_max_kpa": "float64"}


@dataclass(frozen=True)
class Hysteresis:
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
    source: str = ""

    @property
    def frames(self) -> int:
        """Pictures at a point."""
        return self.hung.frames

    def as_dict(self) -> dict[str, Any]:
        """The parameters as they go into the record."""
        return {
            **vars(self),
            "lengths_mm": list(self.lengths_mm),
            "masses_kg": list(self.masses_kg),
            "cycles_kpa": list(self.cycles_kpa),
            "held": self.held.as_dict(),
            "hung": self.hung.as_dict(),
        }

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
    held = read_method(t, config, drift_n=0.05, drift_mm=0.02)
    out = Hysteresis(
        name=t.text("name", "hysteresis"),
        lengths_mm=lengths,
        masses_kg=masses,
        cycles_kpa=t.numbers("cycles_kpa", 20, config.limits.pressure_kpa, unit="kPa"),
        step_kpa=t.number("step_kpa", 5, config.limits.pressure_kpa, 50.0, unit="kPa"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        held=replace(held, settle=replace(held.settle, drift_mm=None)),
        hung=replace(held, settle=replace(held.settle, drift_n=None), leak=None),
        source=t.source,
    )
    t.finish()
    return out


def reduce(run: Run) -> Reduction:
    """Settled points with the mass that hung and the turn of the cycle."""
    return reduce_points(run, extra=EXTRA)


def findings(run: Run, reduction: Reduction) -> Findings:
    """Of both kinds of cycle, each by itself, at the set pressures."""
    hung = reduction.table["mass_kg"].notna()
    parts = []
    for use, value in ((~hung, "force_n"), (hung, "length_mm")):
        table = at_set_pressure(reduction.table[use].reset_index(drop=True), value)
        if len(table) or (value == "force_n" and not hung.any()):
            parts.append(hysteresis_findings(run, replace(reduction, table=table)))
    if len(parts) == 1:
        return parts[0]
    return Findings(
        " ".join(part.headline for part in parts),
        tuple(section for part in parts for section in part.sections),
        {"isometric": parts[0].data, "isotonic": parts[1].data},
    )


def layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.static import hysteresis_layout

    return hysteresis_layout(
        parameters.get("lengths_mm") or (),
        parameters.get("masses_kg") or (),
        max(parameters.get("cycles_kpa") or [600.0]),
    )


PROCEDURE = Procedure(
    "hysteresis", "Hysteresis test", read, reduce, layout, findings,
    # A load that moves squeezes the air that is shut in: no leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
