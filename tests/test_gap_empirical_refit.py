"""A term and the constants are found together, and no piece goes that a term hangs on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import gap_bench
from gap.data.reader import read_dataset
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.reason import Cause, Reason
from gap.reporting.empirical import empirical_lines, empirical_sentences
from gap.validation.config import VALIDATION
from gap.validation.empirical import (
    _can_be_stated,
    _Found,
    _simplest,
    blocks_with_gap,
    empirical_term,
)
from gap.validation.improved_plant import improved_plant
from gap.validation.terms.pieces import NO_FLOWS, Piece, pieces_of
from gap.validation.terms.refit import within_walls
from gap.validation.terms.search import TermSearch, refitted, search_of
from gap.verdict import Status, Verdict
from gap_bench import fill_and_vent, staircase, write_set
from plant.effects.empirical import (
    FLOW,
    INLET_FLOW,
    SHORT_PULSES,
    Correction,
    Corrections,
    SplineTerm,
)

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
    _, found = refitted(problem, search, [piece])
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
    own, found = refitted(problem, search, [piece])
    again = search_of(problem, found.fit, "pressure", VALIDATION, search, (own, found))
    assert again is not None
    # The gap is that of the recalibrated plant still.
    assert again.errors([]) == pytest.approx(search.errors([]))
    coefficient = again.terms.coefficients(piece.at)
    assert coefficient == pytest.approx(found.beta, rel=0.1)


def test_what_constants_do_beyond_their_tolerance_is_part_of_the_gap(tmp_path: Path) -> None:
    """An inlet of 0.6 that may not be named: another conductance, 6 sd away, leaves no gap."""
    folder = write_set(tmp_path / "data", {"flow_area": {"ratio": 0.6, "side": "inlet"}})
    problem = FitProblem.of(read_dataset(folder))
    assert np.abs(problem.base.shift).max() > 6.0
    walled = within_walls(problem, problem.base)
    assert np.abs(walled.shift).max() <= 3.0
    assert walled.cost > 10.0 * problem.base.cost
    # Better than constants cut off at their walls, and than those that are stated.
    for at in (np.clip(problem.base.shift, -3.0, 3.0), np.zeros_like(problem.base.shift)):
        assert walled.cost < 0.5 * problem.cost_at(at, (), np.empty(0))
    search = search_of(problem, problem.base, "pressure", VALIDATION, walled=walled)
    assert search is not None
    assert search.gaps.sum() > 10.0 * search.floors.sum()
    term = empirical_term(problem, problem.base, block="pressure")
    assert term is not None
    assert term.closed > 0.9
    assert list(term.shares) == ["history"]


def test_constants_within_their_tolerance_stay_where_the_fit_has_them(tmp_path: Path) -> None:
    problem = FitProblem.of(read_dataset(write_set(tmp_path / "data", {})))
    assert np.abs(problem.base.shift).max() < 3.0
    assert within_walls(problem, problem.base) is problem.base


@pytest.mark.parametrize(
    ("effect", "channel"),
    [
        ({"polytropic": {"exponent": 1.3}}, "pressure"),
        ({"flow_area": {"ratio": 0.6, "side": "inlet"}}, "pressure"),
        ({"braid_friction": {"friction_n": 3.0}}, "force"),
    ],
)
def test_a_channel_that_another_one_has_led_astray_shows_no_gap_of_its_own(
    tmp_path: Path, effect: dict[str, Any], channel: str
) -> None:
    """An exponent of 1.3 in place of 1 leaves the larger gap in the force, by bent constants."""
    problem = FitProblem.of(read_dataset(write_set(tmp_path / "data", effect)))
    walled = within_walls(problem, problem.base)
    assert blocks_with_gap(problem, walled)[0] == channel
    # Both channels show a gap where the constants are those of both.
    excess = walled.residual**2 / problem.floor_variance - 1.0
    shown = {name: excess[problem.rows.block == k].sum() for k, name in enumerate(BLOCKS)}
    assert shown["force"] > 1000.0


def test_what_depends_on_fewer_inputs_is_taken_where_it_closes_about_as_much() -> None:
    """Searches at other constants may describe the same gap with one input more."""
    knots = ((0.0, 1.0),)
    one, other = (
        Piece((name,), knots, "", np.array([0, 1]), np.zeros((2, 2)))
        for name in ("length_mm", "pressure_kpa")
    )
    nothing = cast(Any, None)
    few = _Found(nothing, [one], nothing, 0.80)
    many = _Found(nothing, [one, other], nothing, 0.85)
    assert _simplest([many, few], 0.15) is few
    assert _simplest([many, few], 0.05) is many


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
        np.zeros((1, 2)),
        NO_FLOWS,
        cast(Any, SimpleNamespace(slots=(0, 1, 2))),
        nothing,
        np.full(3, gap / 3.0),
        np.full(3, 2.0),
        np.ones(3),
        VALIDATION,
    )
    search.table = {frozenset(key.split()): np.array(x) for key, x in table.items()}
    return search, pieces


def test_the_piece_that_the_constants_were_fitted_with_is_taken_where_it_is_the_best() -> None:
    """At those constants the others are fitted to first order only: to do as well says little."""
    search, pieces = told(
        {"": [100.0, 100.0, 100.0], "a": [5.0, 5.0, 5.0], "b": [4.0, 4.0, 4.0],
         "a b": [4.0, 4.0, 4.0]}, 300.0,
    )  # fmt: skip
    larger = replace(pieces["b"], at=np.array([1, 2]))
    search.pieces = (pieces["a"], larger)
    assert search.select()[0] is pieces["a"]
    search.known = frozenset({1, 2})
    assert search.select() == [larger]


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
    found = search._next([], search.errors([]), frozenset())
    assert found is not None
    assert found[0] is few


def test_of_pieces_that_do_as_well_the_rate_of_the_pressure_is_the_last() -> None:
    """A leak makes the pressure fall; how fast it falls describes the leak as well."""
    knots = ((0.0, 1.0),)
    rate, pressure = (
        Piece((name,), knots, scale, np.array([k]), np.zeros((1, 1)))
        for k, (name, scale) in enumerate(
            (("pressure_rate_kpa_s", "rate"), ("pressure_kpa", "pressure"))
        )
    )
    search, _ = told(
        {"": [100.0, 90.0, 95.0], "rate": [3.0, 3.0, 3.0], "pressure": [4.0, 3.0, 3.0]}, 250.0
    )
    search.pieces = (rate, pressure)
    found = search._next([], search.errors([]), frozenset())
    assert found is not None
    assert found[0] is pressure


def test_a_piece_that_closes_most_of_a_gap_enters_though_one_slot_holds_it() -> None:
    """Four slots of equal floors: no count of standard errors shows what happens in one of them."""
    search, pieces = told(
        {"": [400.0, 2.0, 2.0], "a": [20.0, 2.1, 2.1], "b": [390.0, 2.0, 2.0]}, 400.0
    )
    found = search._next([], search.errors([]), frozenset())
    assert found is not None
    assert found[0] is pieces["a"]


def test_the_last_of_many_pieces_enters_where_it_alone_closes_the_gap() -> None:
    """Coils that heat up were told by the 48th part: the others explained more where fitted."""
    names = [f"p{k:02d}" for k in range(60)]
    none: dict[str, list[float]] = {name: [100.0] * 3 for name in ("", *names)}
    search, pieces = told(none | {names[-1]: [3.0, 2.0, 2.5]}, 300.0)
    found = search._next([], search.errors([]), frozenset())
    assert found is not None
    assert found[0] is pieces[names[-1]]


@dataclass
class OfFit:
    """Errors of fits written down, by the number of the only column."""

    left: Sequence[float]
    slots: tuple[int, ...] = (0, 1, 2)

    def error_of_fit(self, slot: int, chosen: npt.NDArray[np.int64], left: object) -> float:
        return self.left[int(chosen[0])] if len(chosen) else 300.0


def test_what_one_slot_holds_is_told_by_the_fit_to_it_with_the_fewest_columns() -> None:
    """Whether it foretells the slot that is left out is not asked here."""
    search, _ = told({"": [100.0]}, 300.0)
    one, many, poor = (
        Piece((), (), scale, np.full(width, k), np.zeros((width, width)))
        for k, (scale, width) in enumerate((("one", 1), ("many", 3), ("poor", 1)))
    )
    search.pieces = (many, poor, one)
    search.gaps = np.array([290.0, 2.0, 5000.0])
    search.terms = cast(Any, OfFit([12.0, 3.0, 150.0]))
    search.recalibrated = search.terms
    assert search._of_one_slot(frozenset({2})) == [one]
    # With slot 0 left out, no slot holds nearly all of it.
    search.gaps = np.array([290.0, 200.0, 300.0])
    assert search._of_one_slot(frozenset({0})) == []


@dataclass
class LeftOut:
    """Errors of the recalibrated plant written down, with all slots and without one of them."""

    with_all: Sequence[float]
    without: Sequence[float]

    def errors(self, chosen: object, left: frozenset[int]) -> Array:
        return np.array(self.without if left else self.with_all)


def test_a_slot_tells_alone_of_a_gap_that_no_other_shows_without_it() -> None:
    """What the others show with it is what it has done to the constants."""
    search, _ = told({"": [100.0]}, 300.0)
    with_gap, none = [30.0, 900.0, 50.0], [0.5, 900.0, 0.4]
    for gaps, without, expected in (
        (with_gap, [2.5, 2.1], 1),
        (with_gap, [20.0, 40.0], None),  # the others have a gap by themselves
        (none, [2.0, 2.0], None),  # they have none with it either
    ):
        search.gaps = np.array(gaps)
        search.recalibrated = cast(Any, LeftOut(gaps, without))
        assert search.telling == expected


def test_few_numbers_are_taken_where_they_leave_next_to_nothing() -> None:
    """Six percent left were those of a valve that shuts late in place of a supply that surges."""
    search, _ = told({"": [100.0]}, 900.0)
    law, stand_in, many = (
        Piece((), (), scale, np.full(width, k), np.zeros((width, width)))
        for k, (scale, width) in enumerate((("law", 2), ("stand-in", 1), ("many", 9)))
    )
    search.pieces = (many, stand_in, law)
    search.terms = cast(Any, OfFit([4.0, 20.0, 2.0]))
    assert search.of_few_numbers() == [law]
    search.pieces = (many, stand_in)
    assert search.of_few_numbers() == []


def test_a_law_that_one_slot_tells_is_handed_out_with_what_it_foretells_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands too short for the valve pass all the same: one test has such commands."""
    steps = (("step", L, 0.0, "valve", fill_and_vent(), 4.5) for L in (56.0, 60.0, 64.0))
    bursts = ("square", 62.0, 0.0, "valve", staircase(0.006), 18.0)
    monkeypatch.setattr(gap_bench, "PLAN", (*steps, bursts))
    folder = write_set(tmp_path / "data", {"transport_delay": {}})
    problem = FitProblem.of(read_dataset(folder))
    term = empirical_term(problem, problem.base, block="pressure")
    assert term is not None
    assert term.told_by == "s3"
    assert [(one.scale, one.inputs) for one in term.correction.terms] == [(SHORT_PULSES, ())]
    assert term.correction.terms[0].coefficients[0] == pytest.approx(1.0, abs=0.02)
    assert term.shares == {"history": 1.0}
    assert term.closed > 0.9
    verdict = Verdict(Status.UNKNOWN, Reason(Cause.NO_GAP), "valve", (), 0.1, 0.9, empirical=term)
    for lines in (empirical_lines(verdict), empirical_sentences(verdict)):
        (line,) = [line for line in lines if "alone" in line]
        assert "s3" in line
    assert verdict.as_dict()["empirical"]["told_by"] == "s3"
    assert "# Slot s3 alone" in improved_plant(problem, problem.base, term)


