"""Each effect of an explanation by itself: what is named where the whole is refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import gap.decision.classify as decision
from blind.exchange import write
from blind.recording import record
from blind.sets import SEVERAL, blind_set
from gap.check.presence import cases, fit
from gap.data.from_runs import open_data
from gap.data.reader import read_dataset
from gap.decision.classify import (
    _by_presence,
    _Case,
    _explained,
    _Finding,
    _judged,
    _least,
    _surely_there,
    _told_apart,
)
from gap.decision.config import DECISION
from gap.decision.confounders import Confounder
from gap.decision.diagnose import has_sure_effect
from gap.decision.presence import (
    FEATURES,
    Evidence,
    evidence_of,
    odds_of,
    only_effects,
    shipped_presence,
)
from gap.errors import CheckError
from gap.estimation.fit_problem import FitProblem
from gap.reason import Cause, reason, rest_of
from gap.reporting.text import headline
from gap.selection.candidate_fits import Hypothesis, is_bent
from gap.selection.config import SELECTION
from gap.selection.further import is_further, with_further
from gap.selection.inclusion import StepStatistics, excess_chi2
from gap.selection.search import SearchResult, search_effects
from gap.verdict import Explanation, Status, Verdict
from gap_bench import write_set

TWO_MORE = ("wear", "creep")
TWO = {"bladder_elasticity": {"stiffness_n_mm": 0.8}, "leak": {"conductance_m3_s_pa": 2e-13}}


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> _Case:
    """A bench with two effects, both found."""
    folder: Path = tmp_path_factory.mktemp("two")
    problem = FitProblem.of(open_data(write_set(folder, TWO, 3, replicates=2)))
    search = search_effects(problem)
    assert set(search.best.fit.ids) == set(TWO)
    return _Case(problem, search, DECISION)


def refused(case: _Case) -> _Finding:
    """What the verdict is where the explanation as a whole is refused."""
    why = reason(Cause.OUTSIDE, names=case.names, percent=80.0)
    return _Finding(Status.UNKNOWN, why, 0.0, 0.6, named=True, entries=[(case.search.best, 0.4)])


def test_effects_that_are_there_have_a_high_probability(two: _Case) -> None:
    odds = {
        one.id: shipped_presence().of(one) for one in evidence_of(two.problem, two.search, 0.05)
    }
    assert min(odds.values()) > 0.9


def test_where_the_whole_is_refused_the_sure_effect_is_named_alone(two: _Case) -> None:
    odds = {"leak": 0.95, "bladder_elasticity": 0.6}
    part, found = _by_presence(two, refused(two), two.search, odds)
    assert found.status is Status.NAMED_FORM_INADEQUATE
    assert found.sure == ("leak",)
    assert part.search.best.fit.ids == ("leak",)  # fitted anew without the other
    assert part.search.left > two.search.left
    assert found.unknown == pytest.approx(0.05)
    assert "what explains the rest is not known" in str(found.reason)


def test_without_a_sure_effect_the_verdict_stays_unknown(two: _Case) -> None:
    case, found = _by_presence(two, refused(two), two.search, dict.fromkeys(TWO, 0.85))
    assert found.status is Status.UNKNOWN
    assert case is two


def test_where_the_whole_is_refused_an_effect_that_is_only_likely_is_offered_not_named(
    two: _Case,
) -> None:
    odds = {"leak": 0.93, "bladder_elasticity": 0.3}
    part, found = _by_presence(two, refused(two), two.search, odds)
    assert (found.status, found.sure) == (Status.INDISTINGUISHABLE, ())
    assert part.search.best.fit.ids == ("leak",)
    assert "leak fits best, but" in str(found.reason)


def test_a_refused_explanation_names_nothing_that_explains_the_smaller_part(two: _Case) -> None:
    """Pairs 53573, 53576 and 53599: wrong names that explained 15, 38 and 46 % of the gap.

    What explained the rest had no name, and showed as they do.
    """
    first, other = two.search.best.fit.ids
    odds = {first: 0.99, other: 0.2}
    part, found = _by_presence(two, refused(two), two.search, odds)
    assert found.sure == (first,)
    stricter = replace(two, config=replace(DECISION, least_in_refused=part.share + 0.01))
    found = _by_presence(stricter, refused(two), two.search, odds)[1]
    assert (found.status, found.sure) == (Status.UNKNOWN, ())
    assert found.reason == refused(two).reason
    # The same of one that would be offered only.
    odds = {first: 0.92, other: 0.2}
    assert _by_presence(two, refused(two), two.search, odds)[1].status is Status.INDISTINGUISHABLE
    assert _by_presence(stricter, refused(two), two.search, odds)[1].status is Status.UNKNOWN


def test_a_refused_explanation_of_many_effects_names_nothing(two: _Case) -> None:
    """Pairs 53573, 53599, 53644 and 53704: one of four or five effects was sure, and wrong."""
    odds = {"leak": 0.98, "bladder_elasticity": 0.6}
    fewer = replace(two, config=replace(DECISION, most_in_refused=1))
    found = _by_presence(fewer, refused(two), two.search, odds)[1]
    assert (found.status, found.sure) == (Status.UNKNOWN, ())
    assert _by_presence(two, refused(two), two.search, odds)[1].sure == ("leak",)


@pytest.mark.parametrize("effects", [1, 2])
@pytest.mark.parametrize(("unknown", "foreign"), [(0.34, False), (0.36, True)])
def test_an_explanation_that_often_stands_for_something_foreign_is_refused(
    two: _Case, one: _Case, effects: int, unknown: float, foreign: bool
) -> None:
    """Pairs 53472, 53482, 53590 and 53704, where two to four stood for one that was struck, and
    54416, where one did."""
    case = replace(two if effects == 2 else one)
    case.__dict__["reliability"] = {"right": 0.5, "part": 0.0, "other": 0.0, "unknown": unknown}
    found = _explained(case)
    assert (found.status is Status.UNKNOWN) is foreign


@pytest.mark.parametrize(("right", "named"), [(0.84, False), (0.86, True)])
def test_an_effect_alone_is_named_where_it_is_likely_enough(
    one: _Case, right: float, named: bool
) -> None:
    """Below it is offered with its probability: of 32 such names of pairs 53897 to 54256 and their
    partners between 0.72 and 0.85 seven were wrong."""
    case = replace(one)
    rest = 1.0 - right
    case.__dict__["reliability"] = {"right": right, "part": 0.0, "other": 0.0, "unknown": rest}
    found = _explained(case)
    assert (found.status in (Status.NAMED, Status.NAMED_FORM_INADEQUATE)) is named
    assert found.entries[0][0].fit.ids == one.search.best.fit.ids


def test_what_is_named_in_any_case_is_seldom_all_there_is(two: _Case) -> None:
    """Where effects were sure (0.95), they were all there was in 12 of 29 sets."""
    first, other = two.search.best.fit.ids
    found = _by_presence(two, refused(two), two.search, {first: 0.96, other: 0.7})[1]
    assert found.sure == (first,)
    probability = {hypothesis.fit.ids: p for hypothesis, p in found.entries}
    # Half of what the explanation as a whole has for something unknown stays.
    unknown = max(0.04, 0.5 * two.reliability["unknown"])
    # One that was 0.7 by itself was there in a fifth of such sets.
    beside = probability[first, other] / (1.0 - unknown)
    assert 0.1 < beside < 0.3
    assert probability[first,] == pytest.approx((1.0 - beside) * (1.0 - unknown))
    assert found.unknown == pytest.approx(unknown)
    # The named one leads all the same, and is what the report calls alone.
    explanations = decision._explanations(two.problem, two.config, found)
    assert [one.ids for one in explanations] == [(first,), (first, other)]
    verdict = Verdict(found.status, found.reason, None, tuple(explanations), 0.0, 0.1)
    assert [verdict.label(one) for one in explanations] == [f"{first} alone", f"{first} + {other}"]


def test_an_effect_that_is_rather_not_there_is_not_named_with_the_rest(two: _Case) -> None:
    whole = replace(refused(two), status=Status.NAMED)
    odds = {"bladder_elasticity": 0.8, "leak": 0.3}
    assert _by_presence(two, whole, two.search, odds)[1].sure == ("bladder_elasticity",)
    odds = dict.fromkeys(TWO, 0.8)
    assert _by_presence(two, whole, two.search, odds)[1].sure == two.search.best.fit.ids


@pytest.mark.parametrize(("unknown", "named"), [(0.2, True), (0.38, False)])
def test_the_likelier_something_outside_the_catalogue_the_surer_an_effect_must_be(
    two: _Case, unknown: float, named: bool
) -> None:
    """A scale and a label, 0.88 and 0.85, stood for a distortion that the catalogue lacked."""
    whole = replace(refused(two), status=Status.NAMED)
    doubted = replace(two)
    doubted.__dict__["reliability"] = {**two.reliability, "unknown": unknown}
    found = _by_presence(doubted, whole, two.search, dict(zip(TWO, (0.88, 0.85), strict=True)))[1]
    assert found.sure == (two.search.best.fit.ids if named else ())
    assert found.status is (Status.NAMED if named else Status.INDISTINGUISHABLE)


@pytest.mark.parametrize("status", [Status.INDISTINGUISHABLE, Status.MIMICABLE])
def test_one_of_several_that_is_there_by_itself_is_named_although_others_fit_the_whole(
    two: _Case, status: Status
) -> None:
    """Sets 1137, 1149, 1177 and 1192: of seven such effects above 0.8, six were there."""
    rival = only_effects(two.problem, two.search, ("leak",)).best
    alike = replace(refused(two), status=status, entries=[(rival, 0.4)])
    odds = {"bladder_elasticity": 0.85, "leak": 0.6}
    few = _by_presence(two, alike, two.search, odds)[1]
    assert few.sure == ()
    many = _by_presence(two, alike, two.search, {**odds, "creep": 0.3})[1]
    assert (many.status, many.sure) == (status, ("bladder_elasticity",))
    told = str(many.reason)
    assert told.startswith("bladder_elasticity (85 % or more), whatever else acts; ")
    assert told.endswith(str(alike.reason))


@pytest.mark.parametrize(
    ("others", "usual", "least"),
    [((0.95, 0.92), 0.8, 0.75), ((0.95, 0.92), 0.94, 0.75), ((0.95, 0.85), 0.8, 0.8)],
)
def test_beside_two_effects_that_are_sure_a_third_is_named_sooner(
    others: tuple[float, float], usual: float, least: float
) -> None:
    odds = {"leak": 0.76, **dict(zip(TWO_MORE, others, strict=True))}
    assert _least("leak", odds, usual, DECISION) == least


def sure_of(name: str, visibility: float) -> Evidence:
    """An effect of which nothing makes doubt."""
    return Evidence(
        name, left=100.0, gap=1e5, lost=2e4, margin=2e4, slots=4.0, visibility=visibility,
        shape_at_end=0.0, single=0.0, steady=20.0, unknown=0.0,
    )  # fmt: skip


@pytest.mark.parametrize("form", ["dead_volume", "polytropic"])
def test_a_conductance_that_may_only_correct_a_volume_is_not_sure(form: str) -> None:
    """Five such names in eight campaigns of held-out forms; none of them was there."""
    odds = odds_of([sure_of(form, 5.0), sure_of("flow_area", 1.0)])
    assert odds[form] > 0.9
    assert odds["flow_area"] == 0.75
    plain = odds_of([sure_of(form, 5.0), sure_of("flow_area", 2.0)])
    assert plain["flow_area"] > 0.9
    alone = odds_of([sure_of("leak", 5.0), sure_of("flow_area", 1.0)])
    assert alone["flow_area"] > 0.9


def test_no_effect_that_is_likelier_there_than_a_named_one_stays_without_a_name() -> None:
    """Set 1061: beside two of 0.9 the one of 0.85 was named, that of 0.92 beside one was not."""
    odds = {"camera_scale": 0.85, "wear": 0.96, "force_zero": 0.92, "creep": 0.6}
    usual = DECISION.present_in_refused
    named = _surely_there(tuple(odds), odds, usual, DECISION)
    assert named == ("camera_scale", "wear", "force_zero")
    assert _surely_there(("creep",), odds, usual, DECISION) == ()


def test_an_effect_whose_amount_is_open_does_not_take_the_name_of_the_one_beside_it(
    two: _Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A delay of 8 floors whose interval held its whole range left three others without a name."""
    monkeypatch.setattr(decision, "_undetermined", lambda case, fit: ("leak",))
    found = _by_presence(two, refused(two), two.search, dict.fromkeys(TWO, 0.95))[1]
    assert found.sure == ("bladder_elasticity",)
    assert set(found.entries[0][0].fit.ids) == set(TWO)
    assert "with leak, whose amount these data leave open" in str(found.reason)
    monkeypatch.setattr(decision, "_undetermined", lambda case, fit: fit.ids)
    found = _by_presence(two, refused(two), two.search, dict.fromkeys(TWO, 0.95))[1]
    assert (found.status, found.sure) == (Status.UNKNOWN, ())


