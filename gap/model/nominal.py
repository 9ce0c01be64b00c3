"""The nominal plant where a simulator from elsewhere takes the place of a built-in stage.

What the simulator predicts is the plant before any effect; effects act around it as they act
around the built-in physics. A force law without memory is evaluated at the true pressure and
length behind the readings. A simulator with memory is run on the measured inputs, and what effects
change is taken from the built-in physics:

    prediction = simulator(measured) + built-in(with effects) - built-in(without)

Its own numbers are parameters of the fit with their prior; predictions are linear in them around
the values at which the simulator was last run. The error that the form of its force stage is known
to have is a Gaussian process over pressure and length, the same in all trials.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gap.data.dataset import DataSet
from gap.data.simulator import ExternalSimulator, StaticForce, rough_error_n
from gap.data.trial import Channel, Trial
from gap.effects.terms import NOMINAL, Active
from gap.errors import GapError
from plant.arrays import Array
from plant.effects.arguments import Points

ForceLaw = Callable[[Array, Array], Array]
"""Pull in N at gauge pressure in Pa and length in m."""

_BLOCKS = {"pressure": "pressure", "force": "force", "load": "force"}
"""Stage that predicts each block of features."""
_NODES = 9
_REACH = 0.35
"""Correlation length of a law's error, as a share of the range of pressure and of length."""
_FINE = 0.5
_FINE_SHARE = 0.03
"""A part of the variance has a shorter one: a law bends where the muscle goes slack or meets its
ends. Set on: muscles of another generator with fitted laws, and nothing hidden. Without it, or with
fewer terms, what the terms left of 10 N was called unknown in 2 of 2 such sets."""
_LEAST_RANGE = (20e3, 2e-3)
_KEPT = 0.9999
"""Share of the variance of the error that its terms hold: what they leave is 1 % of its sd."""
_MOST_TERMS = 64
_STEP = 0.5
"""Step, in sd, of the finite differences of a simulator with memory."""


@dataclass(frozen=True)
class Prior:
    """What is known of a simulator's parameters: `nominal + root @ z`, each z of unit variance.

    Attributes:
        names: parameters that are not exact, shape (n,).
        nominal: their stated values.
        root: shape (n, n); diagonal where the parameters are independent.
    """

    names: tuple[str, ...]
    nominal: Array
    root: Array

    @classmethod
    def of(cls, simulator: ExternalSimulator) -> Prior:
        """Of the parameters with a tolerance.

        Raises:
            GapError: the covariance is not positive definite.
        """
        free = [k for k, p in enumerate(simulator.parameters) if p.tolerance > 0.0]
        chosen = [simulator.parameters[k] for k in free]
        names = tuple(p.name for p in chosen)
        nominal = np.array([p.nominal for p in chosen], dtype=np.float64)
        sd = np.array([p.tolerance for p in chosen], dtype=np.float64)
        cover = simulator.covariance
        if cover is None or not free:
            return cls(names, nominal, np.diag(sd))
        # The covariance of a fit takes its residuals for independent. Where the form errs, points
        # that lie close share an error.
        own = np.asarray(cover, dtype=np.float64)[np.ix_(free, free)]
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        try:
            root = (
                _shared_error(simulator)
                * scale[:, None]
                * np.linalg.cholesky(own / scale / scale[:, None])
            )
        except np.linalg.LinAlgError as exc:
            raise GapError(simulator.origin, "the covariance is not positive definite") from exc
        return cls(names, nominal, root)

    def values(self, z: Array) -> dict[str, float]:
        """Parameters at `z` sd."""
        return dict(zip(self.names, (self.nominal + self.root @ z).tolist(), strict=True))


def _shared_error(simulator: ExternalSimulator) -> float:
    """How many times a fit's own sd its parameters may be off by, for the error of its form."""
    error, noise = simulator.model_error_n, simulator.noise_n
    if error <= 0.0:
        return 1.0
    return float(np.sqrt(1.0 + (_POINTS_ALIKE - 1.0) * error**2 / (error**2 + noise**2)))


_POINTS_ALIKE = 10.0
"""Points of a map that share one error of the form: of 80 to 200 points over about ten areas of
the size `_REACH`. A matter of definition."""