def test_constants_that_no_bench_has_make_no_term_and_no_unreadable_plant(tmp_path: Path) -> None:
    """On practice set 45235 a term had led the atmosphere to 124 kPa; a plant file takes 110."""
    folder = write_set(tmp_path / "data", {})
    problem = FitProblem.of(read_dataset(folder))
    search, pieces = told({"": [100.0], "a": [1.0]}, 300.0)
    shift = np.zeros(len(problem.names))
    search.fit = problem.at(shift, (), np.empty(0), problem.base)
    for beyond in (0.0, 1e3):
        shift[problem.names.index("atmosphere_kpa")] = beyond
        moved = SimpleNamespace(moved=lambda columns: shift)
        search.terms = cast(Any, moved)
        assert _can_be_stated(problem, search, [pieces["a"]]) is (beyond == 0.0)
    astray = replace(problem.base, shift=shift)
    (folder / "bench.toml").write_text(improved_plant(problem, astray), encoding="utf-8")
    assert read_dataset(folder).constants.value("atmosphere_kpa") == 110.0


def test_where_no_row_is_a_term_goes_back_to_none() -> None:
    """A drift of 40 s said nothing of a test of 180 s, and was drawn on as a line for the rest."""
    time = np.r_[np.linspace(0.0, 40.0, 200), np.linspace(41.0, 180.0, 200)]
    pieces, columns = pieces_of({"time_s": time}, len(time))
    piece = max(pieces, key=lambda one: len(one.at))
    assert piece.inputs == ("time_s",)
    own, early = columns[:, piece.at], time < 41.0
    seen = time[early] / 40.0
    prior = np.eye(len(piece.at)) / VALIDATION.term_sd**2 + piece.rough / VALIDATION.term_bend**2
    inner = own[early].T @ own[early] * 10.0 + prior / np.mean(seen**2)
    value = own @ np.linalg.solve(inner, own[early].T @ seen * 10.0)
    assert value[early] == pytest.approx(seen, abs=0.1)
    # With a prior of 5 rms it went on rising, and 0.3 to 0.6 were left after 150 s.
    assert np.abs(value[~early]).max() < 1.0
    assert np.abs(value[time > 150.0]).max() < 0.15


