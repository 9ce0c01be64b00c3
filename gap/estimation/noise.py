"""The noise of a data set, learnt from what replicates of a slot do not share.

Rows of one trial vary together: sensor zeros and gains drawn per trial, slow drifts, white noise.
Each kind has a variance, started from the nominal one and moved towards what differences between
replicates show (expectation-maximisation); nothing is learnt from the residual itself, which holds
the gap that is being looked for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import CANDIDATES
from gap.estimation.config import ESTIMATION
from gap.model.features import BLOCKS, Rows
from gap.model.grid import FIRST_SETTLED, same_conditions
from gap.model.residuals import Model
from gap.model.sensitivities import (
    UNSEEN_GAS,
    TrialEffect,
    candidate_columns,
    slow_columns,
    trial_columns,
)
from plant.arrays import Array
from plant.constants import PlantConstants

Whole = npt.NDArray[np.int64]

_ROUNDS = 12
_SEEN_SHARE = 0.25
"""Mean square of what replicates differ by, over what zeros and gains say, from which these are too
large. A matter of definition."""
_LEAST_OF_USUAL = 0.3
"""Share of its usual size that a sensor's zero or gain keeps then. Not tuned."""
_OF_SENSORS = ("zero", "gain")
"""How the kinds of noise end that are zeros and gains of sensors."""
SLOW_START = {"pressure": 0.05, "force": 0.08, "load": 0.05, "camera": 0.0}
WHITE = {"pressure": 0.5, "force": 0.05, "load": 0.06, "camera": 0.01}


@dataclass
class Noise:
    """Noise of all rows: white variances, and per trial a few columns with their variances.

    Attributes:
        white: variance of each row, shape (rows,).
        scales: one standard deviation of each kind of trial effect and slow wave.
        pairs: number of replicate pairs the scales were learnt from.
        freedom: replicates beyond the first, over all slots.
        trend: slow change over trials that replicates show, one entry a row, not part of noise.
    """

    white: Array
    trial_rows: list[Whole]
    columns: list[Array]
    kinds: list[list[str]]
    scales: dict[str, float]
    pairs: int
    freedom: int
    trend: Array | None = None
    _factors: dict[int, tuple[Array, Array, Array]] = field(default_factory=dict)

    def solve(self, trial: int, a: Array) -> tuple[Array, Array]:
        """Inner products aᵀ Σ⁻¹ a for the rows of one trial, and a in units of noise."""
        whitened = self.whiten(trial, a)
        return whitened.T @ whitened, whitened

    def variance(self) -> Array:
        """Variance of every row, all kinds of noise together."""
        made = self.white.copy()
        for trial, rows in enumerate(self.trial_rows):
            v = np.array([self.scales[kind] ** 2 for kind in self.kinds[trial]])
            made[rows] += (self.columns[trial] ** 2) @ v
        return made

    def take_trials(self, model: Model, effects: list[TrialEffect], shared: Array) -> list[str]:
        """Take in rows and columns of all trials; returns the kinds of slow waves among them.

        `shared` are the columns of the trial effects, shape (rows, effects).
        """
        waves: list[str] = []
        for trial in range(len(model.grid.data.trials)):
            at = np.flatnonzero(model.grid.rows.trial == trial)
            slow, groups = slow_columns(model, at)
            self.trial_rows.append(at)
            self.columns.append(np.hstack([shared[at], slow]))
            self.kinds.append([effect.kind for effect in effects] + groups)
            waves += groups
        return list(dict.fromkeys(waves))

    def whiten(self, trial: int, a: Array) -> Array:
        """Rows of one trial in units of noise: white, of variance one, shape of `a`.

        With Σ = D^½ (1 + Q diag(λ) Qᵀ) D^½ the whitener is (1 + Q diag((1 + λ)^-½ - 1) Qᵀ) D^-½.
        """
        if trial not in self._factors:
            rows = self.trial_rows[trial]
            root = 1.0 / np.sqrt(self.white[rows])
            b = self.columns[trial]
            v = np.array([self.scales[kind] for kind in self.kinds[trial]])
            left, size, _ = np.linalg.svd(b * root[:, None] * v[None, :], full_matrices=False)
            self._factors[trial] = (root, left, 1.0 / np.sqrt(1.0 + size**2) - 1.0)
        root, left, shrink = self._factors[trial]
        scaled = a * root[:, None]
        return np.asarray(scaled + left @ (shrink[:, None] * (left.T @ scaled)))