def test_effects_on_which_all_entries_agree_are_sure(two: _Case) -> None:
    best = two.search.best
    other = replace(best, fit=replace(best.fit, candidates=best.fit.candidates[:1]))
    entries = [(best, 0.5), (other, 0.4)]
    open_ = replace(refused(two), status=Status.INDISTINGUISHABLE, entries=entries)
    found = _by_presence(two, open_, two.search, dict.fromkeys(TWO, 0.95))[1]
    assert found.status is Status.INDISTINGUISHABLE
    assert found.sure == other.fit.ids


def test_an_effect_in_whose_place_the_further_search_put_another_is_not_named(two: _Case) -> None:
    """Ends that fill for threads that stretch, in set 758 of the stream `several`."""
    first, other = two.search.best.fit.ids
    whole = replace(refused(two), status=Status.NAMED)
    found = _by_presence(two, whole, two.search, {first: 0.95})[1]
    assert found.sure == (first,)
    assert all(p < 0.01 for entry, p in found.entries if other in entry.fit.ids)


@pytest.fixture(scope="module")
def one(two: _Case) -> _Case:
    """The same bench with one effect alone in the explanation."""
    search = only_effects(two.problem, two.search, two.search.best.fit.ids[:1])
    return _Case(two.problem, replace(search, steps=two.search.steps[:1]), DECISION)