def test_what_a_piece_must_close_is_a_share_of_the_gap_that_is_seen() -> None:
    """Where the slot is left out that holds the gap, the rest is what there is to explain."""
    search, _ = told({"": [1.0]}, 0.0)
    search.gaps = np.array([1000.0, 3.0, 5.0])
    whole = search.least_gain(frozenset(), further=False)
    rest = search.least_gain(frozenset({0}), further=False)
    assert whole / rest == pytest.approx(1008.0 / 8.0)
    assert search.least_gain(frozenset(), further=True) > 2.0 * whole


def test_of_a_large_gap_what_leaves_much_more_is_not_as_good() -> None:
    """Floors are 2 a slot: of 10,000 an offset leaves 300 and the flow 6, of 40 both do well."""
    for before, simple, expected in ((1e4, 100.0, "fine"), (40.0, 3.0, "offset")):
        search, pieces = told(
            {"": [before] * 3, "offset": [simple] * 3, "fine": [2.0] * 3}, 3.0 * before
        )
        fine = Piece(("pressure_kpa",), ((0.0, 1.0),), "fine", np.array([0]), np.zeros((1, 1)))
        search.pieces = (fine, pieces["offset"])
        found = search._next([], search.errors([]), frozenset())
        assert found is not None
        assert found[0].scale == expected


