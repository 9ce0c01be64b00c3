"""The constants of a bench as parameter slots, without effects."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.physics import layout


def nominal_slots(c: PlantConstants) -> dict[int, float]:
    """What the constants alone say of gas, valves, braid and stops; see `plant.physics.layout`."""
    return {
        layout.ATMOSPHERE: c.atmosphere_pa,
        layout.GAS_TEMPERATURE: c.gas_temperature_k,
        layout.BRAID_LENGTH: c.braid_length_m,
        layout.TURNS: c.turns,
        layout.INLET_CONDUCTANCE: c.inlet_conductance_m3_s_pa,
        layout.OUTLET_CONDUCTANCE: c.outlet_conductance_m3_s_pa,
        layout.INLET_CRITICAL_RATIO: c.critical_ratio,
        layout.OUTLET_CRITICAL_RATIO: c.critical_ratio,
        layout.DEAD_VOLUME: c.dead_volume_m3,
        layout.EXPONENT: c.polytropic_exponent,
        layout.LENGTH_MIN: c.length_min_m,
        layout.LENGTH_MAX: c.length_max_m,
        layout.STOP_STIFFNESS: c.stop_stiffness_n_m,
        layout.STOP_DAMPING: c.stop_damping_n_s_m,
        layout.LOAD_DAMPING: c.load_damping_n_s_m,
        layout.DELAY_MODE: 1.0 if c.delay_mode == "transport" else 0.0,
        layout.DELAY: c.inlet_on_s,
        layout.DELAY + 1: c.inlet_off_s,
        layout.DELAY + 2: c.outlet_on_s,
        layout.DELAY + 3: c.outlet_off_s,
        layout.DELAY_SLOPE: c.inlet_on_s_per_pa,
        layout.DELAY_SLOPE + 1: c.inlet_off_s_per_pa,
        layout.DELAY_SLOPE + 2: c.outlet_on_s_per_pa,
        layout.DELAY_SLOPE + 3: c.outlet_off_s_per_pa,
    }