def learn_noise(model: Model, c: PlantConstants, residual: Array) -> Noise:
    """Noise of a data set from the replicates' differences of `residual`, shape (rows,)."""
    rows = model.grid.rows
    data = model.grid.data
    noise = usual_noise(model, c, residual)
    prior = dict(noise.scales)
    classes = _classes(model)
    clear = rows.doubt**2 + rows.adrift**2 < 0.3 * noise.white
    alike = same_conditions(data)
    pairs = _pairs(model, noise, alike, classes, clear, residual)
    if not pairs:
        # Motion between frames leaves doubt in nearly every row: that is in the scatter too.
        pairs = _pairs(model, noise, alike, classes, np.ones(len(rows), dtype=bool), residual)
    noise.pairs = len(pairs)
    noise.freedom = sum(len(members) - 1 for members in data.slots.values())
    if pairs:
        start = noise.white.copy()
        usual_z, usual_trend = _trend(model, c, noise, pairs)
        _learn(noise, pairs, prior, classes, not data.settled)
        z, trend = _trend(model, c, noise, pairs)
        if _left(pairs, usual_trend) < _MUCH_LESS * min(_left(pairs, trend), _left(pairs)):
            # Gains that have taken a large change for noise let pass hardly anything of it: the
            # noise as it usually is shows it. Whether it is one, the noise without it tells.
            z, trend = min(usual_z, ESTIMATION.trend_sd), usual_trend
        if z > ESTIMATION.trend_requested:
            # Replicates far apart share no slow change: what they differ by through it is not
            # noise, or wear would raise the very floor it has to rise above.
            before = noise.white, noise.scales
            noise.white = start
            for pair in pairs:
                pair.take_out(trend)
            _learn(noise, pairs, prior, classes, not data.settled)
            height = _height(noise, pairs, trend)
            if z > ESTIMATION.trend_sd or height > ESTIMATION.trend_sd_without:
                noise.trend = trend
            else:
                noise.white, noise.scales = before
    noise.white += rows.doubt**2 + rows.floor**2
    return noise


def _pairs(
    model: Model, noise: Noise, alike: Array, classes: Whole, clear: npt.NDArray[np.bool_],
    residual: Array,
) -> list[_Pair]:  # fmt: skip
    """Replicates with enough clear rows in common to tell their scatter."""
    rows = model.grid.rows
    made = (_Pair(noise, rows, alike, classes, clear, a, b, residual) for a, b in _couples(model))
    return [pair for pair in made if len(pair.d) > 3]


def usual_noise(model: Model, c: PlantConstants, residual: Array) -> Noise:
    """Noise of the nominal plant, before replicates are used; doubt and floor are not in it."""
    effects, shared = trial_columns(model, c)
    noise = Noise(_start_white(model, residual), [], [], [], {}, 0, 0)
    scales: dict[str, float] = {effect.kind: effect.sd for effect in effects}
    for group in noise.take_trials(model, effects, shared):
        scales[group] = usual(group)
    _settled_prior(model, scales, effects)
    noise.scales = scales
    return noise


def usual(group: str) -> float:
    """Size that a slow wave has until replicates tell; unseen gas has the size it may have."""
    return 1.0 if group == UNSEEN_GAS else SLOW_START[group.split()[1]]


def _settled_prior(model: Model, prior: dict[str, float], effects: list[TrialEffect]) -> None:
    """Settled points of a bench set by hand: lengths to 0.1 mm, pressures to a few kPa."""
    if model.grid.data.settled:
        for kind, sd in (("held length", 0.1), ("length zero", 0.05), ("pressure zero", 1.0)):
            if kind in prior:
                prior[kind] = sd


