"""Effects as the numbers that the compiled bench takes: parameter slots over the nominal ones."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.physics import additions, layout

EDGES = ("inlet_on", "inlet_off", "outlet_on", "outlet_off")
"""The four delays, in the order of `layout.DELAY`."""
MUSCLE = (
    "fibre_stretch",
    "end_cap",
    "bladder_elasticity",
    "contraction_limit",
    "viscosity",
    "temperature_stiffening",
    "wear",
)
"""Effects behind `layout.MUSCLE_ADDITIONS`."""

Slots = dict[int, float]


def effect_slots(c: PlantConstants, effects: Effects) -> Slots:
    """Slots of the parameter array that differ from those of the nominal bench `c`.

    Effects on sensors (`plant.simulator.readings`) and on the label of the length leave no mark
    here, but for the lag of the pressure reading. Raises `PlantError` where an effect cannot be.
    """
    slots = {**_muscle(c, effects), **_gas(c, effects), **_load(effects)}
    slots[layout.PRESSURE_LAG] = effects.get("pressure_lag", "time_ms") * 1e-3
    if slots[layout.PRESSURE_LAG] > 0.0 or slots.get(layout.CREEP_GAIN, 0.0) != 0.0:
        slots[layout.REMEMBERS] = 1.0
    return slots


def _muscle(c: PlantConstants, on: Effects) -> Slots:
    slots = {
        layout.LINER_LOST: on.get("liner_threshold", "threshold_kpa") * 1e3,
        layout.LINER_WIDTH: on.get("liner_threshold", "width_kpa", 1.0) * 1e3,
        layout.FRICTION_FORCE: on.get("braid_friction", "friction_n"),
        layout.FRICTION_TRAVEL_PRESSURE: on.get("braid_friction", "travel_kpa", 1.0) * 1e3,
        layout.FRICTION_TRAVEL_LENGTH: on.get("braid_friction", "travel_mm", 1.0) * 1e-3,
        layout.MUSCLE_ADDITIONS: 1.0 if any(name in on for name in MUSCLE) else 0.0,
    }
    percent = on.get("fibre_stretch", "stretch_percent")
    slots[layout.STRETCH] = percent / 100.0 / additions.STRETCH_PRESSURE_PA
    rest = on.get("end_cap", "rest_mm", 72.5) * 1e-3
    slots[layout.CAP_REST] = rest
    slots[layout.CAP_SHARE] = additions.cap_share(on.get("end_cap", "shortening_mm") * 1e-3, rest)
    slots[layout.BLADDER] = on.get("bladder_elasticity", "stiffness_n_mm") * 1e3
    slots[layout.BLADDER_REST] = on.get("bladder_elasticity", "rest_mm") * 1e-3
    slots[layout.BLADDER_HARDENING] = on.get("bladder_elasticity", "hardening_per_mm2") * 1e6
    slots[layout.LIMIT_FORCE] = on.get("contraction_limit", "force_n")
    slots[layout.LIMIT_SCALE] = on.get("contraction_limit", "scale_mm", 1.0) * 1e-3
    slots[layout.VISCOUS] = on.get("viscosity", "damping_n_s_mm") * 1e3
    slots[layout.VISCOUS_EXPONENT] = on.get("viscosity", "exponent", 1.0)
    slots[layout.VISCOUS_PRESSURE] = on.get("viscosity", "pressure_share")
    slots[layout.WARMING] = on.get("temperature_stiffening", "percent_per_k") / 100.0
    slots[layout.WARMING_FROM] = on.get("temperature_stiffening", "reference_c") + 273.15
    slots[layout.WARMING_FLAT] = on.get("temperature_stiffening", "flat_share")
    slots[layout.WEAR] = on.get("wear", "percent_per_100_trials") / 1e4
    if "creep" in on:
        fast, slow = on.get("creep", "fast_s"), on.get("creep", "slow_s")
        if not fast < slow:
            raise PlantError(f"effect 'creep': fast_s = {fast:g} must be below slow_s = {slow:g}")
        relaxation = on.get("creep", "relaxation_percent") / 100.0
        slots[layout.CREEP_GAIN] = additions.creep_gain(relaxation, fast, slow)
        for i, time in enumerate(additions.creep_times(fast, slow)):
            slots[layout.CREEP_TIME + i] = float(time)
    del c
    return slots


def _gas(c: PlantConstants, on: Effects) -> Slots:
    slots: Slots = {layout.LEAK_CONDUCTANCE: on.get("leak", "conductance_m3_s_pa")}
    if "dead_volume" in on:
        slots[layout.DEAD_VOLUME] = c.dead_volume_m3 + on.get("dead_volume", "volume_ml") * 1e-6
    if "polytropic" in on:
        slots[layout.EXPONENT] = on.get("polytropic", "exponent")
    if "flow_area" in on:
        ratio = on.get("flow_area", "ratio")
        if on.word("flow_area", "side") == "inlet":
            slots[layout.INLET_CONDUCTANCE] = ratio * c.inlet_conductance_m3_s_pa
        else:
            slots[layout.OUTLET_CONDUCTANCE] = ratio * c.outlet_conductance_m3_s_pa
    if "critical_ratio" in on:
        ratio = on.get("critical_ratio", "critical_ratio")
        slots[layout.INLET_CRITICAL_RATIO] = slots[layout.OUTLET_CRITICAL_RATIO] = ratio
    slots[layout.SUPPLY_DROOP] = on.get("supply_droop", "droop_kpa") * 1e3
    delays = (c.inlet_on_s, c.inlet_off_s, c.outlet_on_s, c.outlet_off_s)
    if "valve_delay" in on:
        edge = EDGES.index(on.word("valve_delay", "edge"))
        slots[layout.DELAY + edge] = delays[edge] + on.get("valve_delay", "delay_ms") * 1e-3
    per_pa = (
        c.inlet_on_s_per_pa,
        c.inlet_off_s_per_pa,
        c.outlet_on_s_per_pa,
        c.outlet_off_s_per_pa,
    )
    if "valve_delay_pressure" in on:
        edge = EDGES.index(on.word("valve_delay_pressure", "edge"))
        extra = on.get("valve_delay_pressure", "slope_ms_per_kpa") * 1e-6
        slots[layout.DELAY_SLOPE + edge] = per_pa[edge] + extra
    if "transport_delay" in on:
        slots[layout.DELAY_MODE] = 1.0
    return slots


def _load(on: Effects) -> Slots:
    return {
        layout.EXTRA_MASS: on.get("payload", "mass_kg"),
        layout.LINK_FRICTION: on.get("link_friction", "friction_n"),
        layout.LINK_TRAVEL: on.get("link_friction", "travel_mm", 1.0) * 1e-3,
    }
