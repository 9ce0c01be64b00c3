"""Valve formulas against the `fluids` package and against each other."""

from __future__ import annotations

import math

import fluids
import numpy as np
import pytest
from fluids import compressible, control_valve, fittings, safety_valve
from hypothesis import given
from hypothesis import strategies as st

from plant.errors import PlantError
from plant.physics import valve_formulas as v

AIR = {"MW": 28.97, "gamma": 1.4, "Z": 1.0}


@given(st.floats(0.01, 1e3), st.floats(1e-3, 100), st.floats(1e-4, 1), st.floats(1e-6, 1e-2))
def test_reynolds_number(rho: float, speed: float, bore: float, mu: float) -> None:
    assert v.reynolds(rho, speed, bore, mu) == pytest.approx(
        fluids.Reynolds(V=speed, D=bore, rho=rho, mu=mu), rel=1e-12
    )


@given(st.floats(0.1, 20), st.floats(1e-3, 0.1), st.floats(0.1, 50))
def test_line_pressure_drop_with_darcys_factor(length: float, bore: float, speed: float) -> None:
    rho, mu = 1.2, 1.8e-5
    re = v.reynolds(rho, speed, bore, mu)
    factor = fluids.friction_factor(Re=re, eD=1e-5)
    k = fluids.K_from_f(factor, length, bore)
    expected = fluids.dP_from_K(k, rho=rho, V=speed)
    assert v.line_pressure_drop_pa(factor, length, bore, speed, rho) == pytest.approx(expected)


def test_laminar_line_obeys_hagen_and_poiseuille() -> None:
    rho, mu, bore, speed, length = 1.2, 1.8e-5, 1e-3, 1.0, 2.0
    factor = 64.0 / v.reynolds(rho, speed, bore, mu)
    expected = 32 * mu * length * speed / bore**2
    assert v.line_pressure_drop_pa(factor, length, bore, speed, rho) == pytest.approx(expected)


@given(st.floats(1e-3, 1e4))
def test_conversions_agree_with_fluids(cv: float) -> None:
    assert v.cv_to_kv(cv) == pytest.approx(fittings.Cv_to_Kv(cv), rel=2e-4)
    assert v.kv_to_cv(cv) == pytest.approx(fittings.Kv_to_Cv(cv), rel=2e-4)


@given(st.floats(1e-3, 1e4))
def test_conversions_go_round(x: float) -> None:
    assert v.kv_to_cv(v.cv_to_kv(x)) == pytest.approx(x)
    assert v.av_to_kv(v.kv_to_av(x)) == pytest.approx(x)
    assert v.av_to_cv(v.cv_to_av(x)) == pytest.approx(x)


@given(st.floats(1e-6, 1e-2), st.floats(1e3, 1e6), st.floats(600, 1400))
def test_three_coefficients_of_one_liquid_flow_convert(q: float, dp: float, rho: float) -> None:
    g = rho / v.WATER_KG_M3
    kv = v.kv_liquid(q, dp, g)
    assert v.cv_to_kv(v.cv_liquid(q, dp, g)) == pytest.approx(kv)
    assert v.kv_to_av(kv) == pytest.approx(v.av_liquid(q, dp, rho))
    assert v.liquid_flow_m3_s(v.av_liquid(q, dp, rho), dp, rho) == pytest.approx(q)


def test_liquid_kv_agrees_with_iec_60534_in_fluids() -> None:
    q, drop, rho = 0.01, 2e5, 965.4
    iec = control_valve.size_control_valve_l(
        rho=rho, Psat=70.1e3, Pc=22120e3, mu=3.15e-4, P1=680e3, P2=680e3 - drop, Q=q
    )
    assert v.kv_liquid(q, drop, rho / v.WATER_KG_M3) == pytest.approx(iec, rel=2e-3)


def test_definitions() -> None:
    assert v.cv_liquid(v.GALLON_M3 / 60, v.PSI_PA) == pytest.approx(1.0)
    assert v.kv_liquid(1 / 3600, 1e5) == pytest.approx(1.0)
    assert v.cv_to_av(1.0) == pytest.approx(24.0e-6, rel=5e-3)
    assert v.kv_to_av(1.0) == pytest.approx(27.8e-6, rel=5e-3)


# ---- gas ----------------------------------------------------------------------------------


