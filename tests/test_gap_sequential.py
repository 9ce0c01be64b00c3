"""Where an investigation stands after its last diagnosis: names, proofs, references, doubts."""

from __future__ import annotations

import dataclasses

import pytest

from gap.decision.sequential import SequentialVerdict, joint
from gap.reporting.text import conclusion_text
from gap.validation.prediction import Prediction, families
from gap.verdict import Experiment, Explanation, Gap, Status, Verdict
from plant.effects.catalogue import CATALOGUE


def verdict_with(status: str, effects: tuple[str, ...] = ()) -> Verdict:
    ids = [tuple(effect.split("+")) for effect in effects]
    found = tuple(Explanation(i, "+".join(CATALOGUE[e].family for e in i), 0.4, {}) for i in ids)
    return Verdict(Status(status), "", None, found, 0.0, 1.0, None, (), (), {}, None, {})


def predicted(without: float, left: float, rival: float, by: str = "creep") -> Prediction:
    return Prediction(400, without, left, {(by,): rival})


def test_what_a_standard_shows_is_named_though_the_rest_is_open() -> None:
    """Withheld bench 940: blocks showed the camera's scale, and a small rest looked like a stop."""
    ids = ("camera_scale+contraction_limit", "camera_scale+end_cap")
    verdict = dataclasses.replace(
        verdict_with("indistinguishable", ids),
        evidence={"standards": {"shown": {"camera_scale": {"value": 0.4, "u": 0.02}}}},
    )
    standing = SequentialVerdict(verdict=verdict)
    assert (standing.conclusion, standing.named) == ("named", "length_sensor")
    assert standing.references == {}
    none = dataclasses.replace(verdict, evidence={"standards": {"shown": {}, "cleared": []}})
    assert SequentialVerdict(verdict=none).conclusion == "needs reference"


def test_of_a_gap_that_nothing_fits_for_sure_the_instruments_are_checked_first() -> None:
    """Withheld bench 996: a camera's scale of 0.5 %, unknown for a trace of an end cap."""
    left = verdict_with("unknown", ("camera_distortion", "end_cap+camera_scale"))
    standing = SequentialVerdict(verdict=left)
    assert (standing.conclusion, standing.references) == ("open", {})
    assert standing.doubted == ("camera_distortion", "end_cap", "camera_scale")
    alike = SequentialVerdict(verdict=verdict_with("indistinguishable", ("end_cap", "creep")))
    assert alike.doubted == ("end_cap", "creep")
    assert SequentialVerdict(verdict=verdict_with("named", ("camera_scale",))).doubted == ()


@pytest.mark.parametrize(
    ("effects", "tests", "conclusion"),
    [
        (("viscosity",), [], "open"),
        (("viscosity", "creep"), [], "needs reference"),
        (("viscosity",), [predicted(9e3, 420.0, 6e3)], "named"),
        (("viscosity", "creep"), [predicted(9e3, 420.0, 6e3)], "named"),  # of one family
        (("viscosity",), [predicted(9e3, 2e3, 6e3)], "open"),  # a fifth of it is not predicted
        (("viscosity",), [predicted(9e3, 420.0, 480.0)], "open"),  # another predicted it as well
        (("viscosity",), [predicted(9e3, 420.0, 500.0), predicted(9e3, 420.0, 480.0)], "named"),
        (("viscosity",), [predicted(450.0, 390.0, 440.0)], "open"),  # nothing there to predict
        (("viscosity",), [predicted(9e3, 420.0, 6e3), predicted(9e3, 5e3, 6e3)], "open"),  # refuted
        (("viscosity",), [predicted(9e3, 420.0, 6e3), predicted(9e3, 420.0, 480.0)], "named"),
        (("viscosity",), 2 * [predicted(9e3, 3e3, 6e3)], "named"),  # inexact, others far worse
        (("viscosity",), [predicted(9e3, 3e3, 6e3)], "open"),  # once may be chance
        (("viscosity",), 2 * [predicted(9e3, 3e3, 5e3)], "open"),  # another is not far worse
        (("viscosity", "camera_delay"), [predicted(9e3, 420.0, 6e3)], "needs reference"),
        (("viscosity", "camera_delay"), [predicted(9e3, 420.0, 6e3, "camera_delay")], "named"),
        (("viscosity", "wear+end_cap"), [predicted(9e3, 420.0, 6e3, "wear")], "named"),
        (("viscosity", "end_cap+viscosity"), [predicted(9e3, 420.0, 6e3)], "named"),  # in both
        (("viscosity", "end_cap+viscosity"), [], "needs reference"),
    ],
)
def test_one_family_is_named_once_a_later_test_came_out_as_it_foretold(
    effects: tuple[str, ...], tests: list[Prediction], conclusion: str
) -> None:
    standing = SequentialVerdict(verdict=verdict_with("indistinguishable", effects))
    standing.predicted[CATALOGUE["viscosity"].family] = [("isobaric", test) for test in tests]
    assert standing.conclusion == conclusion
    assert standing.settled == (conclusion == "named")
    assert ("confirmed by the isobaric test" in conclusion_text(standing)) == (
        conclusion == "named"
    )
    told_apart = ("camera_delay", "wear+end_cap")
    left = [e for e in effects if conclusion != "named" or e not in told_apart]
    names = {name for effect in left for name in effect.split("+")}
    assert set(standing.references) == (
        set() if conclusion == "named" and len(names) == 1 else names
    )


