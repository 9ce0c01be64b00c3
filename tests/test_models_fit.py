"""Fits: known parameters come back, intervals hold them, and what cannot be known is named."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
import statsmodels.api as sm
from scipy.stats import norm

from plant.errors import PlantError
from plant.fitting.data import Points, SensorErrors, joined
from plant.fitting.fit import fit
from plant.fitting.thesis_points import thesis_points
from plant.models import catalogue
from plant.models.law import History
from plant.models.model import OutsideDomain

STATIC = [n for n in catalogue.names() if not catalogue.get(n).law.memory]
SENSORS = {
    "pressure": SensorErrors(300.0, 0.003),
    "length": SensorErrors(2e-5, 5e-4, 0.04),
    "force": SensorErrors(0.05, 2e-4, 0.0, zero_per_trial=True),
}


def grid(warm: bool = False, lengths: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    p, x, t = np.meshgrid(
        np.array([0, 40, 80, 125, 150, 220, 300, 420, 600.0]) * 1e3,
        np.linspace(52e-3, 67e-3, lengths),
        [21.0, 27.0, 33.0, 39.0] if warm else [21.0],
        indexing="ij",
    )
    return p.ravel(), x.ravel(), t.ravel()


def made(name: str, noise: float = 0.0, seed: int = 0) -> tuple[object, Points]:
    model = catalogue.get(name)
    p, x, t = grid(model.law.uses_temperature)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideDomain)
        force = model.force(p, x, t)
    force = force + noise * np.random.default_rng(seed).normal(size=p.size)
    return model, Points(p, x, t, force, source="made up")


@pytest.mark.parametrize("name", STATIC)
def test_noiseless_points_give_the_parameters_back(name: str) -> None:
    model, points = made(name)
    part = slice(None)
    if name.endswith(("-low", "-low-t")):
        part = points.pressure_pa <= 125e3
    if name.endswith(("-high", "-high-t")):
        part = points.pressure_pa >= 150e3
    points = points if isinstance(part, slice) else points.take(part)
    away = {
        p.name: min(max(p.value * 1.04, p.low), p.high) for p in model.parameters if not p.fixed
    }
    found = fit(model.with_values(away), points)
    assert found.rmse_n < 1e-5
    for p in model.parameters:
        if found.estimate(p.name).state == "free" and not found.identifiability.weak:
            assert found.estimate(p.name).value == pytest.approx(p.value, rel=1e-4)


def test_a_linear_fit_is_what_statsmodels_says() -> None:
    c1 = thesis_points("c01")
    points = c1.take(c1.pressure_pa >= 150e3)
    found = fit(catalogue.get("quasi-static-high"), points)
    p, d = points.pressure_pa / 1e3, points.length_m * 1e3
    oracle = sm.OLS(points.force_n, np.column_stack([np.ones(p.size), p * d, p - 125])).fit()
    assert np.allclose([e.value for e in found.estimates], oracle.params, rtol=1e-7)
    assert np.allclose([e.sd for e in found.estimates], oracle.bse, rtol=1e-7)
    interval = oracle.conf_int(0.05)
    assert np.allclose([[e.low, e.high] for e in found.estimates], interval, rtol=1e-6)


def test_best_braid_for_c1_is_the_one_of_the_reference_bench() -> None:
    found = fit(catalogue.get("chou-hannaford"), thesis_points("c01"))
    assert found.estimate("braid_length").value == pytest.approx(88.37, abs=0.01)
    assert found.estimate("turns").value == pytest.approx(1.855, abs=0.001)
    assert found.rmse_n == pytest.approx(4.11, abs=0.005)


def test_a_robust_fit_stands_outliers() -> None:
    model, points = made("quasi-static", noise=0.1)
    force = points.force_n.copy()
    force[::9] += 8.0
    spoilt = dataclasses.replace(points, force_n=force)
    at = "high_kd_product"
    true = model.values[at]
    plain, robust = fit(model, spoilt), fit(model, spoilt, robust=True)
    wrong = abs(plain.estimate("low_c").value - model.values["low_c"])
    better = abs(robust.estimate("low_c").value - model.values["low_c"])
    assert better < 0.5 * wrong
    assert robust.estimate(at).value == pytest.approx(true, rel=0.03)


def test_a_robust_fit_is_statsmodels_huber_regression() -> None:
    c1 = thesis_points("c01")
    points = c1.take(c1.pressure_pa >= 150e3)
    found = fit(catalogue.get("quasi-static-high"), points, robust=True)
    p, d = points.pressure_pa / 1e3, points.length_m * 1e3
    design = np.column_stack([np.ones(p.size), p * d, p - 125])
    oracle = sm.RLM(points.force_n, design, M=sm.robust.norms.HuberT()).fit(maxiter=200, tol=1e-10)
    assert np.allclose([e.value for e in found.estimates], oracle.params, rtol=2e-3)
    assert np.allclose([e.sd for e in found.estimates], oracle.bse, rtol=0.1)


def bench(seed: int) -> Points:
    """A braid measured with drawn calibration errors and stated noise, in six trials."""
    rng = np.random.default_rng(seed)
    truth = catalogue.get("chou-hannaford").with_values({"braid_length": 88.4, "turns": 1.855})
    x, p = np.meshgrid(np.linspace(54e-3, 66e-3, 6), [1e5, 2e5, 3.5e5, 5e5, 6e5], indexing="ij")
    x, p = x.ravel(), p.ravel()
    start = np.r_[True, np.diff(x) != 0]
    trial = np.cumsum(start)
    force = truth.force(p, x, outside="ignore")
    s = SENSORS
    p_read = p + rng.normal() * s["pressure"].zero + rng.normal() * s["pressure"].gain * p
    x_read = x + rng.normal() * s["length"].zero + rng.normal() * s["length"].gain * (x - 0.04)
    f_read = force + (s["force"].zero * rng.normal(size=7))[trial] + rng.normal() * 2e-4 * force
    n = p.size
    sd = np.full(n, 200.0), np.full(n, 1e-5), np.full(n, 0.02)
    return Points(
        p_read + sd[0] * rng.normal(size=n), x_read + sd[1] * rng.normal(size=n),
        np.full(n, 21.0), f_read + sd[2] * rng.normal(size=n), *sd, sensors=SENSORS,
        path=History(None, start),
    )  # fmt: skip


def coverage(points_of, count: int) -> float:
    truth = {"braid_length": 88.4, "turns": 1.855}
    model, inside = catalogue.get("chou-hannaford"), []
    for seed in range(count):
        found = fit(model, points_of(seed))
        inside += [e.low <= truth[e.name] <= e.high for e in found.estimates]
    return float(np.mean(inside))


def test_intervals_hold_the_truth_95_times_in_100_with_calibration_errors_drawn() -> None:
    assert 0.91 <= coverage(bench, 150) <= 0.99


def test_intervals_from_the_scatter_alone_would_not() -> None:
    def blind(seed: int) -> Points:
        nothing = {"sd_pressure_pa": None, "sd_length_m": None, "sd_force_n": None}
        return dataclasses.replace(bench(seed), sensors={}, **nothing)

    assert coverage(blind, 60) < 0.7


def test_scatter_beyond_the_stated_noise_widens_the_intervals() -> None:
    honest = fit(catalogue.get("chou-hannaford"), bench(3))
    tenth = {n: getattr(bench(3), n) / 10 for n in ("sd_pressure_pa", "sd_length_m", "sd_force_n")}
    found = fit(catalogue.get("chou-hannaford"), dataclasses.replace(bench(3), **tenth))
    assert honest.noise_scale < 1.6
    assert 6 < found.noise_scale < 14
    assert found.estimate("turns").sd == pytest.approx(honest.estimate("turns").sd, rel=0.2)


# ---- what the data cannot tell ------------------------------------------------------------


def test_hasselroth_s_two_flat_directions_are_named() -> None:
    model, points = made("hasselroth", noise=0.1)
    found = fit(model, points, free=("diameter", "gain", "offset", "rest_length"))
    assert len(found.identifiability.flat) == 2
    assert all(e.state == "flat" and e.high == np.inf for e in found.estimates)
    words = " ".join(found.identifiability.lines())
    assert "does not change the force" in words
    for direction in found.identifiability.flat:
        moved = {n: model.values[n] * (1 + 1e-3 * c / 0.01) for n, c in direction.changes}
        changed = found.model.with_values(
            {n: found.model.values[n] * v / model.values[n] for n, v in moved.items()}
        )
        before = found.model.force(300e3, 60e-3)
        assert changed.force(300e3, 60e-3) == pytest.approx(float(before), rel=1e-5)


def test_what_is_determined_keeps_its_interval_beside_a_flat_direction() -> None:
    model, points = made("hasselroth", noise=0.1)
    found = fit(model, points, free=("diameter", "gain", "offset"))
    assert found.estimate("offset").state == "free"
    assert found.estimate("gain").state == "flat"
    alone = fit(model, points, free=("gain", "offset"))
    assert found.estimate("offset").sd == pytest.approx(alone.estimate("offset").sd, rel=0.02)


def test_hysteresis_in_length_is_dead_in_an_isometric_test() -> None:
    c4 = thesis_points("c04")
    found = fit(catalogue.get("maxwell-slip"), c4)
    assert set(found.identifiability.dead) == {"slip_100_um", "slip_300_um", "slip_1000_um"}
    assert "no point depends on it" in " ".join(found.identifiability.lines())


def test_a_parameter_at_its_bound_is_said_to_be_there() -> None:
    found = fit(catalogue.get("tondu-lopez"), thesis_points("c01"))
    assert found.identifiability.at_bound == ("end_factor",)
    assert found.estimate("end_factor").state == "at bound"


def test_one_length_cannot_tell_b_from_n() -> None:
    p = np.linspace(1e5, 6e5, 12)
    model = catalogue.get("chou-hannaford")
    force = model.force(p, 60e-3) + 0.01 * np.sin(p)
    found = fit(model, Points(p, np.full(12, 60e-3), np.full(12, 21.0), force))
    assert len(found.identifiability.flat) == 1
    assert {e.state for e in found.estimates} == {"flat"}


# ---- data, files, errors --------------------------------------------------------------------


def test_a_fitted_model_knows_its_data_and_domain() -> None:
    points = thesis_points("c01")
    model = fit(catalogue.get("chou-hannaford"), points).model
    assert model.data_sha256 == points.sha256()
    assert model.domain.length_mm == (51.45, 67.0)
    assert model.parameter("turns").sd == pytest.approx(0.021, abs=0.002)
    changed = dataclasses.replace(points, force_n=points.force_n + 1e-9)
    assert changed.sha256() != points.sha256()


@pytest.mark.parametrize("name", STATIC)
def test_shipped_values_are_the_fit_to_the_named_thesis_table(name: str) -> None:
    model = catalogue.get(name)
    points = thesis_points("c01", warm=name.endswith("-t"))
    if "-low" in name:
        points = points.take(points.pressure_pa <= 125e3)
    if "-high" in name:
        points = points.take(points.pressure_pa >= 150e3)
    assert model.data_sha256 == points.sha256()
    again = fit(model, points)
    old = model.law.force(model.q, points.pressure_pa, points.length_m, points.temperature_c)
    assert np.std(points.force_n - old) <= again.rmse_n * (1 + 1e-5) + 1e-9 or name in (
        "caldwell", "chou-hannaford", "hasselroth", "tondu-lopez", "tondu-lopez-kp",
    )  # fmt: skip
    assert np.sqrt(np.mean((points.force_n - old) ** 2)) == pytest.approx(again.rmse_n, rel=1e-4)


def test_too_few_points_and_unknown_parameters_are_refused() -> None:
    points = thesis_points("c01")
    few = points.take(np.arange(224) < 3)
    with pytest.raises(PlantError, match=r"6 free parameters and .* 3 points"):
        fit(catalogue.get("quasi-static"), few)
    with pytest.raises(PlantError, match="no parameter 'turn'"):
        fit(catalogue.get("chou-hannaford"), points, free=("turn",))


def test_start_values_whose_geometry_cannot_hold_the_data_are_refused() -> None:
    points = thesis_points("c01")
    model = catalogue.get("caldwell")
    wide = [dataclasses.replace(p, low=0.0) for p in model.parameters]
    model = dataclasses.replace(model, parameters=tuple(wide))
    with pytest.raises(PlantError, match="use start values"):
        fit(model.with_values({"thread_length": 60.0}), points)


def test_a_model_with_memory_wants_the_order_of_the_points() -> None:
    with pytest.raises(PlantError, match="no order of points"):
        fit(catalogue.get("maxwell-slip"), thesis_points("c01"))


def test_points_that_are_no_numbers_are_refused() -> None:
    bad = np.array([1.0, np.nan])
    with pytest.raises(PlantError, match="force_n has"):
        Points(np.ones(2), np.ones(2), np.ones(2), bad)


def test_joined_points_start_a_new_trial_at_each_part() -> None:
    a, b = thesis_points("c04"), thesis_points("c06")
    both = joined([a, b])
    assert len(both) == len(a) + len(b)
    assert both.trials()[0] == 1
    assert both.trials()[len(a)] == a.trials()[-1] + 1


# ---- memory ---------------------------------------------------------------------------------


def test_prandtl_ishlinskii_weights_come_back_from_a_cycle() -> None:
    model = catalogue.get("prandtl-ishlinskii")
    true = {"play_25_kpa": 0.01, "play_50_kpa": 0.004, "play_100_kpa": 0.006, "play_200_kpa": 0.002}
    model = model.with_values(true)
    up = np.linspace(0, 600e3, 25)
    p = np.tile(np.r_[up, up[::-1]], 4)
    x = np.repeat([54e-3, 58e-3, 62e-3, 66e-3], 50)
    path = History(None, np.r_[True, np.diff(x) != 0])
    force = model.force(p, x, path=path, outside="ignore") + 0.02 * np.random.default_rng(1).normal(
        size=p.size
    )
    found = fit(model, Points(p, x, np.full(p.size, 21.0), force, path=path))
    for name, value in true.items():
        e = found.estimate(name)
        assert e.low < value < e.high
        assert e.sd < 0.002


def test_a_play_loop_is_as_high_as_weight_times_twice_its_half_width() -> None:
    model = catalogue.get("prandtl-ishlinskii")
    off = {p.name: 0.0 for p in model.parameters if p.name.startswith("play")}
    model = model.with_values(off | {"play_50_kpa": 0.01})
    up = np.arange(0.0, 601e3, 10e3)
    force = model.force(np.r_[up, up[::-1]], 60e-3)
    n = up.size
    gap = force[n:][::-1] - force[:n]
    assert gap[up == 300e3][0] == pytest.approx(2 * 0.01 * 50.0)


def test_maxwell_slip_dissipates_in_a_length_cycle() -> None:
    model = catalogue.get("maxwell-slip").with_values({"slip_300_um": 2.0})
    x = 60e-3 + 2e-3 * np.sin(np.linspace(0, 4 * np.pi, 4001))
    force = model.force(400e3, x)
    second = slice(2000, 4001)
    work = np.trapezoid(force[second], x[second])
    # A full loop of an elasto-slip element: 4 f (amplitude - f / k), f = k travel.
    f = 2.0 * 0.3
    assert work == pytest.approx(4 * f * (2.0 - 0.3) * 1e-3, rel=2e-3)


def test_creep_reaches_the_static_force_after_a_step() -> None:
    model = catalogue.get("creep").with_values({"late_2_s": 0.1, "late_20_s": 0.05})
    time_s = np.linspace(0, 200, 2001)
    p = np.where(time_s < 1e-9, 200e3, 400e3)
    p[1] = 400e3
    force = model.force(p, 60e-3, path=History(time_s))
    static = catalogue.get("quasi-static").force([200e3, 400e3], 60e-3)
    at = float(np.interp(2.0, time_s, force))
    expected = static[1] - (static[1] - static[0]) * (0.1 * np.exp(-1) + 0.05 * np.exp(-0.1))
    assert at == pytest.approx(float(expected), rel=2e-3)
    assert force[-1] == pytest.approx(float(static[1]), rel=1e-5)
    with pytest.raises(PlantError, match="needs the time"):
        model.force(p, 60e-3)


def test_normal_quantile_is_used_where_noise_is_stated() -> None:
    e = fit(catalogue.get("chou-hannaford"), bench(1)).estimate("turns")
    assert (e.high - e.low) / (2 * e.sd) == pytest.approx(norm.ppf(0.975))
