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
from gap.validation.empirical import TermSearch, search_of
from gap.validation.terms.pieces import Piece
from gap.validation.terms.refit import fitted_with_term
from gap_bench import write_set
from plant.effects.empirical import FLOW

Array = npt.NDArray[np.float64]


def test_a_term_brings_back_constants_that_a_gap_had_led_astray(tmp_path: Path) -> None:
    """A leak that may not be named moves the valves' constants far; with a flow they return."""
    folder = write_set(tmp_path / "data", {"leak": {"conductance_m3_s_pa": 4e-13}})
    problem = FitProblem.of(read_dataset(folder))
    search = search_of(problem, problem.base, "pressure", VALIDATION)
    assert search is not None
    (piece,) = [p for p in search.pieces if p.inputs == ("pressure_kpa",) and p.scale == FLOW]
    columns = np.zeros((len(problem.rows), len(piece.at)))
    columns[problem.rows.block == 0] = search.basis[:, piece.at]
    penalty = search.terms.penalty[np.ix_(piece.at, piece.at)]
    found, cost = fitted_with_term(problem, problem.base, columns, penalty)
    assert cost < 0.5 * problem.base.cost
    assert np.abs(found.shift).max() < 0.7 * np.abs(problem.base.shift).max()
    # What the fit holds is the gap that the term is to describe, not what the term leaves.
    assert found.residual == pytest.approx(problem.residual_at(found.shift, (), np.empty(0)))


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
        nothing,
        nothing,
        gap,
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
    search.terms = cast(Any, SimpleNamespace(explained=lambda columns, without: 1.0))
    found = search._next([], search.errors([]), frozenset())
    assert found is not None
    assert found[0] is few
