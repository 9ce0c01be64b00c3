"""The times of creep and relaxation tests: parts that grow by a factor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from rigs.execution.procedure import Parameters
from rigs.protocols.parts.trials import Logbook
from rigs.rigfile.toml_reader import Table
from rigs.steps.custom_step import Steps
from rigs.steps.muscle.held import HeldPart, Hold
from rigs.steps.schedule import Place

SHORTEST_PART_S = 0.2
"""A balance with ten readings a second gives two in this time."""


@dataclass(frozen=True)
class Times(Parameters):
    """When a held muscle is read.

    Attributes:
        first_s: end of the first moments, which are left out.
        duration_s: end of the hold.
        per_decade: parts of a factor of ten in time.
        frames: pictures in each part.
    """

    first_s: float
    duration_s: float
    per_decade: int
    frames: int

    def parts(self) -> list[tuple[float, float]]:
        """Begin and end of each part in s; none is shorter than 0.2 s."""
        factor = 10.0 ** (1.0 / self.per_decade)
        edges = [self.first_s]
        while edges[-1] < self.duration_s * (1.0 - 1e-9):
            edges.append(min(max(edges[-1] * factor, edges[-1] + SHORTEST_PART_S), self.duration_s))
        if len(edges) > 2 and math.log(edges[-1] / edges[-2]) < math.log(factor) / 2:
            del edges[-2]  # a short rest joins the part before it
        return list(pairwise(edges))

    def held(
        self,
        book: Logbook,
        place: Place,
        slot: str,
        hold: Hold,
        length_mm: float | None,
        mass_kg: float | None,
    ) -> Steps:
        """Begin to hold, then one point for each part of the time."""
        start_ns = yield hold
        for begin, end in self.parts():
            book.order += 1
            yield HeldPart(
                book.trial, slot, place.replicate, book.order, place.mounting, hold.pressure_kpa,
                start_ns, begin, end, self.frames, length_mm, mass_kg,
            )  # fmt: skip


def read_times(t: Table, frames: int) -> Times:
    """The table ``[times]`` of a protocol file. ``frames``: least and default number of pictures.

    Raises:
        ConfigError: names file and key.
    """
    s = t.table("times")
    out = Times(
        first_s=s.number("first_s", 0.2, 3600.0, 2.0, unit="s"),
        duration_s=s.number("duration_s", 1.0, 30 * 86400.0, unit="s"),
        per_decade=s.integer("per_decade", 1, 50, 10),
        frames=s.integer("frames", frames, 100, frames),
    )
    if out.duration_s < 2.0 * out.first_s:
        raise s.fail("duration_s", f"must be at least twice first_s = {out.first_s:g} s")
    s.finish()
    return out
