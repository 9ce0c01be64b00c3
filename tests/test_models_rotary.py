"""The rotary muscle: closed form against quadrature, the printed form's departure, clear errors."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from plant.errors import PlantError
from plant.physics.rotary import RotaryMuscle

MUSCLES = [
    RotaryMuscle(0.015, 0.040, 0.050),
    RotaryMuscle(0.008, 0.060, 0.062),
    RotaryMuscle(0.030, 0.030, 0.060),  # longer than pi k / 2: theta cannot be near 0
    RotaryMuscle(0.020, 0.050, 0.0501),
]


def arc_radius(chord: float, length: float) -> float:
    """R from sin(l / 2R) = k / 2R, by bisection in alpha: nothing shared with the package."""
    alpha = brentq(
        lambda a: a * chord - length * math.sin(a), 1e-9, math.pi / 2 + 1e-12, xtol=1e-16
    )
    return chord / (2 * math.sin(alpha))


def quadrature(m: RotaryMuscle, theta: float) -> tuple[float, float]:
    """Volume and dV/dtheta as integrals over the profile, after x = (k/2) sin(t)."""
    h, k = m.radius_m, m.length_m
    length = math.sqrt(m.fibre_m**2 - (h * theta) ** 2)
    r = arc_radius(k, length)
    root = math.sqrt(max(r * r - k * k / 4, 0.0))
    dr_dl = r * root / (length * root - k * r)
    dl_dtheta = -h * h * theta / length

    def rise(x: float) -> float:
        """sqrt(R^2 - x^2) - sqrt(R^2 - k^2/4), without cancellation."""
        return (k * k / 4 - x * x) / (math.sqrt(r * r - x * x) + root)

    def rise_by_r(x: float) -> float:
        """Its derivative by R."""
        return -r * rise(x) / (math.sqrt(r * r - x * x) * root)

    def over_profile(f) -> float:
        parts = np.linspace(0, math.pi / 2, 5)
        whole = [
            quad(lambda t: f(k / 2 * math.sin(t)) * k / 2 * math.cos(t), a, b,
                 epsabs=0, epsrel=1e-13, limit=200)[0]
            for a, b in pairwise(parts)
        ]  # fmt: skip
        return 2 * math.fsum(whole)

    volume = over_profile(lambda x: math.pi * rise(x) * (rise(x) + 2 * h))
    slope = over_profile(lambda x: 2 * math.pi * (rise(x) + h) * rise_by_r(x))
    return volume, slope * dr_dl * dl_dtheta


def angles(m: RotaryMuscle, count: int = 41) -> np.ndarray:
    least, largest = m.range_rad
    share = np.linspace(0.001, 0.999, count)
    return least + share * (largest - least)


@pytest.mark.parametrize("m", MUSCLES)
def test_dvolume_dtheta_equals_quadrature_to_1e9_over_the_whole_range(m: RotaryMuscle) -> None:
    closed = m.dvolume_dtheta(angles(m))
    numeric = np.array([quadrature(m, float(t))[1] for t in angles(m)])
    assert np.max(np.abs(closed / numeric - 1)) < 1e-9


@pytest.mark.parametrize("m", MUSCLES)
def test_volume_equals_quadrature_to_1e9(m: RotaryMuscle) -> None:
    numeric = np.array([quadrature(m, float(t))[0] for t in angles(m)])
    assert np.max(np.abs(m.bulge_volume(angles(m)) / numeric - 1)) < 1e-9


@settings(max_examples=60, deadline=None)
@given(st.floats(0.003, 0.06), st.floats(0.01, 0.2), st.floats(1.001, 2.5), st.floats(0.002, 0.998))
def test_any_sleeve_agrees_with_quadrature(h: float, k: float, ratio: float, at: float) -> None:
    m = RotaryMuscle(h, k, k * ratio)
    least, largest = m.range_rad
    theta = least + at * (largest - least)
    assert m.dvolume_dtheta(theta) == pytest.approx(quadrature(m, theta)[1], rel=1e-9)


@pytest.mark.parametrize("m", MUSCLES)
def test_slope_is_the_difference_quotient_of_the_volume(m: RotaryMuscle) -> None:
    theta = angles(m)[3:-3]
    step = 1e-5 * m.range_rad[1]
    quotient = (m.bulge_volume(theta + step) - m.bulge_volume(theta - step)) / (2 * step)
    assert np.allclose(m.dvolume_dtheta(theta), quotient, rtol=1e-5)


def test_torque_does_the_gas_s_work() -> None:
    m = MUSCLES[0]
    theta = np.linspace(0.3, 1.6, 20001)
    work = np.trapezoid(m.torque_n_m(300e3, theta), theta)
    swell = m.bulge_volume(theta[0]) - m.bulge_volume(theta[-1])
    assert work == pytest.approx(300e3 * swell, rel=1e-6)


@pytest.mark.parametrize("m", MUSCLES)
def test_the_printed_form_has_the_wrong_sign_and_size(m: RotaryMuscle) -> None:
    theta = angles(m, 9)
    ratio = m.printed_dvolume_dtheta(theta) / m.dvolume_dtheta(theta)
    length = m.profile_length(theta)
    expected = -length / np.sqrt((m.radius_m * theta) ** 2 + m.fibre_m**2)
    flat = m.fibre_m < 1.01 * m.length_m  # there it also loses digits
    assert np.all(ratio < 0)
    assert np.allclose(ratio, expected, rtol=1e-2 if flat else 1e-6)


def test_the_printed_length_has_no_real_value_anywhere_in_the_range() -> None:
    for m in MUSCLES:
        assert np.all((m.radius_m * angles(m)) ** 2 - m.fibre_m**2 < 0)


def test_outside_the_range_a_clear_error() -> None:
    with pytest.raises(PlantError, match=r"cannot reach round.*allowed 0 <= \|theta\| < 2 rad"):
        RotaryMuscle(0.015, 0.040, 0.050).dvolume_dtheta(2.01)
    with pytest.raises(PlantError, match="more than a semicircle"):
        MUSCLES[2].torque_n_m(1e5, 0.0)
    with pytest.raises(PlantError, match="is not longer than"):
        RotaryMuscle(0.015, 0.050, 0.050)
    with pytest.raises(PlantError, match="radius_m = 0"):
        RotaryMuscle(0, 0.050, 0.06)


def test_turning_the_other_way_is_the_mirror_image() -> None:
    m = MUSCLES[0]
    assert m.bulge_volume(-0.7) == pytest.approx(float(m.bulge_volume(0.7)))
    assert m.dvolume_dtheta(-0.7) == pytest.approx(-float(m.dvolume_dtheta(0.7)))


def said(words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Exit status, standard output and error of `pamrig models rotary`."""
    from cli.main import main

    monkeypatch.setattr("sys.argv", ["pamrig", "models", "rotary", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, *capsys.readouterr()


def test_the_command_prints_the_model(monkeypatch, capsys) -> None:
    words = ["--radius-mm", "15", "--length-mm", "40", "--fibre-mm", "50", "--angles-deg", "20,-60"]
    status, out, _ = said([*words, "--pressures-kpa", "200", "--json"], monkeypatch, capsys)
    assert status == 0
    found = json.loads(out)
    muscle = MUSCLES[0]
    assert found["range_deg"] == pytest.approx(np.degrees(muscle.range_rad))
    for row, theta in zip(found["rows"], np.radians([20.0, -60.0]), strict=True):
        volume, slope = quadrature(muscle, theta)
        assert row["bulge_ml"] == pytest.approx(volume * 1e6, rel=1e-9)
        assert row["dvolume_ml_per_rad"] == pytest.approx(slope * 1e6, rel=1e-9)
        assert row["torque_n_m"] == [pytest.approx(-200e3 * slope, rel=1e-9)]
    status, out, _ = said(words, monkeypatch, capsys)
    assert status == 0
    assert len(out.splitlines()) == 4
    assert "100 kPa, N m" in out


def test_the_command_spreads_angles_over_the_range(monkeypatch, capsys) -> None:
    status, out, _ = said(["--json"], monkeypatch, capsys)
    rows = json.loads(out)["rows"]
    assert status == 0
    assert rows[0]["angle_deg"] == 0.0
    assert rows[-1]["angle_deg"] == pytest.approx(0.99 * json.loads(out)["range_deg"][1])


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--fibre-mm", "40"], "is not longer than length_m"),
        (["--radius-mm", "0"], "--radius-mm: expected a number above 0"),
        (["--angles-deg", "300"], "has no geometry"),
        (["--angles-deg", "nan"], "--angles-deg: 'nan' is not a list of numbers"),
        (["--pressures-kpa", "-1"], "--pressures-kpa: expected a number from 0"),
        (["--pressures-kpa", "ten"], "--pressures-kpa: 'ten' is not a list of numbers"),
    ],
)
def test_what_has_no_geometry_is_one_line(words, text, monkeypatch, capsys) -> None:
    status, out, error = said(words, monkeypatch, capsys)
    assert (status, out) == (2, "")
    assert error.startswith("pamrig: ")
    assert text in error
    assert error.count("\n") == 1