def test_choked_gas_flow_agrees_with_iec_60534_in_fluids() -> None:
    p1, t1, c1 = 650e3, 293.15, 32.0
    rho = p1 * 0.02897 / (8.314462 * t1)
    kv = 0.05
    flow = float(v.gas_mass_flow_kg_s(v.kv_to_av(kv), p1, 101e3, rho, c1))
    q_normal = flow / (101325 * 0.02897 / (8.314462 * 273.15))
    xt = (c1 / 40.0) ** 2  # choked where the sine reaches 90 degrees: C1 = 39.76 sqrt(x_T)
    iec = control_valve.size_control_valve_g(
        T=t1, mu=1.8e-5, P1=p1, P2=101e3, Q=q_normal, xT=xt, **AIR
    )
    assert iec == pytest.approx(kv, rel=0.03)


@given(st.floats(16, 37), st.floats(0.02, 0.98), st.floats(250, 350))
def test_volume_weight_and_si_forms_are_one_equation(c1: float, drop: float, t: float) -> None:
    p1 = 6.5e5
    p2 = p1 * (1 - drop)
    rho = p1 * 0.02897 / (8.314462 * t)
    flow = 1e-3
    av = v.av_gas(flow, p1, p2, rho, c1)
    standard = 101352.9 * 0.02897 / (8.314462 * 288.706)
    by_volume = v.cv_gas_volume(flow / standard, p1, p2, t, 28.97 / 28.97, c1)
    assert by_volume == pytest.approx(v.av_to_cv(av), rel=5e-3)
    as_printed = v.cv_gas_weight(flow, p1, p2, t, 28.97, c1)
    assert as_printed / by_volume == pytest.approx(4.32 / 4.147, rel=5e-3)
    assert v.cv_gas_weight(flow, p1, p2, t, 28.97, c1, constant=4.147) == pytest.approx(
        by_volume, rel=5e-3
    )


def test_small_pressure_drop_of_gas_is_the_liquid_equation() -> None:
    p1, rho, av = 5e5, 6.0, 1e-6
    drop = 50.0
    flow = float(v.gas_mass_flow_kg_s(av, p1, p1 - drop, rho, 35.0))
    assert flow / rho == pytest.approx(v.liquid_flow_m3_s(av, drop, rho), rel=5e-3)


def test_critical_flow_no_longer_depends_on_the_outlet() -> None:
    flows = v.gas_mass_flow_kg_s(1e-6, 6e5, [2e5, 1e5, 0.0], 7.0, 30.0)
    assert flows[0] == flows[1] == flows[2]


# ---- ISO 6358 -----------------------------------------------------------------------------


def test_iso_6358_written_out() -> None:
    c, b, t = 1.25e-9, 0.5, 300.0
    up, down = np.array([6.5e5, 6.5e5, 3e5, 2e5]), np.array([1e5, 5e5, 2.5e5, 2.5e5])
    psi = np.where(
        down / up <= b, 1.0, np.sqrt(np.maximum(1 - ((down / up - b) / (1 - b)) ** 2, 0))
    )
    expected = c * 1.185 * up * np.sqrt(293.15 / t) * np.where(down >= up, 0.0, psi)
    assert np.allclose(v.iso6358_mass_flow_kg_s(c, b, up, down, t), expected, rtol=1e-12)


def test_orifice_conductance_agrees_with_fluids_choked_nozzle() -> None:
    p1, t = 5e5, 293.15
    c = v.orifice_conductance_m3_s_pa(1e-3, 1.0)
    flow = float(v.iso6358_mass_flow_kg_s(c, 0.528, p1, 1e5))
    area = safety_valve.API520_A_g(
        m=flow, T=t, Z=1.0, MW=28.9647, k=1.4, P1=p1, P2=1e5, Kd=1.0, Kb=1.0, Kc=1.0
    )
    assert area == pytest.approx(math.pi * 1e-6 / 4, rel=1e-3)
    assert compressible.P_critical_flow(p1, 1.4) / p1 == pytest.approx(0.5283, abs=1e-4)


def test_reference_bench_conductance_is_a_1_mm_orifice() -> None:
    assert v.orifice_conductance_m3_s_pa(1e-3) == pytest.approx(1.25e-9, rel=2e-3)


def test_equation_5_9() -> None:
    assert v.thesis_valve_pressure_kpa(65.0) == pytest.approx(-5.29 + 0.131 * 65**2)


def test_nonsense_is_refused_by_name() -> None:
    with pytest.raises(PlantError, match="drop_pa = 0"):
        v.cv_liquid(1e-3, 0)
    with pytest.raises(PlantError, match="pressure"):
        v.iso6358_mass_flow_kg_s(1e-9, 0.5, -1e3, 0)
    with pytest.raises(PlantError, match="between 0 and 1"):
        v.gas_mass_flow_kg_s(1e-6, 1e5, 2e5, 1.2, 30)
    with pytest.raises(PlantError, match="no pressure drop"):
        v.av_gas(1e-3, 1e5, 1e5, 1.2, 30)
