"""A term and the constants are found together, and no piece goes that a term hangs on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

from gap.data.reader import read_dataset
from gap.estimation.fit_problem import FitProblem
from gap.validation.config import VALIDATION
from gap.validation.empirical import _refitted
from gap.validation.terms.pieces import NO_FLOWS, Piece
from gap.validation.terms.search import TermSearch, search_of
from gap_bench import write_set
from plant.effects.empirical import FLOW, INLET_FLOW

Array = npt.NDArray[np.float64]


def test_a_term_brings_back_constants_that_a_gap_had_led_astray(tmp_path: Path) -> None:
    """A leak that may not be named moves constants by 30 sd; with a flow they stay as stated."""
    folder = write_set(tmp_path / "data", {"leak": {"conductance_m3_s_pa": 4e-13}})
    problem = FitProblem.of(read_dataset(folder))
    nothing = np.zeros_like(problem.base.shift)
    stated = problem.at(nothing, (), np.empty(0), problem.base)
    search = search_of(problem, stated, "pressure", VALIDATION)
    assert search is not None
    (piece,) = [p for p in search.pieces if p.inputs == ("pressure_kpa",) and p.scale == FLOW]
    _, found = _refitted(problem, search, [piece])
    assert found.cost < 0.01 * problem.base.cost
    assert np.abs(found.fit.shift).max() < 0.1 * np.abs(problem.base.shift).max()
    # What the fit holds is the gap that the term is to describe, not what the term leaves.
    plain = problem.residual_at(found.fit.shift, (), np.empty(0))
    assert found.fit.residual == pytest.approx(plain)
    assert problem.whitened(found.left) < 0.5 * problem.whitened(plain)


def test_a_search_around_a_term_takes_what_it_does_as_it_is_there(tmp_path: Path) -> None:
    """Gas takes in no flow in proportion: around the term it leaves what was simulated with it."""
    folder = write_set(tmp_path / "data", {"flow_area": {"ratio": 0.7, "side": "inlet"}})
    problem = FitProblem.of(read_dataset(folder))
    search = search_of(problem, problem.base, "pressure", VALIDATION)
    assert search is not None
    (piece,) = [p for p in search.pieces if not p.inputs and p.scale == INLET_FLOW]
    own, found = _refitted(problem, search, [piece])
    again = search_of(problem, found.fit, "pressure", VALIDATION, search, (own, found))
    assert again is not None
    # The gap is that of the recalibrated plant still.
    assert again.errors([]) == pytest.approx(search.errors([]))
    coefficient = again.terms.coefficients(piece.at)
    assert coefficient == pytest.approx(found.beta, rel=0.1)


class Told(TermSearch):
    """A search whose errors are written down, by the scales of the pieces in force."""

    table: dict[frozenset[str], Array]

    def errors(self, chosen: Sequence[Piece], without: frozenset[int] = frozenset()) -> Array:
        return self.table[frozenset(one.scale for one in chosen)]


def told(table: dict[str, list[float]], gap: float) -> tuple[Told, dict[str, Piece]]:
    names = sorted({name for key in table for name in key.split()})
    pieces = {
        name: Piece((), (), name, np.array([k]), np.zeros((1, 1))) for k, name in enumerate(names)
    }
    nothing = cast(Any, None)
    search = Told(
        "force",
        nothing,
        tuple(pieces.values()),
        np.zeros((1, 2)),
        NO_FLOWS,
        cast(Any, SimpleNamespace(slots=(0, 1, 2))),
        nothing,
        np.full(3, gap / 3.0),
        np.full(3, 2.0),
        VALIDATION,
    )
    search.table = {frozenset(key.split()): np.array(x) for key, x in table.items()}
    return search, pieces


def test_a_piece_on_which_most_of_what_is_closed_hangs_is_kept_in_one_slot_as_well() -> None:
    """Without `a` the large slot is lost, the others gain a little: not sure, but much."""
    search, pieces = told(
        {"": [100.0, 4.0, 4.0], "a": [9.0, 4.0, 4.0], "b": [100.0, 1.0, 1.0],
         "a b": [4.0, 2.0, 2.0]}, 100.0,
    )  # fmt: skip
    kept = search._needed([pieces["a"], pieces["b"]], frozenset())
    assert pieces["a"] in kept


def test_a_piece_that_gives_little_and_not_for_sure_goes() -> None:
    search, pieces = told(
        {"": [100.0, 40.0, 40.0], "a": [9.0, 4.0, 4.0], "b": [100.0, 40.0, 40.0],
         "a b": [4.0, 4.2, 4.2]}, 100.0,
    )  # fmt: skip
    assert search._needed([pieces["a"], pieces["b"]], frozenset()) == [pieces["a"]]


def test_of_pieces_that_do_as_well_the_one_with_few_knots_enters() -> None:
    """Many knots do a little better on most slots, and stray where one has another range."""
    knots = (tuple(np.linspace(50.0, 70.0, 6)), tuple(np.linspace(50.0, 70.0, 41)))
    few, many = (
        Piece(("length_mm",), (own,), scale, np.array([k]), np.zeros((1, 1)))
        for k, (own, scale) in enumerate(zip(knots, ("few", "many"), strict=True))
    )
    assert many.fine
    assert not few.fine
    search, _ = told(
        {"": [100.0, 90.0, 95.0], "few": [10.0, 11.0, 12.0], "many": [9.0, 10.0, 11.0]}, 250.0
    )
    search.pieces = (few, many)
    search.terms = cast(
        Any, SimpleNamespace(slots=(0, 1, 2), explained=lambda columns, without: 1.0)
    )
    found = search._next([], search.errors([]), frozenset())
    assert found is not None
    assert found[0] is few
