"""Firmware parameters from the constants of a simulated bench: what a data sheet would give.

The burst scheme wants the valve's delays, the supply, and how fast each orifice moves the pressure
in the muscle. On a real bench the first come from the switching capture and the last from one long
fill and one long vent (docs/reference/valve-schemes.md).
"""

from __future__ import annotations

from plant.constants import GAS_CONSTANT_J_KG_K, REFERENCE_DENSITY_KG_M3, PlantConstants
from plant.physics.muscle import braid_volume

FULL_SCALE_KPA = 1000.0
TOP = 4095
DEAD_SHARE = 0.0014
THESIS_DEAD_SHARE = 0.013


def burst_parameters(
    c: PlantConstants, length_mm: float = 60.0, full_scale_kpa: float = FULL_SCALE_KPA
) -> dict[str, int]:
    """``valve_*``, ``gas_*`` and ``burst_*`` for a muscle held at ``length_mm``.

    The dead zone is 0.14 % of supply, or an eighth of the effect of the shortest fill if that is
    larger, up to 1.3 %.
    """
    volume_m3 = float(braid_volume(length_mm * 1e-3, c.braid_length_m, c.turns)) + c.dead_volume_m3
    # At the reference temperature; the shares go with its root, 1 % for 6 K.
    bar_pa = GAS_CONSTANT_J_KG_K * c.gas_temperature_k * REFERENCE_DENSITY_KG_M3
    per_kpa = TOP / full_scale_kpa

    def ppm_per_ms(conductance: float) -> int:
        return round(conductance * bar_pa / volume_m3 * 1e3)

    def us(delay_s: float, slope_s_per_pa: float, kpa: float) -> int:
        return round((delay_s + slope_s_per_pa * kpa * 1e3) * 1e6)

    rate_in = ppm_per_ms(c.inlet_conductance_m3_s_pa)
    off_in = us(c.inlet_off_s, c.inlet_off_s_per_pa, c.supply_pa * 1e-3)
    shortest = rate_in * 1e-6 * off_in * 1e-3 * (c.supply_pa + c.atmosphere_pa) / c.supply_pa
    dead = min(THESIS_DEAD_SHARE, max(DEAD_SHARE, shortest / 8))
    return {
        "valve_on_in_us": us(c.inlet_on_s, c.inlet_on_s_per_pa, c.supply_pa * 1e-3),
        "valve_off_in_us": off_in,
        "valve_on_out_us": us(c.outlet_on_s, c.outlet_on_s_per_pa, 0.0),
        "valve_on_out_top_us": us(c.outlet_on_s, c.outlet_on_s_per_pa, full_scale_kpa),
        "valve_off_out_us": us(c.outlet_off_s, c.outlet_off_s_per_pa, 0.0),
        "valve_off_out_top_us": us(c.outlet_off_s, c.outlet_off_s_per_pa, full_scale_kpa),
        "gas_supply": round(c.supply_pa * 1e-3 * per_kpa),
        "gas_atm": round(c.atmosphere_pa * 1e-3 * per_kpa),
        "gas_rate_in": rate_in,
        "gas_rate_out": ppm_per_ms(c.outlet_conductance_m3_s_pa),
        "burst_dead_x16": round(dead * c.supply_pa * 1e-3 * per_kpa * 16),
    }


def safety_parameters(c: PlantConstants, full_scale_kpa: float = FULL_SCALE_KPA) -> dict[str, int]:
    """``slew`` for the smallest chamber this muscle makes, a third above its fastest change."""
    smallest = float(braid_volume(c.length_max_m, c.braid_length_m, c.turns)) + c.dead_volume_m3
    fastest = max(c.inlet_conductance_m3_s_pa, c.outlet_conductance_m3_s_pa)
    bar_pa = GAS_CONSTANT_J_KG_K * c.gas_temperature_k * REFERENCE_DENSITY_KG_M3
    kpa_per_ms = fastest * bar_pa / smallest * (c.supply_pa + c.atmosphere_pa) * 1e-6
    return {"slew": max(4, round(1.33 * kpa_per_ms * TOP / full_scale_kpa))}
