"""What else could look like an effect on this very data: the mimic index."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.columns import suspect_columns
from gap.evidence import gather, projected
from gap.inquiry import Inquiry, State

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Mimic:
    """Other effects that together take `share` of an effect's signature on the present data."""

    ids: tuple[str, ...]
    share: float


@dataclass(frozen=True)
class Mimicked:
    """Best single and pair that could stand in for an explanation.

    `member_one` and `member_two` are the largest shares that a single and a pair take of one of
    its effects alone; `apart` says that its effects show in different channels.
    """

    one: Mimic | None
    two: Mimic | None
    member_one: float
    member_two: float
    apart: bool


class Mimicry:
    """How well suspects stand in for each other on one data set, constants recalibrated."""

    def __init__(self, q: Inquiry) -> None:
        self.q = q
        c = q.constants(q.base.shift)
        self._columns = np.nan_to_num(
            suspect_columns(q.model, c, q.found(q.base.shift, (), np.empty(0)), q.suspects)
        )

    def of(self, signature: Array, excluded: frozenset[str]) -> tuple[Mimic | None, Mimic | None]:
        """Best single and best pair of other ids for a signature, shape (rows,).

        `excluded` are ids that may not stand in; defects of the recording never do.
        """
        q = self.q
        evidence = gather(
            q.noise, q.columns, signature, self._columns, q.rows.block, q.rows.span_s, q.units,
            np.zeros(len(q.names)),
        )  # fmt: skip
        p = projected(evidence, evidence.total)
        whole = float(p[0, 0])
        if whole <= 1e-9:
            return None, None
        b = p[0, 1:]
        g = p[1:, 1:]
        norm = np.maximum(np.diag(g), 1e-12)
        signs = np.array([s.sign for s in q.suspects])
        usable = np.array([s.id not in excluded and not s.defect for s in q.suspects])
        usable &= np.diag(g) > 1e-9 * whole * 1e-3
        single = np.where(usable & ((signs == 0) | (b > 0.0)), b**2 / norm, 0.0)
        best = int(np.argmax(single))
        one = (
            Mimic((q.suspects[best].id,), float(single[best] / whole)) if single[best] > 0 else None
        )
        return one, self._pair(b, g, norm, signs, usable, whole)

    def of_state(self, state: State) -> Mimicked:
        """What could look like a fitted explanation, whole and effect by effect."""
        q = self.q
        ids = frozenset(state.ids)
        one, two = self.of(q.base.residual - state.residual, ids)
        if len(ids) < 2:
            return Mimicked(one, two, one.share if one else 0.0, two.share if two else 0.0, True)
        singles, pairs = [0.0], [0.0]
        for name in state.ids:
            kept = [(s, a) for s, a in zip(state.suspects, state.amounts, strict=True)
                    if s.id != name]  # fmt: skip
            without = q.residual_at(
                state.shift, [s for s, _ in kept], np.array([float(a) for _, a in kept])
            )
            single, pair = self.of(without - state.residual, ids)
            singles.append(single.share if single else 0.0)
            pairs.append(pair.share if pair else 0.0)
        blocks = [
            {b for s in state.suspects if s.id == name for b in s.blocks} & set(q.grid.points)
            for name in state.ids
        ]
        apart = not any(a & b for k, a in enumerate(blocks) for b in blocks[:k])
        return Mimicked(one, two, max(singles), max(pairs), apart)

    def _pair(
        self, b: Array, g: Array, norm: Array, signs: Array, usable: npt.NDArray[np.bool_],
        whole: float,
    ) -> Mimic | None:  # fmt: skip
        det = norm[:, None] * norm[None, :] - g**2
        good = usable[:, None] & usable[None, :] & (det > 1e-6 * norm[:, None] * norm[None, :])
        safe = np.where(good, det, 1.0)
        first = (b[:, None] * norm[None, :] - g * b[None, :]) / safe
        second = (b[None, :] * norm[:, None] - g * b[:, None]) / safe
        good &= (signs[:, None] == 0) | (first > 0.0)
        good &= (signs[None, :] == 0) | (second > 0.0)
        ids = np.array([s.id for s in self.q.suspects])
        good &= ids[:, None] != ids[None, :]
        share = np.where(good, first * b[:, None] + second * b[None, :], 0.0)
        at = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[at] <= 0.0:
            return None
        pair = (str(ids[at[0]]), str(ids[at[1]]))
        return Mimic(pair, float(min(share[at] / whole, 1.0)))