def test_what_looked_like_nothing_known_is_named_too_once_it_foretold_a_test() -> None:
    standing = SequentialVerdict(verdict=verdict_with("unknown", ("viscosity",)))
    assert (standing.conclusion, standing.settled) == ("open", False)
    standing.predicted[CATALOGUE["viscosity"].family] = [("isobaric", predicted(9e3, 420.0, 6e3))]
    assert (standing.conclusion, standing.settled) == ("named", True)


def test_a_name_of_two_families_is_put_to_the_proof_that_it_takes_both() -> None:
    standing = SequentialVerdict(verdict=verdict_with("named", ("wear+creep",)))
    assert standing.conclusion == "named"  # if there is no other test
    assert not standing.settled
    key = joint(families(("creep", "wear")))
    standing.predicted[key] = [
        ("isometric", predicted(9e3, 420.0, 480.0))
    ]  # creep alone did as well
    assert not standing.settled
    standing.predicted[key] += [("isometric", predicted(9e3, 420.0, 6e3))]
    assert standing.settled


def test_a_fault_leaves_a_name_of_two_families_open_that_no_test_has_proved() -> None:
    """Withheld bench 977: an outlet of 0.4, and the board stopped the tests at a slow vent."""
    ended = "vent_failed: vented, but the pressure did not fall in time"
    two = verdict_with("named_form_inadequate", ("flow_area+dead_volume",))
    standing = SequentialVerdict(verdict=two, ended=ended)
    assert (standing.conclusion, standing.named) == ("open", None)
    assert "a fault ended the investigation" in conclusion_text(standing)
    one = SequentialVerdict(verdict=verdict_with("named", ("flow_area",)), ended=ended)
    assert (one.conclusion, one.named) == ("named", "flow")
    key = joint(families(("flow_area", "dead_volume")))
    standing.predicted[key] = [("step", predicted(9e3, 420.0, 6e3, "flow_area"))]
    assert standing.conclusion == "named"


def test_of_several_families_those_are_named_that_a_test_needed() -> None:
    """A droop was named with a pressure gain that every test did as well without."""
    standing = SequentialVerdict(verdict=verdict_with("named", ("wear+creep",)))
    wear, creep = CATALOGUE["wear"].family, CATALOGUE["creep"].family
    assert standing.named == f"{wear}+{creep}"  # no test has told them apart
    key = joint(families(("creep", "wear")))
    tests = standing.predicted.setdefault(key, [])
    for alone in ({"creep": 430.0, "wear": 440.0}, {"creep": 430.0, "wear": 6e3}):
        tests.append(("step", Prediction(400, 9e3, 420.0, {(k,): v for k, v in alone.items()})))
        assert standing.named == (creep if alone["wear"] > 1e3 else f"{wear}+{creep}")
    tests.append(("step", Prediction(400, 9e3, 420.0, {("creep",): 6e3, ("wear",): 430.0})))
    assert standing.named == f"{wear}+{creep}"