@dataclass(frozen=True)
class ModelError:
    """Error of a law's form: the largest terms of a Gaussian process over pressure and length.

    Attributes:
        nodes: pressures and lengths in units of `reach`, shape (nodes, 2).
        weight: from correlations with the nodes to terms, shape (nodes, terms), in N.
        reach: correlation length in Pa and m, shape (2,).
    """

    nodes: Array
    weight: Array
    reach: Array

    @classmethod
    def over(cls, pressure: Array, length: Array, sd_n: float) -> ModelError:
        """Of size `sd_n` over the measured range of pressure (Pa) and length (m)."""
        spans = []
        for values, least in zip((pressure, length), _LEAST_RANGE, strict=True):
            low, high = float(np.min(values)), float(np.max(values))
            middle, half = 0.5 * (low + high), 0.5 * max(high - low, least)
            spans.append((middle - half, middle + half))
        reach = np.array([_REACH * (high - low) for low, high in spans])
        grid = np.meshgrid(*(np.linspace(low, high, _NODES) for low, high in spans))
        nodes = np.stack([g.ravel() for g in grid], axis=1) / reach
        size, vectors = np.linalg.eigh(_correlation(nodes, nodes))
        order = np.argsort(-size)
        size, vectors = size[order], vectors[:, order]
        share = np.cumsum(size) / size.sum()
        count = min(int(np.searchsorted(share, _KEPT)) + 1, _MOST_TERMS)
        return cls(nodes, sd_n * vectors[:, :count] / np.sqrt(size[:count]), reach)

    @property
    def count(self) -> int:
        """Number of terms."""
        return int(self.weight.shape[1])

    def terms(self, pressure: Array, length: Array) -> Array:
        """Force in N of each term at one sd, shape (points, terms)."""
        at = np.stack([pressure, length], axis=1) / self.reach
        return np.asarray(_correlation(at, self.nodes) @ self.weight)


def _correlation(one: Array, other: Array) -> Array:
    square = ((one[:, None, :] - other[None, :, :]) ** 2).sum(axis=2)
    coarse, fine = np.exp(-0.5 * square), np.exp(-0.5 * square / _FINE**2)
    return np.asarray((1.0 - _FINE_SHARE) * coarse + _FINE_SHARE * fine)


