"""A valve whose delay is not the same at each stroke: what that leaves is no unknown effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import SUSPECTS
from gap.estimation.agreement import repeated
from gap.estimation.fit_problem import Inquiry
from gap.selection.forward import Naming
from gap.selection.inclusion import excess
from gap.selection.per_stroke import eased
from gap.selection.refine import Choice
from gap_bench import uneven, write_set

LATE_S = (5.4e-3, 4.4e-3, 4.8e-3, 5.6e-3, 4.6e-3, 5.2e-3, 4.5e-3, 5.5e-3)
"""Delays of a valve that is 5 ms late, a tenth of it more or less at each stroke."""


def late_outlet(folder: Path, opens_late_s: tuple[float, ...]) -> tuple[Inquiry, Naming]:
    data = read_dataset(write_set(folder, seed=3, replicates=2, opens_late_s=opens_late_s))
    q = Inquiry(data)
    suspect = next(s for s in SUSPECTS if s.key == "valve_delay:outlet_on")
    state = q.polish(q.fit([suspect], [5.0]))
    left = excess(q, state)
    return q, Naming(Choice((suspect.key,), state), [], {}, excess(q, q.base), left)


@pytest.fixture(scope="module")
def irregular(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inquiry, Naming]:
    return late_outlet(tmp_path_factory.mktemp("irregular") / "set", LATE_S)


def test_strokes_that_differ_leave_much_of_a_gap_and_next_to_nothing_once_they_may(
    irregular: tuple[Inquiry, Naming],
) -> None:
    q, naming = irregular
    better = eased(q, naming)
    assert naming.left > 0.05 * naming.excess
    assert better.left < 0.1 * naming.left
    assert better.chosen is naming.chosen
    assert repeated(q, better.remaining.residual) < 0.2 * repeated(q, naming.remaining.residual)


def test_constants_that_uneven_strokes_had_bent_come_back(
    irregular: tuple[Inquiry, Naming],
) -> None:
    q, naming = irregular
    before, after = naming.remaining.shift, eased(q, naming).remaining.shift
    assert np.abs(after).max() < np.abs(before).max()


def test_strokes_of_an_effect_that_is_no_delay_stay_as_they_are(
    irregular: tuple[Inquiry, Naming],
) -> None:
    q, _ = irregular
    suspect = next(s for s in SUSPECTS if s.id == "leak")
    state = q.fit([suspect], [suspect.step])
    naming = Naming(Choice(("leak",), state), [], {}, excess(q, q.base), excess(q, state))
    assert eased(q, naming) is naming
    assert naming.remaining is state


def test_a_delay_that_grows_a_millisecond_a_stroke_is_no_uneven_one(tmp_path: Path) -> None:
    """A coil that warms is late by more and more, far beyond a tenth."""
    q, naming = late_outlet(tmp_path / "set", tuple((2.0 + k) * 1e-3 for k in range(8)))
    assert eased(q, naming).left > 0.2 * naming.left


def test_the_bench_of_these_tests_opens_late_by_what_it_was_told() -> None:
    events = [(1.0, "outlet", 1.0), (1.1, "outlet", 0.0), (2.0, "outlet", 1.0)]
    assert uneven(events, (0.1, 0.2)) == [
        (1.1, "outlet", 1.0), (1.1, "outlet", 0.0), (2.2, "outlet", 1.0),
    ]  # fmt: skip