def test_agreement_that_leans_on_what_is_stated_asks_for_a_check_of_it() -> None:
    """A label 0.2 mm wrong passes for the mounting and the camera's calibration, all at 3 sd."""
    standing = SequentialVerdict(verdict=verdict_with("no_gap_above_floor"))
    assert (standing.conclusion, standing.settled, standing.references) == ("no gap", False, {})
    standing.relieving = {"camera_scale": 25.0, "length_label": 20.0}
    assert (standing.conclusion, standing.settled) == ("needs reference", False)
    assert "camera_scale or length_label in its place" in conclusion_text(standing)
    assert set(standing.references) == {"camera_scale", "length_label"}
    assert all("gauge block" in how for how in standing.references.values())


def test_entries_of_one_family_that_fit_alike_need_a_reference_as_well() -> None:
    alike = verdict_with("indistinguishable", ("length_label", "camera_scale"))
    standing = SequentialVerdict(verdict=alike)
    assert (standing.conclusion, standing.settled) == ("needs reference", False)
    assert set(standing.references) == {"camera_scale", "length_label"}


@pytest.mark.parametrize(("protocol", "needed"), [("reference", True), ("isotonic", False)])
def test_an_entry_that_only_a_reference_tells_from_another_needs_that_reference(
    protocol: str, needed: bool
) -> None:
    """A camera whose scale is off by 3 sd, on held lengths close together, may be distorted."""
    alone = verdict_with("indistinguishable", ("camera_distortion",))
    advised = Experiment(
        protocol, {}, 4.6, 10.0, 1, ("camera_distortion", "end_cap+camera_scale"), ""
    )
    standing = SequentialVerdict(verdict=dataclasses.replace(alone, next_experiment=advised))
    assert standing.conclusion == ("needs reference" if needed else "open")
    names = {"camera_distortion", "end_cap", "camera_scale"} if needed else {"camera_distortion"}
    assert set(standing.references) == names
    said = "It takes a reference to tell it from end_cap or camera_scale."
    assert (said in conclusion_text(standing)) == needed


@pytest.mark.parametrize("status", ["named", "named_form_inadequate"])
@pytest.mark.parametrize(
    ("closed_low", "uncertain"), [(-5.4, True), (0.4, True), (None, True), (0.8, False)]
)
def test_a_name_not_certain_to_close_half_of_the_gap_waits_for_the_tests_left(
    closed_low: float | None, uncertain: bool, status: str
) -> None:
    """An inlet of 0.997 was named before the muscle had been warm."""
    named = verdict_with(status, ("flow_area",))
    gap = Gap("kPa", 2.0, 1.5, 1.0, 0.9, "replicates", 0.9, closed_low, 1.0, "slot")
    standing = SequentialVerdict(verdict=dataclasses.replace(named, gap=gap))
    assert standing.conclusion == "named"
    assert standing.settled
    assert standing.uncertain == uncertain


def test_a_name_of_several_effects_waits_for_the_tests_left() -> None:
    """An inlet and a critical ratio stood for a load that no test had shown yet."""
    gap = Gap("kPa", 2.0, 1.5, 0.1, 0.09, "replicates", 0.97, 0.95, 1.0, "slot")
    for effects, waits in ((("flow_area+critical_ratio",), True), (("flow_area",), False)):
        named = dataclasses.replace(verdict_with("named", effects), gap=gap)
        standing = SequentialVerdict(verdict=named)
        assert (standing.settled, standing.uncertain) == (True, waits)


@pytest.mark.parametrize(
    ("status", "entries", "agreed"),
    [
        ("indistinguishable", ("temperature_stiffening+pressure_zero",
                               "temperature_stiffening+braid_friction"), "temperature"),
        ("indistinguishable", ("temperature_stiffening", "temperature_stiffening+wear"),
         "temperature"),
        ("indistinguishable", ("temperature_stiffening+pressure_zero", "wear"), None),
        ("indistinguishable", ("temperature_stiffening+wear",), None),  # of two families, both
        ("named", ("temperature_stiffening",), None),  # nothing left to find out
        ("unknown", (), None),
    ],
)  # fmt: skip
def test_entries_that_differ_in_what_stands_beside_a_family_agree_on_it(
    status: str, entries: tuple[str, ...], agreed: str | None
) -> None:
    """The test that shows it is then made again, as where it leads alone (withheld bench 730)."""
    assert SequentialVerdict(verdict=verdict_with(status, entries)).agreed == agreed