class NominalPlant:
    """A simulator from elsewhere on the points of one data set.

    Args:
        simulator: takes the place of the built-in stages that it names.
        data: the trials that it is run on.
        points: of every block.
        around: parameters in sd at which a simulator with memory is run and made linear.
        error: of the law's form, where it was set up on other data; by default on these.

    Attributes:
        names: entries that it adds to a fit: parameters, then terms of the law's error.

    Raises:
        GapError: the simulator gives no prediction where the data have a measurement.
    """

    def __init__(
        self,
        simulator: ExternalSimulator,
        data: DataSet,
        points: Mapping[str, Points],
        around: Array | None = None,
        error: ModelError | None = None,
    ) -> None:
        self.simulator = simulator
        self.prior = Prior.of(simulator)
        self._stages = {stage.name for stage in simulator.stages}
        self._points = points
        there = [points[b] for b in ("force", "load") if b in points and self.covers(b)]
        self.error = error
        if error is None and simulator.model_error_n > 0.0 and there:
            self.error = ModelError.over(
                np.concatenate([p.pressure for p in there]),
                np.concatenate([p.length for p in there]),
                simulator.model_error_n,
            )
        terms = self.error.count if self.error is not None else 0
        self.names = tuple(f"simulator {name}" for name in self.prior.names) + tuple(
            f"model error {number + 1}" for number in range(terms)
        )
        self.around = np.zeros(len(self.prior.names)) if around is None else around
        self._error_terms = {
            block: self.error.terms(points[block].pressure, points[block].length)
            for block in ("force", "load")
            if self.error is not None and block in points
        }
        self._beyond: dict[str, tuple[bytes, Array]] = {}
        self._run = {} if self.static else self._linearised(data)
        self._start = self._of_start(data) if "pressure" in self._run else None

    @property
    def errs(self) -> bool:
        """Whether the form of its force is known to be off."""
        return self.error is not None or rough_error_n(self.simulator) > 0.0

    @property
    def static(self) -> bool:
        """Whether its force is a function of pressure and length alone."""
        return isinstance(self.simulator, StaticForce)

    def covers(self, block: str) -> bool:
        """Whether it stands for the built-in stage that predicts a block."""
        return _BLOCKS.get(block) in self._stages

    def shift(self, active: Active) -> Array:
        """How far its entries are moved, in sd, by what is in force; shape (entries,)."""
        moved = np.zeros(len(self.names))
        for name, _, amount, shape in active:
            if name == NOMINAL:
                moved[int(shape["number"])] = amount
        return moved

    def law(self, shift: Array) -> ForceLaw | None:
        """Its force law at given parameters; None where it has memory or no force stage."""
        simulator = self.simulator
        if not isinstance(simulator, StaticForce):
            return None
        values = self.prior.values(shift[: len(self.prior.names)])

        def pull(pressure: Array, length: Array) -> Array:
            return np.asarray(simulator.force_n(pressure * 1e-3, length * 1e3, values))

        return pull

    def beyond(self, block: str, shift: Array) -> Array | None:
        """Error of the law's form at the points of a block, N; None where it has none."""
        terms = self._error_terms.get(block)
        if terms is None:
            return None
        own = shift[len(self.prior.names) :]
        key = own.tobytes()
        kept = self._beyond.get(block)
        if kept is None or kept[0] != key:  # most predictions move something else
            kept = self._beyond[block] = (key, np.asarray(terms @ own))
        return kept[1]

    def error_terms(self, block: str) -> Array | None:
        """What one sd of each term of the law's error adds at the points of a block, N.

        Shape (points, terms); None where it has none.
        """
        return self._error_terms.get(block)

    def predicted(self, block: str, shift: Array) -> Array | None:
        """Prediction of a simulator with memory at the points of a block: Pa or N.

        None where the simulator has no such stage or no memory.
        """
        run = self._run.get(block)
        if run is None:
            return None
        base, slope = run
        return np.asarray(base + slope @ (shift[: len(self.prior.names)] - self.around))

    def pressure_from(self, shift: Array, zero_pa: float, gain: float) -> Array:
        """Predicted pressure at its points, Pa, started where a gauge of such an error really was.

        Args:
            gain: of the gauge, beyond one.
        """
        made = self.predicted("pressure", shift)
        assert made is not None
        assert self._start is not None
        read, slope = self._start
        return made + slope * ((read - zero_pa) / (1.0 + gain) - read)

    def _of_start(self, data: DataSet) -> tuple[Array, Array]:
        """First reading in Pa and slope of the prediction over it, at the points of the pressure.

        A simulator may take its first pressure from the data; how soon it forgets is its own.
        """
        points = self._points["pressure"]
        read = np.zeros(len(points.reading))
        for number, trial in enumerate(data.trials):
            here = slice(*points.first[number : number + 2].tolist())
            if here.stop > here.start:
                read[here] = trial["pressure_kpa"].value[0] * 1e3
        high, low = (
            self._simulated(_started(data, kpa), ["pressure"], self.around)["pressure"]
            for kpa in (_START_KPA, -_START_KPA)
        )
        return read, (high - low) / (2e3 * _START_KPA)

    def _linearised(self, data: DataSet) -> dict[str, tuple[Array, Array]]:
        """Prediction at the points of each block and its slope over each parameter, 1/sd."""
        blocks = [block for block in _BLOCKS if block in self._points and self.covers(block)]
        base = self._simulated(data, blocks, self.around)
        slopes: dict[str, list[Array]] = {block: [] for block in blocks}
        for number in range(len(self.prior.names)):
            step = np.zeros(len(self.around))
            step[number] = _STEP
            high = self._simulated(data, blocks, self.around + step)
            low = self._simulated(data, blocks, self.around - step)
            for block in blocks:
                slopes[block].append((high[block] - low[block]) / (2.0 * _STEP))
        empty = {block: np.zeros((len(base[block]), 0)) for block in blocks}
        return {
            block: (base[block], np.stack(made, axis=1) if made else empty[block])
            for block, made in slopes.items()
        }

    def _simulated(self, data: DataSet, blocks: list[str], z: Array) -> dict[str, Array]:
        values = self.prior.values(z)
        made = {block: np.empty(len(self._points[block].reading)) for block in blocks}
        for number, trial in enumerate(data.trials):
            parts = [
                (block, slice(*self._points[block].first[number : number + 2].tolist()))
                for block in blocks
            ]
            if all(part.stop == part.start for _, part in parts):
                continue
            channels = self.simulator.simulate(trial, values)
            for block, part in parts:
                if part.stop > part.start:
                    times = self._points[block].time_s[part]
                    scale = 1e3 if block == "pressure" else 1.0
                    made[block][part] = scale * self._at(trial, _BLOCKS[block], channels, times)
        return made

    def _at(
        self, trial: Trial, stage: str, channels: Mapping[str, Channel], time_s: Array
    ) -> Array:
        where = f"{self.simulator.origin}, trial {trial.name}"
        channel = channels.get(stage)
        if channel is None or not len(channel):
            raise GapError(where, f"the simulator gave no prediction of its {stage} stage")
        value = np.interp(time_s, channel.time_s, channel.value)
        slack = 1e-6 + 1.5 * float(np.median(np.diff(channel.time_s))) if len(channel) > 1 else 1e-6
        outside = (time_s < channel.time_s[0] - slack) | (time_s > channel.time_s[-1] + slack)
        wrong = np.flatnonzero(outside | ~np.isfinite(value))
        if len(wrong):
            at = float(time_s[wrong[0]])
            raise GapError(
                where, f"the {stage} stage has no prediction at {at:g} s, where the data have one"
            )
        return value


_START_KPA = 5.0


def _started(data: DataSet, kpa: float) -> DataSet:
    """The same trials with the first reading of the pressure off by so much."""
    trials = []
    for trial in data.trials:
        channel = trial.get("pressure_kpa")
        if len(channel):
            value = channel.value.copy()
            value[0] += kpa
            read = {"pressure_kpa": replace(channel, value=value)}
            trial = replace(trial, channels={**trial.channels, **read})
        trials.append(trial)
    return replace(data, trials=tuple(trials))


def nominal_law(data: DataSet) -> ForceLaw | None:
    """Force law of a data set's simulator as stated; None where the built-in law holds."""
    simulator = data.simulator
    if simulator is None or not isinstance(simulator, StaticForce):
        return None
    stated = {p.name: p.nominal for p in simulator.parameters}
    return lambda pressure, length: np.asarray(
        simulator.force_n(pressure * 1e-3, length * 1e3, stated)
    )