def _couples(model: Model) -> list[tuple[int, int]]:
    """Pairs of replicates, each with the one before it, closing the ring from three on."""
    couples: list[tuple[int, int]] = []
    for members in model.grid.data.slots.values():
        couples += pairwise(members)
        if len(members) > 2:
            couples.append((members[0], members[-1]))
    return couples


def _start_white(model: Model, residual: Array) -> Array:
    """White variance of each row before learning, from the roughness of each block's points."""
    rows = model.grid.rows
    white = np.ones(len(rows))
    simulator = model.grid.data.simulator
    for number, block in enumerate(BLOCKS):
        here = rows.block == number
        if not here.any():
            continue
        settled = model.grid.data.settled
        sd = _roughness(residual[here], rows, here) if settled else WHITE[block]
        if settled and simulator is not None and block in ("force", "load"):
            sd = max(sd, simulator.noise_n)
        samples = 1.0 if settled else rows.samples[here]
        white[here] = np.maximum(sd, 0.3 * WHITE[block]) ** 2 / samples
    return white


def _classes(model: Model) -> Whole:
    """Rows whose white noise is learnt together: same block, like number of samples."""
    rows = model.grid.rows
    octave = np.searchsorted([1.5, 4.5, 15.5, 50.5], rows.samples)
    return np.asarray(rows.block * 8 + octave)


def _roughness(residual: Array, rows: Rows, here: npt.NDArray[np.bool_]) -> float:
    """Spread of second differences along each table, as one sd of white noise."""
    trial = rows.trial[here]
    inputs = (rows.pressure[here], rows.length[here])
    spans = [max(float(np.ptp(x)), 1e-12) for x in inputs]
    bends: list[Array] = []
    for t in np.unique(trial):
        at = np.flatnonzero(trial == t)
        if len(at) < 4:
            continue
        # Along what varies in this table: pressure at a held length, length at a held pressure.
        along = max(range(2), key=lambda k: float(np.ptp(inputs[k][at])) / spans[k])
        x = inputs[along]
        order = at[np.argsort(x[at], kind="stable")]
        p = x[order]
        y = residual[order]
        share = (p[1:-1] - p[:-2]) / np.maximum(p[2:] - p[:-2], 1e-9)
        bend = y[1:-1] - (1.0 - share) * y[:-2] - share * y[2:]
        bends.append(bend / np.sqrt(1.0 + (1.0 - share) ** 2 + share**2))
    if not bends:
        return 0.0
    return 1.4826 * float(np.median(np.abs(np.concatenate(bends))))


def at_equal_inputs(rows: Rows, one: Whole, other: Whole, alike: Array) -> npt.NDArray[np.bool_]:
    """Whether rows of forces and loads were taken at equal conditions; True for other rows.

    A force is that at a held length. Where a load comes to rest at the same pressure differs by its
    scatter alone; on its way there it may be anywhere.

    Args:
        one, other: rows that are compared, of equal blocks.
        alike: `gap.model.grid.same_conditions`.
    """
    pressure = np.abs(rows.pressure[one] - rows.pressure[other])
    length = np.abs(rows.length[one] - rows.length[other])
    held, hung = (rows.block[one] == BLOCKS.index(name) for name in ("force", "load"))
    rests = hung & (rows.bin[one] >= FIRST_SETTLED)
    return np.asarray((~held & ~hung) | ((pressure <= alike[0]) & (rests | (length <= alike[1]))))


