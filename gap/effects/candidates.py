"""The candidates of a diagnosis: every effect in several shapes, and defects of a recording.

The catalogue fixes one headline parameter for an effect, not its exact form, and a real bench
never has the form one wrote down. So each effect is tried in the shapes that its file lists, and an
effect may use two of them at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from gap.effects.recording import RECORDING
from plant.constants import PlantConstants, nominal
from plant.effects.arguments import Shape
from plant.effects.catalogue import CATALOGUE
from plant.effects.effect import Search

_SEARCHES: dict[str, Search] = {
    **{effect.id: effect.search for effect in CATALOGUE.values()},
    **{defect.id: defect.search for defect in RECORDING if defect.search is not None},
}


@dataclass(frozen=True)
class Candidate:
    """One effect in one shape.

    Attributes:
        id: catalogue id, or the name of a defect of the recording.
        step: amount of the headline parameter at which its signature is taken.
        sign: +1 where only positive amounts make sense, 0 where both do.
        blocks: which blocks of features it can touch.
        option: the word that goes with the headline parameter (side, edge), if any.
    """

    id: str
    step: float
    sign: int
    blocks: tuple[str, ...]
    shape: Shape = field(default_factory=dict)
    option: str = ""

    @property
    def search(self) -> Search:
        """How the diagnosis tries it."""
        return _SEARCHES[self.id]

    @property
    def switch(self) -> bool:
        """Whether it is there or not, without an amount in between."""
        return self.id in CATALOGUE and CATALOGUE[self.id].headline is None

    @property
    def single(self) -> bool:
        """Whether it acts in one setting alone, so that no other setting can confirm it."""
        return "only_mm" in self.shape

    @property
    def free(self) -> Mapping[str, tuple[float, float]]:
        """Numbers of its shape that a fit may move, with the range of each."""
        search = self.search
        if any(key in self.shape for key in search.fixed_by):
            return {}
        return {key: search.free[key] for key in self.shape if key in search.free}

    @property
    def curved(self) -> bool:
        """Whether its shape is the curve of `Search.curve`."""
        curve = self.search.curve
        return curve is not None and self.shape.keys() == curve.keys()

    @property
    def defect(self) -> bool:
        """Whether it is a defect of the recording, not an effect of the catalogue."""
        return self.id not in CATALOGUE

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest amount: the catalogue's range where the amount is the headline."""
        least = 0.0 if self.sign else -np.inf
        if self.defect or not self.search.bounded:
            return least, np.inf
        effect = CATALOGUE[self.id]
        if effect.headline is None:
            return least, 1.0
        headline, neutral = effect.parameters[0], effect.neutral_in(_usual())
        return max(headline.low - neutral, least), headline.high - neutral

    @property
    def family(self) -> str:
        """Family of the catalogue, or the defect itself."""
        return CATALOGUE[self.id].family if self.id in CATALOGUE else self.id

    @property
    def key(self) -> str:
        """Id with side or edge: candidates of one key are shapes of one thing."""
        return f"{self.id}:{self.option}" if self.option else self.id


@cache
def _usual() -> PlantConstants:
    return nominal()


def _of(name: str, search: Search, options: tuple[str, ...]) -> list[Candidate]:
    return [
        Candidate(name, search.step, search.sign, search.blocks, shape, option)
        for option in options
        for shape in search.shapes
    ]


CANDIDATES: tuple[Candidate, ...] = tuple(
    candidate
    for name, search in _SEARCHES.items()
    for candidate in _of(name, search, CATALOGUE[name].options if name in CATALOGUE else ("",))
)
"""All candidates: shapes of one id follow each other, defects of the recording come last."""

LEAST_LABELS = 4
"""Labels from which a single one that is wrong stands out against the others."""


def single_labels(usable: Iterable[Candidate], held_mm: Iterable[float]) -> tuple[Candidate, ...]:
    """Candidates for which each written length alone may be wrong; none with few lengths."""
    labels = sorted({round(x, 3) for x in held_mm if np.isfinite(x)})
    names = dict.fromkeys(s.id for s in usable if s.search.each_label)
    if len(labels) < LEAST_LABELS:
        return ()
    return tuple(
        Candidate(
            name, _SEARCHES[name].step, _SEARCHES[name].sign, _SEARCHES[name].blocks,
            {"only_mm": label}, f"only {label:g} mm",
        )
        for name in names for label in labels
    )  # fmt: skip


DEFECTS: dict[str, str] = {d.id: d.meaning for d in RECORDING if d.search is not None}
"""What each defect means to a person."""
