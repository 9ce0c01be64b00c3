"""Valve formulas of section 5.1.2: friction in a line, flow coefficients and ISO 6358.

Everything is SI (Pa absolute where a gas is concerned, kg/s, m3/s, K); the coefficients keep the
units that define them. Of the printed equations, 5-1 mixes SI with the foot-pound form's 2 g and
144 (A68), and 5-4 has lost "3417 / (C1 C2) sqrt" within its sine; both are given here as they
must be. 5-5's constant 4.32 disagrees with 5-4 by 4 %: 4.15 follows from 5-4, and from 5-8.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    REFERENCE_DENSITY_KG_M3,
    REFERENCE_TEMPERATURE_K,
)
from plant.errors import PlantError
from plant.physics.flow import mass_flow_kg_s
from plant.thesis import load

GALLON_M3 = 231.0 * 0.0254**3
PSI_PA = 0.45359237 * 9.80665 / 0.0254**2
POUND_KG = 0.45359237
CUBIC_FOOT_M3 = 0.3048**3
BAR_PA = 1e5
WATER_KG_M3 = 1000.0
"""Density against which specific gravity counts in C_v and K_v."""
UNIVERSAL_DEGREES = 3417.0
"""Constant of the universal gas sizing equation's sine (5-4, 5-5, 5-8), degrees."""
HEAT_RATIO_AIR = 1.4


def reynolds(
    density_kg_m3: float, speed_m_s: float, diameter_m: float, viscosity_pa_s: float
) -> float:
    """Reynolds number rho v D / mu (5-2)."""
    _positive(density_kg_m3=density_kg_m3, diameter_m=diameter_m, viscosity_pa_s=viscosity_pa_s)
    return density_kg_m3 * abs(speed_m_s) * diameter_m / viscosity_pa_s


def line_pressure_drop_pa(
    friction: float, length_m: float, diameter_m: float, speed_m_s: float, density_kg_m3: float
) -> float:
    """Pressure drop f (L / D) rho v^2 / 2 (5-1 in SI).

    In this form f is Darcy's factor, four times the one usually named after Fanning: 64 / Re for
    laminar flow.
    """
    _positive(length_m=length_m, diameter_m=diameter_m, density_kg_m3=density_kg_m3)
    return friction * length_m / diameter_m * density_kg_m3 * speed_m_s**2 / 2.0


# ---- liquid -----------------------------------------------------------------------------


def cv_liquid(flow_m3_s: float, drop_pa: float, specific_gravity: float = 1.0) -> float:
    """C_v = Q sqrt(G / dP) in US gallons a minute and psi (5-3); not viscous, not cavitating."""
    _positive(drop_pa=drop_pa, specific_gravity=specific_gravity)
    gallons_min = flow_m3_s / GALLON_M3 * 60.0
    return gallons_min * math.sqrt(specific_gravity / (drop_pa / PSI_PA))


def kv_liquid(flow_m3_s: float, drop_pa: float, specific_gravity: float = 1.0) -> float:
    """K_v = Q sqrt(G / dP) in m3/h and bar (5-6)."""
    _positive(drop_pa=drop_pa, specific_gravity=specific_gravity)
    return flow_m3_s * 3600.0 * math.sqrt(specific_gravity / (drop_pa / BAR_PA))


def av_liquid(flow_m3_s: float, drop_pa: float, density_kg_m3: float) -> float:
    """A_v = Q sqrt(rho / dP) in m2 (5-7)."""
    _positive(drop_pa=drop_pa, density_kg_m3=density_kg_m3)
    return flow_m3_s * math.sqrt(density_kg_m3 / drop_pa)


def liquid_flow_m3_s(av_m2: float, drop_pa: float, density_kg_m3: float) -> float:
    """Q of 5-7 the other way round; flows back for a negative drop."""
    _positive(density_kg_m3=density_kg_m3)
    return math.copysign(av_m2 * math.sqrt(abs(drop_pa) / density_kg_m3), drop_pa)


# ---- conversions ------------------------------------------------------------------------


def cv_to_kv(cv: float) -> float:
    """K_v of the same valve: 0.865 C_v."""
    return cv * GALLON_M3 * 60.0 * math.sqrt(BAR_PA / PSI_PA)


def kv_to_cv(kv: float) -> float:
    """C_v of the same valve: 1.156 K_v."""
    return kv / cv_to_kv(1.0)


def kv_to_av(kv: float) -> float:
    """A_v in m2: 28e-6 K_v."""
    return kv / 3600.0 * math.sqrt(WATER_KG_M3 / BAR_PA)


def av_to_kv(av_m2: float) -> float:
    """K_v of the same valve."""
    return av_m2 / kv_to_av(1.0)


def cv_to_av(cv: float) -> float:
    """A_v in m2: 24e-6 C_v."""
    return kv_to_av(cv_to_kv(cv))


def av_to_cv(av_m2: float) -> float:
    """C_v of the same valve."""
    return kv_to_cv(av_to_kv(av_m2))


# ---- gas --------------------------------------------------------------------------------


def subcritical_factor(drop_ratio: npt.ArrayLike, c1: float, c2: float = 1.0) -> Array:
    """Y = sin(3417 / (C1 C2) sqrt(dP / P1)) degrees, 1 once the flow is critical (with 5-8).

    `drop_ratio` is dP / P1, 0 to 1; C1 the valve's gas flow factor (16 to 37), C2 corrects for
    the ratio of specific heats (1 for air).
    """
    _positive(c1=c1, c2=c2)
    ratio = np.asarray(drop_ratio, dtype=np.float64)
    if np.any((ratio < 0) | (ratio > 1)):
        raise PlantError("pressure drop over inlet pressure must lie between 0 and 1")
    degrees = np.minimum(UNIVERSAL_DEGREES / (c1 * c2) * np.sqrt(ratio), 90.0)
    return np.asarray(np.sin(np.radians(degrees)))