class _Pair:
    """Difference of two replicates over the bins both have, reduced to small matrices."""

    def __init__(
        self,
        noise: Noise,
        rows: Rows,
        alike: Array,
        classes: Whole,
        clear: npt.NDArray[np.bool_],
        a: int,
        b: int,
        residual: Array,
    ) -> None:
        rows_a, rows_b = noise.trial_rows[a], noise.trial_rows[b]
        key_a = rows.block[rows_a] * 1_000_000 + rows.bin[rows_a]
        key_b = rows.block[rows_b] * 1_000_000 + rows.bin[rows_b]
        _, ia, ib = np.intersect1d(key_a, key_b, return_indices=True)
        both = clear[rows_a[ia]] & clear[rows_b[ib]]
        # Forces at different pressures differ for that reason alone.
        both &= at_equal_inputs(rows, rows_a[ia], rows_b[ib], alike)
        ia, ib = ia[both], ib[both]
        self.block = classes[rows_a[ia]]
        self.d = residual[rows_a[ia]] - residual[rows_b[ib]]
        same = noise.kinds[a] == noise.kinds[b]
        left, right = noise.columns[a][ia], noise.columns[b][ib]
        if same:
            # Alike columns: the difference of the two trial effects has twice the variance.
            self.b = 0.5 * (left + right)
            self.kinds = noise.kinds[a]
            self.double = 2.0
        else:
            self.b = np.hstack([left, -right])
            self.kinds = noise.kinds[a] + noise.kinds[b]
            self.double = 1.0
        self.white = noise.white[rows_a[ia]] + noise.white[rows_b[ib]]
        self.rows = (rows_a[ia], rows_b[ib])
        self._weigh()

    def _weigh(self) -> None:
        self.gram: dict[int, Array] = {}
        self.project: dict[int, Array] = {}
        for number in np.unique(self.block).astype(int).tolist():
            here = self.block == number
            weighted = self.b[here] / self.white[here][:, None]
            self.gram[number] = self.b[here].T @ weighted
            self.project[number] = weighted.T @ self.d[here]

    def take_out(self, trend: Array) -> None:
        """Subtract what a slow trend makes of the difference, `trend` with one entry a row."""
        self.d = self.d - (trend[self.rows[0]] - trend[self.rows[1]])
        self._weigh()

    def products(self, noise: Noise, column: Array) -> tuple[float, float]:
        """Inner products of a column's difference with the pair's and with itself."""
        w = column[self.rows[0]] - column[self.rows[1]]
        white = noise.white[self.rows[0]] + noise.white[self.rows[1]]
        v = self.double * np.array([noise.scales[kind] ** 2 for kind in self.kinds])
        weighted = self.b / white[:, None]
        small = self.b.T @ weighted + np.diag(1.0 / np.maximum(v, 1e-14))
        both = np.stack([self.d, w], axis=1)
        solved = both / white[:, None] - weighted @ np.linalg.solve(small, weighted.T @ both)
        return float(w @ solved[:, 0]), float(w @ solved[:, 1])


def _trend(
    model: Model, c: PlantConstants, noise: Noise, pairs: list[_Pair]
) -> tuple[float, Array]:
    """The slow change over trials that replicates show best, one entry a row, and its z."""
    wear = [candidate for candidate in CANDIDATES if candidate.family == "drift"]
    columns = candidate_columns(model, c, [], wear)
    best = (0.0, np.zeros(len(columns)))
    for j in range(columns.shape[1]):
        products = np.array([pair.products(noise, columns[:, j]) for pair in pairs])
        across, self_product = products.sum(axis=0)
        if self_product <= 0.0:
            continue
        z = abs(float(across / np.sqrt(self_product)))
        if z > best[0]:
            best = (z, columns[:, j] * across / self_product)
    return best


_MUCH_LESS = 0.5
"""Share of what replicates differ by that is left without a large change over the trials. A matter
of definition."""


def _left(pairs: list[_Pair], trend: Array | None = None) -> float:
    """Squares of what replicates differ by, in units of white noise, with a trend taken out."""
    total = 0.0
    for pair in pairs:
        slow = 0.0 if trend is None else trend[pair.rows[0]] - trend[pair.rows[1]]
        total += float(np.sum((pair.d - slow) ** 2 / pair.white))
    return total


def _height(noise: Noise, pairs: list[_Pair], trend: Array) -> float:
    """Z of a trend that was taken out of the pairs, over the noise that is left."""
    products = np.array([pair.products(noise, trend) for pair in pairs])
    across, self_product = products.sum(axis=0)
    return float((across + self_product) / np.sqrt(max(self_product, 1e-300)))


