"""Every law: slopes and sensitivities against differences, energy, domains and files."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from plant.constants import nominal
from plant.errors import PlantError
from plant.models import catalogue
from plant.models.law import History
from plant.models.model import Model, OutsideDomain
from plant.models.units import to_si
from plant.physics.muscle import force, volume

NAMES = catalogue.names()
SEPARABLE = [n for n in NAMES if catalogue.get(n).law.separable]
SINE0 = np.sqrt(2.0 / 3.0)


def points(n: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray, History]:
    rng = np.random.default_rng(5)
    up, down = np.linspace(20.3, 598.7, n // 2), np.linspace(597.1, 21.9, n - n // 2)
    p = 1e3 * np.concatenate([up, down])
    length = 1e-3 * (59.0 + 6.0 * np.sin(np.linspace(0.3, 6.1, n)))
    path = History(time_s=np.cumsum(rng.uniform(0.5, 9.0, n)), start=np.arange(n) % 40 == 0)
    return p, length, rng.uniform(21.0, 39.0, n), path


def lively(name: str) -> Model:
    """The model with every hysteresis and creep weight switched on."""
    model = catalogue.get(name)
    extra = {"play": 0.004, "slip": 1.5, "late": 0.05}
    on = {p.name: extra[p.name[:4]] for p in model.parameters if p.name[:4] in extra}
    return model.with_values(on)


@pytest.mark.parametrize("name", [n for n in NAMES if not catalogue.get(n).law.memory])
def test_slopes_by_pressure_length_and_temperature_are_the_derivatives(name: str) -> None:
    model = lively(name)
    p, length, t, path = points()
    found = model.law.slopes(model.q, p, length, t, path)
    for k, step in enumerate((200.0, 2e-6, 1e-3)):
        up = [p, length, t]
        down = [p, length, t]
        up[k], down[k] = up[k] + step, down[k] - step
        difference = model.law.force(model.q, *up, path) - model.law.force(model.q, *down, path)
        scale = np.max(np.abs(found[k])) + 1e-12
        assert np.allclose(found[k] / scale, difference / (2 * step) / scale, atol=2e-4)


@pytest.mark.parametrize("name", ["prandtl-ishlinskii", "maxwell-slip"])
def test_slopes_with_memory_are_those_onward_in_the_same_direction(name: str) -> None:
    model = lively(name)
    up = np.linspace(160e3, 590e3, 40)
    p = np.r_[up, up[::-1]]
    length = 1e-3 * np.r_[np.linspace(66, 56, 40), np.linspace(56, 66, 40)]
    t = np.full(80, 21.0)
    by_p, by_l, _ = model.law.slopes(model.q, p, length, t)
    for at in (3, 20, 39, 45, 60, 78):
        head = slice(0, at + 1)
        for k, (step, slope) in enumerate(((1.0, by_p), (1e-8, by_l))):
            # One more step of the same kind as the last: signs of the way so far are kept.
            path = [p[head], length[head], t[head]]
            onward = np.sign(path[k][-1] - path[k][-2])
            further = [np.append(a, a[-1]) for a in path]
            further[k][-1] += onward * step
            ahead = model.law.force(model.q, *further)[-1] - model.law.force(model.q, *path)[-1]
            assert ahead / (onward * step) == pytest.approx(slope[at], rel=1e-4, abs=1e-9)


def test_creep_s_slopes_are_those_of_a_change_at_once() -> None:
    model = lively("creep")
    p, length, t = np.array([2e5, 2e5, 4e5]), np.full(3, 60e-3), np.full(3, 21.0)
    path = History(time_s=np.array([0.0, 1.0, 1.0]))
    by_p, _, _ = model.law.slopes(model.q, p, length, t, path)
    jump = model.law.force(model.q, p, length, t, path)
    more = model.law.force(model.q, p + np.array([0, 0, 10.0]), length, t, path)
    assert (more - jump)[2] / 10.0 == pytest.approx(by_p[2], rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_sensitivities_to_the_parameters_are_the_derivatives(name: str) -> None:
    model = lively(name)
    p, length, t, path = points()
    q = model.q
    found = model.law.jacobian(q, p, length, t, path)
    assert found.shape == (len(q), p.size)
    for k, parameter in enumerate(model.parameters):
        step = 1e-5 * (abs(q[k]) or parameter.to_si)
        up, down = q.copy(), q.copy()
        up[k], down[k] = q[k] + step, q[k] - step
        ahead = model.law.force(up, p, length, t, path)
        difference = (ahead - model.law.force(down, p, length, t, path)) / (2 * step)
        scale = np.max(np.abs(difference)) + 1e-300
        assert np.allclose(found[k] / scale, difference / scale, atol=1e-5), parameter.name


@pytest.mark.parametrize("name", NAMES)
def test_a_linear_law_is_its_sensitivities_times_its_parameters(name: str) -> None:
    model = lively(name)
    p, length, t, path = points()
    rows = model.law.jacobian(model.q, p, length, t, path)
    product = model.q @ rows
    same = np.allclose(product, model.law.force(model.q, p, length, t, path))
    assert same == model.law.linear


@pytest.mark.parametrize("name", SEPARABLE)
def test_work_in_equals_work_out_round_any_closed_path(name: str) -> None:
    model = catalogue.get(name)
    rng = np.random.default_rng(11)
    low, high = (x * 1e3 for x in model.domain.pressure_kpa)
    phase = np.arange(4096) * (2 * np.pi / 4096)
    for _ in range(20):
        a, b = rng.uniform(-1, 1, (2, 3, 2)) / 6.0
        swing = [
            sum(k[i] @ [np.sin((i + 1) * phase), np.cos((i + 1) * phase)] for i in range(3))
            for k in (a, b)
        ]
        p = (low + high) / 2 + (high - low) / 2 * swing[0]
        length = 59e-3 + 7e-3 * swing[1]
        rate_p, rate_l = (_periodic_derivative(x) for x in (p, length))
        gas = -np.mean(model.volume(length, 60e-3, 6e-6) * rate_p)  # = integral of p dV, by parts
        pull = -np.mean(model.force(p, length, outside="ignore") * rate_l)
        size = np.mean(np.abs(p * model.law.arm(model.q, length) * rate_l))
        assert abs(gas - pull) <= 1e-9 * size


def _periodic_derivative(x: np.ndarray) -> np.ndarray:
    n = x.size
    return np.fft.irfft(np.fft.rfft(x) * 1j * np.fft.rfftfreq(n, 1.0 / n), n)


@pytest.mark.parametrize("name", SEPARABLE)
def test_volume_slope_is_minus_the_force_per_pressure(name: str) -> None:
    model = catalogue.get(name)
    length, step = np.linspace(53e-3, 66e-3, 9), 1e-6
    ahead = model.volume(length + step, 60e-3, 6e-6) - model.volume(length - step, 60e-3, 6e-6)
    scale = np.max(np.abs(model.dvolume_dl(length)))
    assert np.allclose(model.dvolume_dl(length) / scale, ahead / (2 * step) / scale, atol=1e-6)
    high = model.domain.pressure_kpa[1] * 1e3
    per_pressure = model.dforce_dp(high, length)
    assert np.allclose(model.dvolume_dl(length), -per_pressure, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", SEPARABLE)
def test_a_sealed_muscle_simulated_with_any_such_model_keeps_its_gas_and_its_energy(name) -> None:
    """Drop-in: the plant's chamber equation (isothermal, valves shut) on the model's own volume."""
    model = catalogue.get(name)
    dead, atmosphere = 0.5e-6, 101325.0
    start = 0.5 * sum(model.domain.pressure_kpa) * 1e3 + atmosphere
    at = np.linspace(57e-3, 61e-3, 4001)
    volume = model.volume(at, 57e-3, 6e-6) + dead
    absolute = [start]
    for k in range(at.size - 1):  # dP/dL = -P V'/V, by the midpoint rule
        h = at[k + 1] - at[k]
        middle = absolute[-1] * (1 - 0.5 * h * model.dvolume_dl(at[k]) / volume[k])
        centre = at[k] + h / 2
        v = model.volume(centre, 57e-3, 6e-6) + dead
        absolute.append(absolute[-1] - h * middle * float(model.dvolume_dl(centre) / v))
    pv = np.array(absolute) * volume
    assert np.max(np.abs(pv / pv[0] - 1)) < 1e-6


def test_piecewise_models_have_no_volume_and_say_so() -> None:
    with pytest.raises(PlantError, match="chou-hannaford"):
        catalogue.get("quasi-static").volume(60e-3, 60e-3, 6e-6)


def test_chou_hannaford_is_the_plants_own_muscle() -> None:
    c = nominal()
    model = catalogue.get("chou-hannaford").with_values({"braid_length": 88.4, "turns": 1.855})
    p, length, _, _ = points()
    assert np.allclose(model.force(p, length), force(p, length, c), rtol=1e-12)
    assert np.allclose(model.law.swept(model.q, length), volume(length, c), rtol=1e-12)


def test_chou_hannaford_pulls_what_the_reference_plant_states() -> None:
    model = catalogue.get("chou-hannaford").with_values({"braid_length": 88.4, "turns": 1.855})
    lengths = np.array([52.0, 55.0, 60.0, 65.0, 67.0]) * 1e-3
    stated = [4.13, 17.49, 41.42, 67.44, 78.43]
    assert np.allclose(model.force(600e3, lengths), stated, atol=0.006)


def test_liner_braid_without_a_threshold_is_braid_and_bladder() -> None:
    liner = catalogue.get("liner-braid").with_values(
        {"threshold": 0.0, "threshold_slope": 0.0, "stiffness": 0.5, "bladder_rest_length": 55.0,
         "braid_length": 88.0, "turns": 1.8}
    )  # fmt: skip
    plain = catalogue.get("braid-bladder").with_values(
        {"stiffness": 0.5, "bladder_rest_length": 55.0, "braid_length": 88.0, "turns": 1.8}
    )
    p, length, _, _ = points()
    assert np.allclose(liner.force(p, length), plain.force(p, length), atol=1e-6)


def test_liner_braid_uses_the_plants_own_liner() -> None:
    from plant.physics.muscle import liner_pressure

    model = catalogue.get("liner-braid").with_values(
        {"threshold": 120.0, "threshold_slope": 0.0, "stiffness": 0.0, "width": 20.0,
         "braid_length": 88.4, "turns": 1.855}
    )  # fmt: skip
    p, length, _, _ = points()
    expected = force(liner_pressure(p, 120e3, 20e3), length, nominal())
    assert np.allclose(model.force(p, length), expected, rtol=1e-9, atol=1e-9)


def test_sarosi_five_is_its_formula_in_bar_and_percent() -> None:
    values = {"a1": 470.0, "a2": -0.61, "a3": -8.9, "a4": 271.0, "a5": -315.0, "rest_length": 300.0}
    model = catalogue.get("sarosi-five").with_values(values)
    bar, percent = 4.5, 6.0
    expected = (bar + 470.0) * np.exp(-0.61 * percent) - 8.9 * percent * bar + 271.0 * bar - 315.0
    length = 300e-3 * (1 - percent / 100)
    assert model.force(bar * 1e5, length, outside="ignore") == pytest.approx(expected, rel=1e-12)


def test_fluidic_is_chou_and_hannaford_in_rest_geometry_with_membrane_and_offset() -> None:
    """With no membrane and no offset the law is the braid, whose b and n follow from r0, theta0."""
    r, angle, rest = 5.0, 25.0, 250.0
    braid_mm = rest / np.cos(np.radians(angle))
    turns = braid_mm * np.sin(np.radians(angle)) / (2 * np.pi * r)
    braid = catalogue.get("chou-hannaford").with_values({"braid_length": braid_mm, "turns": turns})
    bare = catalogue.get("fluidic").with_values(
        {"radius": r, "braid_angle": angle, "rest_length": rest, "end_factor": 1.0,
         "elastic_force": 0.0, "offset_force": 0.0}
    )  # fmt: skip
    full = bare.with_values({"elastic_force": 150.0, "elastic_strain": 2.5, "offset_force": 190.0})
    p, length = np.array([1e5, 3e5, 7e5]), np.array([0.2, 0.24, 0.249])
    assert np.allclose(
        bare.force(p, length, outside="ignore"), braid.force(p, length, outside="ignore")
    )
    extra = 150.0 * np.exp(-(1 - length / 0.25) / 0.025) - 190.0
    assert np.allclose((full.force(p, length, outside="ignore") - extra), bare.force(
        p, length, outside="ignore"
    ))  # fmt: skip


def test_caldwell_pulls_nothing_at_its_minimum_energy_state() -> None:
    model = catalogue.get("caldwell")
    h = model.values["thread_length"] * 1e-3
    at_rest = model.force(500e3, h / np.sqrt(3.0), outside="ignore")
    assert abs(at_rest) < 1e-9 * abs(model.force(500e3, 60e-3))


def test_caldwell_equals_its_equations_written_out() -> None:
    model = catalogue.get("caldwell")
    h, f, eff = model.q
    length = np.array([55e-3, 62e-3])

    def areas(angle: np.ndarray) -> np.ndarray:
        side = np.pi * (f * np.sin(angle)) * (h * np.cos(angle))  # 4-14
        return side + 2 * np.pi / 4 * (f * np.sin(angle)) ** 2

    angle = np.arccos(length / h)
    volumes = [np.sin(a) ** 2 * np.cos(a) for a in (angle, np.arcsin(SINE0))]
    pressure_new = 400e3 * volumes[1] / volumes[0]
    expected = eff * (pressure_new * areas(angle) - 400e3 * areas(np.arcsin(SINE0)))  # 4-16 to 4-18
    assert np.allclose(model.force(400e3, length), expected, rtol=1e-12)


def test_blend_is_the_low_law_to_125_kpa_and_the_high_law_from_150() -> None:
    whole = catalogue.get("black-box")
    low = catalogue.get("black-box-low")
    high = catalogue.get("black-box-high")
    low = low.with_values({n: whole.values[f"low_{n}"] for n in low.values})
    high = high.with_values({n: whole.values[f"high_{n}"] for n in high.values})
    at = 60e-3
    assert whole.force(125e3, at) == pytest.approx(float(low.force(125e3, at)))
    assert whole.force(150e3, at) == pytest.approx(float(high.force(150e3, at)))
    both = [float(m.force(137.5e3, at, outside="ignore")) for m in (low, high)]
    assert whole.force(137.5e3, at) == pytest.approx(sum(both) / 2)


@pytest.mark.parametrize("name", [n for n in NAMES if not catalogue.get(n).law.memory])
def test_many_points_at_once_are_the_same_points_one_by_one(name: str) -> None:
    """No point knows of the others (how fast a million are: docs/evidence/benchmarks.md)."""
    model = lively(name)
    p, length, t, _ = points()
    at_once = model.force(p, length, t, outside="ignore")
    single = [model.force(*point, outside="ignore") for point in zip(p, length, t, strict=True)]
    assert np.allclose(at_once, np.array(single, dtype=float), rtol=1e-13, atol=1e-12)


def test_using_a_model_outside_its_domain_says_so() -> None:
    model = catalogue.get("chou-hannaford")
    with pytest.warns(OutsideDomain, match="length_mm 45 to 45, known 51.45 to 67"):
        model.force(300e3, 45e-3)
    with pytest.raises(PlantError, match="pressure_kpa 900 to 900, known 0 to 600"):
        model.force(900e3, 60e-3, outside="raise")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.force(600e3, 67e-3)


def test_a_length_beyond_the_braid_is_refused_with_the_parameters_named() -> None:
    model = catalogue.get("caldwell").with_values({"thread_length": 70.0})
    with pytest.raises(PlantError, match=r"caldwell has no value at 300 kPa and 71 mm.*thread_len"):
        model.force(300e3, 71e-3, outside="ignore")


@pytest.mark.parametrize("name", NAMES)
def test_a_model_file_reads_back_to_an_equal_model(name: str, tmp_path) -> None:
    model = lively(name)
    path = tmp_path / "m.toml"
    path.write_text(catalogue.to_toml(model, "a heading"), encoding="utf-8")
    assert catalogue.load(path) == model


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("version = 1", "version = 7", "fit the model again"),
        ('unit = "mm"', 'unit = "furlong"', "cannot read 'furlong'"),
        ("[parameters.turns]", "[parameters.turn]", "missing turns; unknown turn"),
        ("low = 60.0", "low = 99.0", "outside low = 99"),
        ('law = "chou-hannaford"', 'law = "chou"', "known: chou-hannaford"),
        ("pressure_kpa = [0.0, 600.0]", "pressure_kpa = 3", "expected \\[lowest, highest\\]"),
        # Found by fuzzing: each ended in a traceback.
        ("sd = ", 'sd = "wide" # ', "sd = 'wide'; expected a number"),
        ("pressure_kpa = [0.0, 600.0]", 'pressure_kpa = [0.0, "b"]', "'b'; expected a number"),
        ('law = "chou-hannaford"', "law = [1]", "known: chou-hannaford"),
        ("[domain]", "[[domain]]", "expected a table"),
    ],
)
def test_a_bad_model_file_is_refused_with_its_key(old, new, said, tmp_path) -> None:
    text = catalogue.to_toml(catalogue.get("chou-hannaford"))
    assert old in text
    path = tmp_path / "m.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(PlantError, match=said):
        catalogue.load(path)


def test_an_unknown_model_gets_the_nearest_name() -> None:
    with pytest.raises(PlantError, match="did you mean tondu-lopez"):
        catalogue.get("tondu-lopes")


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("mm", 1e-3), ("N/(kPa mm^3)", 1e6), ("1/%", 100.0), ("N/mm", 1e3), ("kPa/mm", 1e6)],
)
def test_units_become_si(unit: str, factor: float) -> None:
    assert to_si(unit) == pytest.approx(factor)
