"""A ladder of effects on settled points, every number of it from settings that were left out.

Whole settings (a held length, a load) are left out in turn. With the others the constants are
fitted and the next effect is chosen, so that the choice is never made on what it is judged by
(Cawley and Talbot 2010). The ladder stops when a further effect does not take away at least 3 % of
what is left above the floor, or takes it away no more surely than chance (signed-rank test over
settings, p < 0.005).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.stats import wilcoxon

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.catalogue import CATALOGUE
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.simulator.force_law import ForceLaw
from plant.simulator.readings import pressure_error, read_force
from plant.simulator.simulate import held_offset_mm

Values = dict[str, dict[str, float]]

LEAST_SHARE = 0.03
SURE = 0.005
FAR_N = 1e3

CANDIDATES = {e.id: e.search.settled for e in CATALOGUE.values() if e.search.settled}
"""Effects that settled points can show, with start and bounds of what is fitted of each.

Gains and scales are not among them: with the geometry free they vanish into it. Effects of speed,
time and order have nothing to show themselves in.
"""


@dataclass(frozen=True)
class Table:
    """Settled points: readings, the path each came by, and the setting it belongs to.

    Attributes:
        pressure_kpa, length_mm, force_n, temperature_c: shape (points,).
        path: number of the unbroken path of each point, in the order of rows; -1 where unknown.
        setting: number of the setting that is left out with the point.
    """

    pressure_kpa: Array
    length_mm: Array
    force_n: Array
    temperature_c: Array
    path: npt.NDArray[np.int64]
    setting: npt.NDArray[np.int64]

    def only(self, use: npt.NDArray[np.bool_]) -> Table:
        """Those of the points where `use`."""
        return Table(*(np.asarray(getattr(self, name))[use] for name in self.__annotations__))


@dataclass(frozen=True)
class Step:
    """One rung: the effects in force and the error on settings that were left out, in N.

    Attributes:
        added: what the settings' fits added, with how many of them did; empty for the first rung.
        values: parameters fitted to all settings.
        spread: lowest and highest of each headline parameter over the fits.
        p: chance of as large a gain over the rung above; None for the first.
        kept: whether the gain was large and sure enough.
        rivals: held-out error with each other candidate in place of the chosen one.
    """

    added: Mapping[str, int]
    rms: float
    values: Values
    spread: Mapping[str, tuple[float, float]]
    p: float | None = None
    kept: bool = True
    rivals: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Fit:
    """Constants and effects fitted to some points."""

    braid_mm: float
    turns: float
    values: Values
    squares: float


@dataclass
class Ladder:
    """Steps of one table.

    Attributes:
        table: the points.
        constants: the plant as stated.
        free: whether braid length and turns are fitted too.
        candidates: effects to choose from.
        floor_n: error that no model of this kind could go below.
    """

    table: Table
    constants: PlantConstants
    free: bool
    candidates: Sequence[str]
    floor_n: float

    def __post_init__(self) -> None:
        self.settings = np.unique(self.table.setting)
        self._without: dict[tuple[int, tuple[str, ...]], Fit] = {}

    def climb(self, most: int = 3) -> list[Step]:
        """Add effects until one is not worth it; that one is the last step, not kept."""
        best: list[tuple[str, ...]] = [() for _ in self.settings]
        steps = [self._step(best, None)]
        for _ in range(most):
            tried = {
                name: self._errors([(*ids, name) if name not in ids else ids for ids in best])
                for name in self.candidates
            }
            further = [self._next(k, ids) for k, ids in enumerate(best)]
            step = self._step(further, self._errors(best), tried)
            steps.append(step)
            if not step.kept:
                break
            best = further
        return steps

    def alone(self) -> dict[str, float]:
        """Held-out error with each candidate alone, in N, best first."""
        count = len(self.table.force_n)
        squares = {n: self._errors([(n,)] * len(self.settings)).sum() for n in self.candidates}
        order = sorted(squares, key=lambda name: squares[name])
        return {name: float(np.sqrt(squares[name] / count)) for name in order}

    def _next(self, k: int, ids: tuple[str, ...]) -> tuple[str, ...]:
        """The effect that helps most on the settings that are not left out."""
        fits = {n: self._left(k, (*ids, n)).squares for n in self.candidates if n not in ids}
        best = min(fits, key=lambda name: fits[name])
        return (*ids, best)

    def _errors(self, best: Sequence[tuple[str, ...]]) -> Array:
        """Squared errors of each setting when it was left out, shape (settings,)."""
        squares = np.zeros(len(self.settings))
        for k, ids in enumerate(best):
            out = self.table.only(self.table.setting == self.settings[k])
            squares[k] = float(np.sum(self.residual(out, self._left(k, ids)) ** 2))
        return squares

    def _left(self, k: int, ids: tuple[str, ...]) -> Fit:
        """Fit to all settings but the k-th; each is made once."""
        if (k, ids) not in self._without:
            rest = self.table.only(self.table.setting != self.settings[k])
            self._without[k, ids] = self.fit(rest, ids)
        return self._without[k, ids]

    def _step(
        self,
        best: Sequence[tuple[str, ...]],
        above: Array | None,
        tried: Mapping[str, Array] | None = None,
    ) -> Step:
        squares = self._errors(best)
        common = Counter(best).most_common(1)[0][0]
        whole = self.fit(self.table, common)
        added = Counter(ids[-1] for ids in best if ids)
        count = len(self.table.force_n)
        p, kept = None, True
        if above is not None:
            p = float(wilcoxon(above - squares, alternative="greater").pvalue)
            left = max(float(above.sum()) / count - self.floor_n**2, 1e-12)
            kept = p < SURE and (above.sum() - squares.sum()) / count > LEAST_SHARE * left
        rivals = {
            name: float(np.sqrt(errors.sum() / count))
            for name, errors in (tried or {}).items()
            if name not in common
        }
        return Step(
            dict(added), float(np.sqrt(squares.sum() / count)), whole.values,
            self._spread(best, common), p, bool(kept), rivals or None,
        )  # fmt: skip

    def _spread(
        self, best: Sequence[tuple[str, ...]], common: tuple[str, ...]
    ) -> dict[str, tuple[float, float]]:
        found: dict[str, list[float]] = {}
        for k, ids in enumerate(best):
            if ids != common:
                continue
            for name, parameters in self._left(k, ids).values.items():
                headline = next(iter(CANDIDATES[name]))
                found.setdefault(name, []).append(parameters[headline])
        return {name: (min(values), max(values)) for name, values in found.items()}

    def fit(self, table: Table, ids: Sequence[str]) -> Fit:
        """Least squares over geometry (where free) and the effects' parameters."""
        start, low, high = self._bounds(ids)
        found = least_squares(
            lambda x: self.residual(table, self._fit_of(x, ids)), start, bounds=(low, high),
            x_scale=np.maximum(np.abs(start), 0.1), max_nfev=40,
        )  # fmt: skip
        fit = self._fit_of(found.x, ids)
        return Fit(fit.braid_mm, fit.turns, fit.values, 2.0 * float(found.cost))

    def _bounds(self, ids: Sequence[str]) -> tuple[Array, Array, Array]:
        rows = []
        if self.free:
            b, n = self.constants.braid_length_m * 1e3, self.constants.turns
            top = float(self.table.length_mm.max())
            rows = [(b, max(0.8 * b, top + 5.0), 1.25 * b), (n, 0.6 * n, 1.6 * n)]
        for name in ids:
            rows += list(CANDIDATES[name].values())
        if not rows:
            rows = [(0.0, -1.0, 1.0)]
        return tuple(np.array(column) for column in zip(*rows, strict=True))  # type: ignore[return-value]

    def _fit_of(self, x: Array, ids: Sequence[str]) -> Fit:
        rest = [float(value) for value in x]
        b, n = self.constants.braid_length_m * 1e3, self.constants.turns
        if self.free:
            b, n = rest.pop(0), rest.pop(0)
        values = {name: {key: rest.pop(0) for key in CANDIDATES[name]} for name in ids}
        return Fit(b, n, values, 0.0)

    def residual(self, table: Table, fit: Fit) -> Array:
        """Measured less predicted force in N, shape (points,)."""
        try:
            c = self.constants.with_overrides({"braid_length_mm": fit.braid_mm, "turns": fit.turns})
            effects = Effects.from_config(fit.values)
            law = ForceLaw(c, effects)
            p = (table.pressure_kpa - pressure_error(effects)[1]) * 1e3
            length = (table.length_mm + held_offset_mm(table.length_mm, c, effects)) * 1e-3
            force = law.lasting(p, length, table.temperature_c)
            force = force + self._friction(law, table, p, length)
        except PlantError:
            return np.full(len(table.force_n), FAR_N)
        return np.asarray(table.force_n - read_force(force, effects))

    def _friction(self, law: ForceLaw, table: Table, p: Array, length: Array) -> Array:
        """What friction adds along each path that is known; nothing where it is not."""
        out = np.zeros(len(p))
        for number in np.unique(table.path[table.path >= 0]):
            here = table.path == number
            none = np.zeros(int(here.sum()))
            out[here] = law.transient(none, p[here], length[here], none, none)
        return out
