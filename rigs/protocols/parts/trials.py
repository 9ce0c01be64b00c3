"""The trials that tests are made of: one length, one pressure or one load held.

Each is a stretch of laboratory method, top to bottom; the protocols put them in order.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rigs.protocols.parts.method import Method
from rigs.steps.custom_step import Step, Steps
from rigs.steps.loads import HangLoad, LowerLoad
from rigs.steps.mounting import Remount
from rigs.steps.schedule import Place, path
from rigs.steps.steps import (
    Dwell,
    EndTrial,
    Measure,
    SetLength,
    SetPressure,
    Settle,
    State,
    Tare,
    Trial,
    Vent,
    Zero,
)
from rigs.steps.sweep import Sweep

BREATH_KPA = 20.0
BREATH_S = 0.5
VENTED_KPA = 5.0
"""Below this a set-point means "vented", not regulated: no valve holds 0 kPa gauge."""

Path = Sequence[tuple[str, float]]


@dataclass
class Logbook:
    """Numbers trials and points as they come, and writes what each one is.

    Attributes:
        method: the habits of the test.
        protocol: what a trial is called in data that goes elsewhere.
        slack_mm: where the balance is tared.
        temperature_c: set temperature, where the test has one.
    """

    method: Method
    protocol: str
    slack_mm: float = 0.0
    temperature_c: float | None = None
    trial: int = 0
    order: int = 0
    rng: np.random.Generator = field(init=False)
    _made: set[tuple[str, int]] = field(init=False, default_factory=set)
    _hung: tuple[float, float] = field(init=False, default=(0.0, 0.0))

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.method.seed, 2])

    def path(self, values: Sequence[float]) -> Path:
        """The points of a trial in the test's order."""
        return path(values, self.method.order, self.rng)

    # ---- before and between ---------------------------------------------------------

    def opening(self, length_mm: float | None) -> Steps:
        """Leak check and preconditioning, at a held length or under what hangs."""
        method = self.method
        if length_mm is not None:
            yield SetLength(length_mm)
        if method.leak is not None:
            yield method.leak
        if method.precondition_cycles:
            yield State("precondition")
        for _ in range(method.precondition_cycles):
            yield SetPressure(method.precondition_kpa)
            yield Dwell(method.precondition_dwell_s)
            yield LowerLoad()
            yield Dwell(method.precondition_dwell_s)

    def remount(self, place: Place) -> Steps:
        """A new mounting where one begins."""
        if place.first_of_mounting and place.mounting != self.method.mountings[0]:
            yield Remount(place.mounting)

    # ---- one trial ------------------------------------------------------------------

    def isometric(
        self, place: Place, length_mm: float, points: Path, top_kpa: float | None = None
    ) -> Steps:
        """A length held, the pressure stepped, the force read (thesis, section 4.6.1)."""
        name = f"L{length_mm:g}" + (f" to {top_kpa:g} kPa" if top_kpa else "")
        yield from self.begin(place, name, "isometric", (("held_length_mm", length_mm),))
        yield from self.tared()
        yield SetLength(length_mm)
        yield Zero(self.trial, "before", self.method.zero_s)
        for direction, pressure in points:
            yield Vent() if pressure < VENTED_KPA else SetPressure(pressure)
            yield from self.point(
                place, name, direction, pressure, length_mm=length_mm, top_kpa=top_kpa
            )
        yield Vent()
        yield from self.end()

    def isobaric(self, place: Place, pressure_kpa: float, points: Path) -> Steps:
        """A pressure held, the length stepped through its range, the force read (4.8.2)."""
        name = f"P{pressure_kpa:g}"
        yield from self.begin(place, name, "isobaric", (("held_pressure_kpa", pressure_kpa),))
        yield from self.tared()
        yield SetLength(points[0][1])
        yield Zero(self.trial, "before", self.method.zero_s)
        if pressure_kpa >= VENTED_KPA:
            yield SetPressure(pressure_kpa)
        for direction, length in points:
            yield SetLength(length)
            if pressure_kpa < VENTED_KPA:
                yield from self.breath()
            yield from self.point(place, name, direction, pressure_kpa, length_mm=length)
        yield Vent()
        yield from self.end()

    def swept(self, place: Place, pressure_kpa: float, sweeps: Sequence[Sweep]) -> Steps:
        """A pressure held while the stage goes there and back at some speeds, watched all the way.

        A trial of its own: its pictures come evenly, those of settled points do not.
        """
        name = f"P{pressure_kpa:g} swept"
        yield from self.begin(place, name, "isobaric", (("held_pressure_kpa", pressure_kpa),))
        yield from self.tared()
        yield SetLength(sweeps[0].from_mm)
        yield Zero(self.trial, "before", self.method.zero_s)
        yield SetPressure(pressure_kpa)
        yield Settle(self.method.settle, pressure_kpa)
        yield from sweeps
        yield Vent()
        yield from self.end()

    def isotonic(
        self, place: Place, mass_kg: float, points: Path, top_kpa: float | None = None
    ) -> Steps:
        """A load hung, the pressure stepped, the length read by the camera (4.6.2, 4.8.3)."""

        def name(mass_kg: float) -> str:
            return f"M{mass_kg:.10g}" + (f" to {top_kpa:g} kPa" if top_kpa else "")

        place, slot, hung = yield from self.begin_hung(place, mass_kg, name, "isotonic")
        yield Zero(self.trial, "before", self.method.zero_s)
        for direction, pressure in points:
            yield LowerLoad() if pressure < VENTED_KPA else SetPressure(pressure)
            yield from self.point(place, slot, direction, pressure, mass_kg=hung, top_kpa=top_kpa)
        yield LowerLoad()
        yield from self.end()

    # ---- parts of a trial -----------------------------------------------------------

    def begin(
        self, place: Place, slot: str, protocol: str, held: tuple[tuple[str, float], ...]
    ) -> Steps:
        """A trial begins: its number, its name in the record, and what is held in it."""
        self.trial += 1
        warm = ""
        if self.temperature_c is not None:
            held = (*held, ("temperature_c", self.temperature_c))
            warm = f" at {self.temperature_c:g} °C"
        yield State(f"trial {self.trial}: {in_words(slot)}{warm}, replicate {place.replicate}")
        yield Trial(
            self.trial, slot + warm, place.replicate, self.trial, place.mounting, protocol, held
        )

    def begin_hung(
        self,
        place: Place,
        mass_kg: float,
        name: Callable[[float], str],
        protocol: str,
        held: tuple[tuple[str, float], ...] = (),
    ) -> Generator[Step, Any, tuple[Place, str, float]]:
        """A trial begins and its load is hung: (place, slot, what hangs in kg).

        Where a person hung another mass than requested, the trial begins again as one of that
        mass, so that it is no replicate of those with the requested one. No two trials of a test
        have the same slot and replicate.

        Args:
            place: where the trial stands in the test.
            mass_kg: what is requested.
            name: the slot of a mass.
            protocol, held: as for :meth:`begin`; the load is added.
        """
        there = self._hung[1] if self._hung[0] == mass_kg else mass_kg
        place, slot = self._free(place, name(there)), name(there)
        yield from self.begin(place, slot, protocol, (("load_kg", there), *held))
        answer = yield HangLoad(mass_kg)
        hung = there if answer is None else float(answer)
        self._hung = mass_kg, hung
        if hung != there:
            self.trial -= 1
            place, slot = self._free(place, name(hung)), name(hung)
            yield from self.begin(place, slot, protocol, (("load_kg", hung), *held))
        self._made.add((slot, place.replicate))
        return place, slot, hung

    def _free(self, place: Place, slot: str) -> Place:
        """The place, with a later replicate where this one of the slot was made already."""
        while (slot, place.replicate) in self._made:
            place = replace(place, replicate=place.replicate + 1)
        return place

    def tared(self) -> Steps:
        """Slacken, breathe, vent, tare: the tare is one at no pressure."""
        yield Vent()
        yield SetLength(self.slack_mm)
        yield from self.breath()
        yield Tare()

    def breath(self) -> Steps:
        """A breath of air in and out.

        Shortening a vented muscle draws a slight vacuum that an outlet need not release, and that
        a pressure sensor which begins at nothing does not show; the breath does away with it.
        """
        yield SetPressure(BREATH_KPA)
        yield Dwell(BREATH_S)
        yield Vent()

    def point(
        self,
        place: Place,
        slot: str,
        direction: str,
        pressure_kpa: float,
        length_mm: float | None = None,
        mass_kg: float | None = None,
        top_kpa: float | None = None,
    ) -> Steps:
        """Settle, then measure."""
        answer = yield Settle(self.method.settle, pressure_kpa)
        settled, waited = answer if answer is not None else (True, 0.0)
        self.order += 1
        warm = "" if self.temperature_c is None else f" at {self.temperature_c:g} °C"
        yield Measure(
            trial=self.trial,
            slot=slot + warm,
            replicate=place.replicate,
            order=self.order,
            mounting=place.mounting,
            direction=direction,
            set_pressure_kpa=pressure_kpa,
            set_length_mm=length_mm,
            seconds=self.method.measure_s,
            frames=self.method.frames,
            settled=settled,
            waited_s=waited,
            mass_kg=mass_kg,
            cycle_max_kpa=top_kpa,
            set_temperature_c=self.temperature_c,
        )

    def end(self) -> Steps:
        """Vented: the zero again, and the trial is whole."""
        yield Zero(self.trial, "after", self.method.zero_s)
        yield EndTrial(self.trial)


def in_words(slot: str) -> str:
    """A slot as a person reads it: ``M1.154 to 400 kPa`` is ``1.154 kg to 400 kPa``."""
    unit = {"L": "mm", "P": "kPa", "M": "kg"}.get(slot[:1])
    number, space, rest = slot[1:].partition(" ")
    if unit is None or not number.replace(".", "", 1).isdigit():
        return slot
    return f"{number} {unit}{space}{rest}"