def test_an_effect_that_takes_most_of_what_is_left_comes_beside_the_search(one: _Case) -> None:
    least = replace(SELECTION, beside_fitted=1, most_effects=2)
    further = with_further(one.problem, one.search, least)
    assert set(further.best.fit.ids) == set(TWO)
    assert further.left < one.search.left


def test_a_further_effect_is_named_only_where_it_is_sure(two: _Case, one: _Case) -> None:
    first, other = two.search.best.fit.ids
    whole = replace(refused(one), status=Status.NAMED)
    case, found = _by_presence(one, whole, two.search, {first: 0.95, other: 0.95})
    assert found.sure == (first, other)
    assert found.status is Status.NAMED
    assert case.search.best.fit.ids == (first, other)
    case, found = _by_presence(one, whole, two.search, {first: 0.95, other: 0.8})
    assert found.sure == (first,)
    assert case is one


def test_an_effect_that_leaves_nothing_is_told_apart_from_what_looks_like_it_but_does_not_fit(
    one: _Case,
) -> None:
    """A delay of a camera whose fit left nothing was not named for a viscosity that left 153."""
    exact = replace(one, search=replace(one.search, left=0.0))
    whole = one.problem.base.cost - one.search.best.cost
    like = [Confounder(("viscosity",), 1.0 - left / whole) for left in (0.02 * whole, 60.0)]
    assert 0.02 * whole > 120.0
    assert [_told_apart(exact, each) for each in like] == [True, False]
    assert one.search.left > one.chance  # its own form may be what tells them apart
    assert not any(_told_apart(one, each) for each in like)