def _learn(
    noise: Noise, pairs: list[_Pair], prior: dict[str, float], block: Whole, in_time: bool
) -> None:
    """Move variances towards the replicates' differences, a few rounds."""
    numbers = np.unique(block).astype(int).tolist()
    factor = dict.fromkeys(numbers, 1.0)
    # A wave of slow noise has its own size in every trial; a prior of a few draws steadies it.
    variance = {kind: sd**2 for kind, sd in prior.items()}
    for _ in range(_ROUNDS):
        total = dict.fromkeys(variance, 0.0)
        count = dict.fromkeys(variance, 0.0)
        spread = dict.fromkeys(numbers, 0.0)
        size = dict.fromkeys(numbers, 0.0)
        for pair in pairs:
            v = pair.double * np.array([variance[kind] for kind in pair.kinds])
            small = np.diag(1.0 / np.maximum(v, 1e-14))
            right = np.zeros(len(v))
            for number, gram in pair.gram.items():
                small = small + gram / factor[number]
                right = right + pair.project[number] / factor[number]
            cover = np.linalg.inv(small)
            u = cover @ right
            moment = (u**2 + np.diag(cover)) / pair.double
            for kind, m in zip(pair.kinds, moment, strict=True):
                total[kind] += m
                count[kind] += 1.0
            rest = pair.d - pair.b @ u
            for number, gram in pair.gram.items():
                here = pair.block == number
                # Half of it by the middle of the distribution: spikes are not white noise.
                z2 = rest[here] ** 2 / pair.white[here]
                n = float(here.sum())
                calm = float(np.mean(np.minimum(z2, 9.0 * max(np.median(z2) / 0.455, 1e-9))))
                spread[number] += n * calm + float(np.sum(cover * gram))
                size[number] += n
        for kind in variance:
            # Replicates bounce alike, so what they share does not show unobserved flow.
            if kind == UNSEEN_GAS:
                continue
            weight = ESTIMATION.prior_weight
            variance[kind] = (weight * prior[kind] ** 2 + total[kind]) / (weight + count[kind])
        for number in numbers:
            if size[number] > 0.0:
                factor[number] = (20.0 + spread[number]) / (20.0 + size[number])
    _as_in_nearest(factor, size)
    if in_time:
        _no_more_than_seen(pairs, variance, prior)
    noise.scales = {kind: float(np.sqrt(v)) for kind, v in variance.items()}
    for number in numbers:
        noise.white[block == number] *= factor[number]


def _as_in_nearest(factor: dict[int, float], size: dict[int, float]) -> None:
    """Give a class that no replicates share the factor of the nearest one of its block."""
    for number in factor:
        seen = [one for one in size if size[one] > 0.0 and one // 8 == number // 8]
        if size[number] == 0.0 and seen:
            factor[number] = factor[min(seen, key=lambda one: abs(one - number))]


def _no_more_than_seen(
    pairs: list[_Pair], variance: dict[str, float], prior: dict[str, float]
) -> None:
    """Reduce variances of zeros and gains by which replicates would differ far more than they do.

    A change of friction from one stroke to the next looks like zeros and gains of pressure and
    force that cancel in all else, and may be of any size then. Independent zeros and gains of that
    size would make differences many times larger than any that was seen. Tables of settled points
    hold no strokes: there the usual sizes are a hand's, and few replicates do not gainsay them.
    """
    seen = said = 0.0
    for pair in pairs:
        own = [k for k, kind in enumerate(pair.kinds) if kind.endswith(_OF_SENSORS)]
        v = pair.double * np.array([variance[pair.kinds[k]] for k in own])
        said += float(np.sum((pair.b[:, own] ** 2 @ v) / pair.white))
        seen += float(np.sum(pair.d**2 / pair.white))
    if seen < _SEEN_SHARE * said:
        for kind, usual_sd in prior.items():
            if kind.endswith(_OF_SENSORS):
                least = min(variance[kind], (_LEAST_OF_USUAL * usual_sd) ** 2)
                variance[kind] = max(variance[kind] * seen / said, least)