def gas_mass_flow_kg_s(
    av_m2: float,
    inlet_pa: float,
    outlet_pa: npt.ArrayLike,
    density_kg_m3: float,
    c1: float,
    c2: float = 1.0,
) -> Array:
    """Mass flow of a gas, W = 1.67e-2 A_v C1 C2 Y sqrt(rho1 P1) (5-8); pressures absolute."""
    _positive(inlet_pa=inlet_pa, density_kg_m3=density_kg_m3)
    drop = (inlet_pa - np.asarray(outlet_pa, dtype=np.float64)) / inlet_pa
    y = subcritical_factor(drop, c1, c2)
    return np.asarray(1.67e-2 * av_m2 * c1 * c2 * y * math.sqrt(density_kg_m3 * inlet_pa))


def av_gas(
    mass_flow_kg_s: float,
    inlet_pa: float,
    outlet_pa: float,
    density_kg_m3: float,
    c1: float,
    c2: float = 1.0,
) -> float:
    """A_v in m2 of a valve that passes a gas flow (5-8)."""
    one = gas_mass_flow_kg_s(1.0, inlet_pa, outlet_pa, density_kg_m3, c1, c2)
    if not float(one) > 0:
        raise PlantError("no pressure drop: a flow coefficient cannot be told from no flow")
    return mass_flow_kg_s / float(one)


def cv_gas_volume(
    flow_m3_s: float,
    inlet_pa: float,
    outlet_pa: float,
    temperature_k: float,
    specific_gravity: float,
    c1: float,
    c2: float = 1.0,
) -> float:
    """C_v from the volume flow of a gas at 14.7 psi and 60 degF (5-4, its sine completed)."""
    _positive(inlet_pa=inlet_pa, temperature_k=temperature_k, specific_gravity=specific_gravity)
    y = float(subcritical_factor((inlet_pa - outlet_pa) / inlet_pa, c1, c2))
    feet_h = flow_m3_s / CUBIC_FOOT_M3 * 3600.0
    root = math.sqrt(289.0 / (specific_gravity * temperature_k))
    return feet_h / (root * c1 * c2 * (inlet_pa / PSI_PA) * y)


def cv_gas_weight(
    mass_flow_kg_s: float,
    inlet_pa: float,
    outlet_pa: float,
    temperature_k: float,
    molar_mass_g_mol: float,
    c1: float,
    c2: float = 1.0,
    constant: float = 4.32,
) -> float:
    """C_v from the mass flow of a gas (5-5, as printed: constant 4.32 where 5-4 gives 4.15)."""
    _positive(inlet_pa=inlet_pa, temperature_k=temperature_k, molar_mass_g_mol=molar_mass_g_mol)
    y = float(subcritical_factor((inlet_pa - outlet_pa) / inlet_pa, c1, c2))
    pounds_h = mass_flow_kg_s / POUND_KG * 3600.0
    top = constant * pounds_h * math.sqrt(temperature_k)
    return top / (c1 * c2 * (inlet_pa / PSI_PA) * math.sqrt(molar_mass_g_mol) * y)


# ---- ISO 6358 ---------------------------------------------------------------------------


def iso6358_mass_flow_kg_s(
    conductance_m3_s_pa: float,
    critical_ratio: float,
    upstream_pa: npt.ArrayLike,
    downstream_pa: npt.ArrayLike,
    temperature_k: float = REFERENCE_TEMPERATURE_K,
) -> Array:
    """Mass flow through a valve of sonic conductance C and critical ratio b; pressures absolute.

    No flow where the downstream pressure is the higher one: ask with the two exchanged.
    """
    _positive(conductance_m3_s_pa=conductance_m3_s_pa, temperature_k=temperature_k)
    flow = np.vectorize(mass_flow_kg_s, otypes=[np.float64])
    return np.asarray(
        flow(upstream_pa, downstream_pa, conductance_m3_s_pa, critical_ratio, temperature_k)
    )


def orifice_conductance_m3_s_pa(diameter_m: float, discharge: float = 0.8) -> float:
    """Sonic conductance of a sharp orifice: an ideal nozzle of the area, times `discharge`."""
    _positive(diameter_m=diameter_m, discharge=discharge)
    g = HEAT_RATIO_AIR
    choked = math.sqrt(g * (2.0 / (g + 1.0)) ** ((g + 1.0) / (g - 1.0)))
    speed = math.sqrt(GAS_CONSTANT_J_KG_K * REFERENCE_TEMPERATURE_K)
    area = math.pi * diameter_m**2 / 4.0
    return discharge * area * choked / (speed * REFERENCE_DENSITY_KG_M3)


# ---- the thesis's own valve -------------------------------------------------------------


def thesis_valve_pressure_kpa(speed_m_s: npt.ArrayLike) -> Array:
    """Equation 5-9: gauge pressure before the valve from the speed of the air after it.

    Fitted to 0 to 600 kPa and 0 to 67 m/s (Table D-5); its constant of -5.29 kPa is not
    significant and makes it negative below 6.4 m/s.
    """
    rows = {str(r["term"]): r["coefficient"] for r in load("equations_as_printed")
            if str(r["equation"]) == "5-9"}  # fmt: skip
    v = np.asarray(speed_m_s, dtype=np.float64)
    return np.asarray(float(str(rows["1"])) + float(str(rows["V^2"])) * v * v)


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not value > 0:
            raise PlantError(f"{name} = {value!r}; must be a number above 0")