@pytest.mark.parametrize(("known", "with_more", "wider"), [
    (0.6, 0.3, True), (0.3, 0.6, False), (0.44, 0.4, False),  # named alone, refused together
])  # fmt: skip
def test_an_explanation_is_judged_with_further_effects_where_it_then_looks_less_foreign(
    two: _Case, one: _Case, monkeypatch: pytest.MonkeyPatch, known: float, with_more: float,
    wider: bool,
) -> None:  # fmt: skip
    """What two effects leave looks like something foreign until a third and a fourth are in."""
    unknown = {1: known, 2: with_more}
    monkeypatch.setattr(
        decision, "shipped_reliability",
        lambda: Told({name: {"unknown": p} for name, p in unknown.items()}),
    )  # fmt: skip
    case = replace(one)
    judged = _judged(case, two.search)
    assert len(judged.search.best.fit.ids) == (2 if wider else 1)
    assert judged.search.left == (two if wider else one).search.left
    assert _judged(case, case.search) is case


@dataclass(frozen=True)
class Told:
    """Outcomes by the number of effects of an explanation."""

    outcomes: dict[int, dict[str, float]]

    def of(self, traits: Mapping[str, float]) -> dict[str, float]:
        return self.outcomes[int(traits["effects"])]


def test_a_plant_in_doubt_is_believed_where_one_effect_is_sure_by_itself() -> None:
    odds = {"leak": 0.85, "wear": 0.92, "creep": 0.86}
    presence = [{"id": name, "probability": p} for name, p in odds.items()]
    verdict = Verdict(
        Status.NAMED, reason(Cause.EXPLAINED, names="all"), None, (), 0.0, 0.1, sure=tuple(odds),
        evidence={"presence": presence},
    )  # fmt: skip
    assert has_sure_effect(verdict)
    assert not has_sure_effect(replace(verdict, sure=("leak", "creep")))
    assert not has_sure_effect(replace(verdict, sure=()))


