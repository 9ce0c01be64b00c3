"""No number of the blind bench's forms stands in the diagnosis's forms of the same effect."""

from __future__ import annotations

import pytest

from blind.physics import numbers as n
from constants_apart import Number, alike, in_blind, in_diagnosis

# Counts, halves and powers; per cent, kilo and milli; the places where headlines are stated (60 mm,
# 300 and 500 kPa); a standard atmosphere and the end of time.
TRIVIAL = {
    0.0, 1.0, 2.0, 3.0, 0.5, 0.25, 10.0, 100.0, 1e3, 1e-2, 1e-3, 1e-6, 1e9,
    60.0, 300.0, 500.0, 101.325, 273.15,
}  # fmt: skip
# The same digits for something else: effect, digits in `blind`, and what each of the two is.
CHANCE = {
    ("pressure_lag", 0.3): "bend of a rate over the pressure's distance; share of two lags",
    ("link_friction", 0.1): "speed in mm/s of form 0, in no blind set; a travel in mm",
    ("creep", 0.55): "weight of an element; a slot of the parameter array",
    ("creep", 0.12): "time over another time; seconds",
    ("creep", 0.15): "time over another time; seconds",
    ("creep", 4.0): "least of a drawn time; the number of elements",
    ("braid_friction", 25.0): "most of a drawn travel in kPa; a travel in mm",
    ("bladder_elasticity", 8.0): "least of a drawn Fung length; stretch of an equal cubic term",
}


def shared() -> list[tuple[Number, Number]]:
    theirs = [y for y in in_diagnosis() if abs(y.value) not in TRIVIAL]
    return [
        (x, y)
        for x in in_blind()
        for y in theirs
        if x.effect == y.effect and abs(x.value) not in TRIVIAL and alike(x.value, y.value)
    ]


def test_every_effect_has_numbers_on_both_sides_that_are_compared() -> None:
    """Else nothing is checked: a delay that is only added has no number of its own."""
    assert {x.effect for x in in_blind()} == set(n.EFFECT_IDS)
    assert {"link_friction", "creep", "viscosity"} <= {y.effect for y in in_diagnosis()}
    assert len(in_blind()) > 400


def test_no_number_of_a_form_is_shared_with_the_diagnosis() -> None:
    found = {
        f"{x.effect}: {x.value:g} ({x.place}) is {y.value:g} ({y.place})"
        for x, y in shared()
        if (x.effect, x.value) not in CHANCE
    }
    assert not found


def test_every_exception_is_still_needed() -> None:
    assert {(x.effect, x.value) for x, _ in shared()} >= set(CHANCE)


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        (4.0, 4e-3, True),
        (0.35, 35.0, True),
        (4.0, 0.4, False),
        (1.6, 16.1, False),
        (8.0, 8.0, True),
    ],
)
def test_a_change_of_unit_hides_no_number(a: float, b: float, same: bool) -> None:
    assert alike(a, b) is same