def held_lengths(folder: Path) -> Path:
    """Isometric tests at four written lengths, each twice, whose camera reads 0.3 mm too much in
    the shortest and 0.1 mm in the others.
    """
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 8.0, 0.05)
    pressure = np.interp(t, [0.0, 3.0, 5.0, 8.0], [0.0, 300.0, 300.0, 0.0])
    trials, tables = [], []
    for k, length in enumerate((56.0, 60.0, 64.0, 68.0) * 2):
        name = f"t{k}"
        trials.append(
            {"trial": name, "slot": f"s{k % 4}", "protocol": "isometric", "held_length_mm": length}
        )
        tables.append(
            pd.DataFrame(
                {
                    "trial": name, "time_s": t,
                    "pressure_kpa": pressure + rng.normal(0.0, 0.3, len(t)),
                    "length_mm": length + (0.3 if length == 56.0 else 0.1)
                    + rng.normal(0.0, 0.01, len(t)),
                    "force_n": 0.1 * pressure + rng.normal(0.0, 0.1, len(t)),
                }
            )
        )  # fmt: skip
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(tables).to_csv(folder / "samples.csv", index=False)
    return folder


def test_every_scale_of_a_piece_is_one_that_a_plant_file_takes(tmp_path: Path) -> None:
    """A term of a length in proportion to the pull was written, and refused when it was read."""
    sets = (
        held_lengths(tmp_path / "held"),
        write_set(tmp_path / "valve", {"leak": {"conductance_m3_s_pa": 1e-13}}),
    )
    seen = set()
    for folder in sets:
        problem = FitProblem.of(read_dataset(folder))
        for block in blocks_with_gap(problem, problem.base):
            search = search_of(problem, problem.base, block, VALIDATION)
            for piece in search.pieces if search is not None else ():
                coefficients = (0.0,) * len(piece.at)
                term = SplineTerm(
                    piece.inputs, piece.knots, coefficients, piece.scale, piece.period
                )
                written = {block: Correction(block, (term,)).as_config()}
                assert Corrections.from_config(written).of[block].terms == (term,)
                seen.add(block)
    assert {"camera", "force", "pressure"} <= seen