def test_effects_that_are_all_sure_with_a_further_one_are_named_though_the_part_was_not_reliable(
    two: _Case,
) -> None:
    """Sure of two and of a third beside them, it said that the two are right in 43 % of cases."""
    ids = two.search.best.fit.ids
    why = reason(Cause.UNRELIABLE, names=" and ".join(ids), percent=43.0)
    part = replace(refused(two), status=Status.INDISTINGUISHABLE, reason=why)
    edge = next(c for c in two.problem.candidates if c.id == "pressure_gain")
    fit = two.search.best.fit
    more = two.problem.at(fit.shift, [*fit.candidates, edge], np.array([*fit.amounts, 0.1]), fit)
    further = replace(two.search, best=Hypothesis((*two.search.best.keys, edge.key), more))
    odds = {**dict.fromkeys(ids, 0.96), "pressure_gain": 0.95}
    found = _by_presence(two, part, further, odds)[1]
    assert found.status is Status.NAMED_FORM_INADEQUATE
    assert found.sure == (*ids, "pressure_gain")


def test_a_refused_single_effect_is_only_judged_anew_beside_others_that_take_most_of_the_rest(
    two: _Case, one: _Case
) -> None:
    odds = dict.fromkeys(two.search.best.fit.ids, 0.95)
    found = _by_presence(one, refused(one), two.search, odds)[1]
    assert found.sure == two.search.best.fit.ids
    little = replace(two.search, left=0.5 * one.search.left)
    found = _by_presence(one, refused(one), little, odds)[1]
    assert found.status is Status.UNKNOWN


def test_an_effect_at_two_edges_is_one_effect_with_one_probability(one: _Case) -> None:
    problem = one.problem
    fit = one.search.best.fit
    edges = [next(c for c in problem.candidates if c.key == f"flow_area:{side}")
             for side in ("inlet", "outlet")]  # fmt: skip
    both = problem.at(
        fit.shift, [*fit.candidates, *edges], np.array([*fit.amounts, 0.02, 0.02]), fit
    )
    keys = (*one.search.best.keys, *(edge.key for edge in edges))
    search = replace(one.search, best=Hypothesis(keys, both), rivals=[])
    evidence = evidence_of(problem, search, 0.05)
    assert [each.id for each in evidence] == [*fit.ids, "flow_area"]


def test_a_further_effect_is_also_fitted_from_the_stated_constants(tmp_path: Path) -> None:
    """One effect alone bends the constants; from there no fit of another finds its way."""
    write(record(blind_set(SEVERAL, 518)), tmp_path)
    problem = FitProblem.of(read_dataset(tmp_path))
    late = next(c for c in problem.candidates if c.key == "valve_delay:outlet_off")
    bent = problem.polish(problem.fit([late], [late.step]))
    assert is_bent(problem, bent)
    lag = problem.restricted_to(lambda candidate: candidate.id == "pressure_lag")
    left, gap = excess_chi2(problem, bent), excess_chi2(problem, problem.base)
    search = SearchResult(Hypothesis((late.key,), bent), [], {}, gap, left)
    further = with_further(lag, search)
    assert further.best.keys == (late.key, "pressure_lag")
    assert further.left < 0.7 * left


def test_an_effect_that_takes_little_of_what_is_left_and_is_not_seen_stays_out() -> None:
    step = StepStatistics(
        "leak", 200.0, 1e6, 250.0, 5000, 30.0, 0.05, False, False, False, 0.0, 0.0, False
    )
    assert is_further(step)
    assert not is_further(replace(step, left=2000.0))
    assert not is_further(replace(step, gain=40.0))


def test_the_headline_says_that_a_part_is_not_known() -> None:
    why = reason(Cause.PARTLY, names="leak", percent=95.0, share=60.0, rest=rest_of(60.0))
    entry = Explanation(("leak",), "leak", 0.95)
    verdict = Verdict(Status.NAMED_FORM_INADEQUATE, why, "chamber", (entry,), 0.0, 0.05)
    said = headline(verdict)
    assert "95 % sure" in said
    assert "what explains the rest is not known" in said
    all_of_it = replace(
        verdict,
        reason=reason(Cause.PARTLY, names="leak", percent=95.0, share=99.8, rest=rest_of(99.8)),
    )
    assert "explains 100 % of the gap, and whether anything else acts is" in str(all_of_it.reason)
    assert "whether anything else acts is not known" in headline(all_of_it)
    values = {"names": "wear", "percent": 95.0, "share": 99.0, "open": "leak"}
    beside = replace(verdict, reason=reason(Cause.PARTLY_OPEN, **values))
    assert headline(beside).startswith("wear (95 %), whatever else acts; with leak, whose amount")


def test_an_effect_is_the_likelier_the_less_another_can_stand_for_it() -> None:
    plain = Evidence("leak", 100.0, 5000.0, 2000.0, 10.0, 2.0, 1.0, 0.0, 0.0, 5.0, 0.1)
    odds = [shipped_presence().of(replace(plain, margin=margin)) for margin in (0.0, 50.0, 500.0)]
    assert odds == sorted(odds)
    assert shipped_presence().of(replace(plain, shape_at_end=1.0)) < odds[0]


def line(kind: str, margin: float, there: bool) -> dict[str, object]:
    """A line of a campaign with one effect of one explanation."""
    one = Evidence("leak", 100.0, 5000.0, 2000.0, margin, 2.0, 1.0, 0.0, 1.0, 5.0, 0.1)
    hidden = ["leak"] if there else ["wear"]
    score = {
        "stream": "practice", "kind": kind, "mimic": 0.1, "hidden": hidden, "truth": "effects",
    }  # fmt: skip
    return {"score": score, "verdict": {"evidence": {"presence": [one.as_dict()]}}}


def test_weights_are_learnt_from_lines_of_a_campaign() -> None:
    lines = [line("single", 1000.0, True)] * 20 + [line("single", 1.0, False)] * 20
    of = cases(lines)
    learnt = fit(of.x, of.y, of.weight)
    assert set(learnt.weights) == set(FEATURES)
    assert learnt.weights["margin"] > 0.5
    assert learnt.of(Evidence("leak", 100.0, 5e3, 2e3, 1e3, 2.0, 1.0, 0.0, 1.0, 5.0, 0.1)) > 0.8


def test_sets_with_held_out_forms_never_teach() -> None:
    bad = line("single", 1.0, True)
    bad["score"] = {**bad["score"], "stream": "held_out"}  # type: ignore[dict-item]
    with pytest.raises(CheckError, match="never teach"):
        cases([bad])


def test_where_none_of_several_is_there_by_itself_none_is_named(two: _Case) -> None:
    accepted = replace(refused(two), status=Status.NAMED)
    odds = dict.fromkeys(TWO, 0.7)
    _, finding = _by_presence(two, accepted, two.search, odds)
    assert finding.status is Status.INDISTINGUISHABLE
    assert finding.sure == ()
    assert "49 %" in str(finding.reason)


def test_of_two_that_fit_alike_neither_is_there_with_more_than_one_half() -> None:
    apart = Evidence("leak", 100.0, 1e5, 1e4, 1e4, 4.0, 3.0, 0.0, 0.0, 50.0, 0.0)
    alike = replace(apart, margin=2.0)
    assert shipped_presence().of(apart) > 0.9
    assert shipped_presence().of(alike) == 0.5
