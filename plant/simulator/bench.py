"""One bench in simulation: muscle, valve block or regulator, and what holds the muscle."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from plant.arrays import Array
from plant.constants import STANDARD_GRAVITY_M_S2, PlantConstants
from plant.effects.effects import NONE, Effects
from plant.effects.reference import TEMPERATURE_C as REFERENCE_TEMPERATURE_C
from plant.errors import PlantError
from plant.physics import layout
from plant.physics.layout import (
    FORCE,
    INLET_COMMAND,
    INLET_OPEN,
    LENGTH,
    LENGTH_RATE,
    OUTLET_COMMAND,
    OUTLET_OPEN,
    PRESSURE,
    REGULATOR_SET,
    SUPPLY,
    TIME,
    nominal_slots,
)
from plant.physics.muscle import braid_volume
from plant.simulator import hooks
from plant.simulator.kernel import advance as _advance
from plant.simulator.rates import LEAST_MASS_KG

Source = Literal["valve", "regulator"]
Load = Literal["isometric", "isotonic"]

REGULATOR_LAG_S = 1.0
REGULATOR_MAX_PA = 700e3
STEP_MAX_S = 1e-3
STEP_SAFETY = 0.3
FINE_STEP_SHARE = 1.0 / 16.0
"""Of the usual step, for closed loops. For recorded commands the usual one is fine enough, but a
controller that reads counts turns the method's error into another pulse wherever a reading lies
that close to the edge of a count. At this step hardly one reading of a hundred thousand does, and
halving it changes no figure."""

advance = _advance
"""`advance(state, params, dt_s, inlet_on_s, vent_on_s)`: one control tick, in place, compiled.

Fill is commanded for the first `inlet_on_s` of the tick, vent for the first `vent_on_s`; a value of
at least `dt_s` keeps the command on at the end of the tick, so that it goes on without an edge if
the next tick begins with it.
"""


def build_params(
    constants: PlantConstants,
    effects: Effects = NONE,
    source: Source = "valve",
    load: Load = "isometric",
    mass_kg: float = 1.0,
) -> Array:
    """Parameter array of the kernel, shape (PARAMS_SIZE,), with the effects in. `PlantError`."""
    if source not in ("valve", "regulator"):
        raise PlantError(f"source = {source!r}; allowed 'valve' or 'regulator'")
    if load not in ("isometric", "isotonic"):
        raise PlantError(f"load = {load!r}; allowed 'isometric' or 'isotonic'")
    if not 1e-3 <= mass_kg <= 1e3:
        raise PlantError(f"mass_kg = {mass_kg!r}; allowed 0.001 to 1000")
    effects.check_actuator(constants)
    at = {
        **nominal_slots(constants),
        layout.SOURCE: 1.0 if source == "regulator" else 0.0,
        layout.LOAD: 1.0 if load == "isotonic" else 0.0,
        layout.MASS: mass_kg,
        layout.GRAVITY: STANDARD_GRAVITY_M_S2,
        layout.REGULATOR_LAG: REGULATOR_LAG_S,
        layout.STEP_MAX: STEP_MAX_S,
        layout.STEP_SAFETY: STEP_SAFETY,
    }
    params = np.zeros(layout.PARAMS_SIZE)
    for slot, value in {**at, **effect_slots(constants, effects)}.items():
        params[slot] = value
    if load == "isotonic":
        _check_carried(mass_kg, params, effects)
    return params


def _check_carried(mass_kg: float, params: Array, effects: Effects) -> None:
    carried = mass_kg
    for effect, _ in effects.active():
        if effect.plant.mass is not None:
            carried = effect.plant.mass(carried, params)
            if not carried >= LEAST_MASS_KG:
                raise PlantError(
                    f"effect {effect.id!r}: {carried - mass_kg:g} kg beside a load of "
                    f"{mass_kg:g} kg carries nothing"
                )


def build_state(
    constants: PlantConstants,
    length_m: float,
    temperature_c: float = REFERENCE_TEMPERATURE_C,
    trials: float = 0.0,
) -> Array:
    """State array of a bench without power at time 0: atmospheric, at rest, shape (STATE_SIZE,).

    `temperature_c` is that of the muscle's wall, `trials` what it has behind it; both matter only
    to the effects that depend on them. A normally open outlet is open and its vent command on, as
    when power has been off.
    """
    _check_length(length_m, constants)
    state = np.zeros(layout.STATE_SIZE)
    state[LENGTH] = length_m
    state[SUPPLY] = constants.supply_pa
    state[layout.TEMPERATURE] = temperature_c + 273.15
    state[layout.TRIAL] = trials
    if constants.outlet_normally == "open":
        state[OUTLET_OPEN] = state[OUTLET_COMMAND] = state[layout.SPOOL + 1] = 1.0
    return state


class BenchSim:
    """A bench that is advanced tick by tick under valve commands.

    `state` and `params` are the arrays of the kernel (`plant.physics.layout` names the slots);
    hand them to the module function `advance` where the cost of a method call matters. With
    `load="isometric"` the length is prescribed (`set_length`, `set_length_rate` for a moving
    stage); with "isotonic" a mass hangs on the muscle and its length follows. With
    `source="regulator"` an open inlet lets the muscle follow `set_regulator` with a lag of 1 s as
    long as the outlet is shut. Substeps are `step_share` of the usual ones.
    """

    def __init__(
        self,
        constants: PlantConstants,
        effects: Effects | None = None,
        source: Source = "valve",
        load: Load = "isometric",
        length_m: float = 0.060,
        mass_kg: float = 1.0,
        step_share: float = 1.0,
    ) -> None:
        self.constants = constants
        self.effects = effects or NONE
        self.load: Load = load
        self.params = build_params(constants, self.effects, source, load, mass_kg)
        self.params[layout.STEP_MAX] *= step_share
        self.params[layout.STEP_SAFETY] *= step_share
        self.state = build_state(constants, length_m)
        self._advance: Any = advance
        self._refresh()

    def advance(self, dt_s: float, inlet_on_s: float = 0.0, vent_on_s: float = 0.0) -> None:
        """Advance by one tick; see the module's `advance`."""
        self._advance(self.state, self.params, dt_s, inlet_on_s, vent_on_s)

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return float(self.state[TIME])

    @property
    def pressure_kpa(self) -> float:
        """True gauge pressure in the muscle."""
        return float(self.state[PRESSURE]) * 1e-3

    @property
    def pressure_read_kpa(self) -> float:
        """Gauge pressure behind the transducer's lag, which is the true one without a lag."""
        lagging = self.params[layout.PRESSURE_LAG] > 0.0
        return float(self.state[layout.PRESSURE_READ if lagging else PRESSURE]) * 1e-3

    @property
    def length_mm(self) -> float:
        """True length of the muscle."""
        return float(self.state[LENGTH]) * 1e3

    @property
    def force_n(self) -> float:
        """True pull of the muscle."""
        return float(self.state[FORCE])

    @property
    def inlet_open(self) -> bool:
        """Whether the inlet valve itself is open, delays included."""
        return bool(self.state[INLET_OPEN])

    @property
    def outlet_open(self) -> bool:
        """Whether the outlet valve itself is open, delays included."""
        return bool(self.state[OUTLET_OPEN])

    def set_pressure(self, pressure_kpa: float) -> None:
        """Put the muscle at a gauge pressure at once. Raises `PlantError` below vacuum."""
        lowest = -self.constants.atmosphere_pa * 1e-3
        if not lowest < pressure_kpa <= 1200.0:
            raise PlantError(f"pressure_kpa = {pressure_kpa!r}; allowed {lowest:g} to 1200")
        self._jump(pressure_kpa * 1e3, float(self.state[LENGTH]))

    def set_length(self, length_mm: float) -> None:
        """Hold the muscle at another length at once; the gas inside stays.

        Raises `PlantError` outside the braid or when a hung mass sets the length.
        """
        self._check_prescribed("set_length")
        _check_length(length_mm * 1e-3, self.constants)
        atmosphere = self.params[layout.ATMOSPHERE]
        squeeze = self._chamber_m3(float(self.state[LENGTH])) / self._chamber_m3(length_mm * 1e-3)
        absolute = (self.state[PRESSURE] + atmosphere) * squeeze ** self.params[layout.EXPONENT]
        self._jump(float(absolute - atmosphere), length_mm * 1e-3)
        self.state[LENGTH_RATE] = 0.0

    def lead_to(self, length_mm: float) -> None:
        """Hold the muscle at another length, led there so slowly that its pressure stays.

        Raises `PlantError` as :meth:`set_length`.
        """
        pressure_pa = float(self.state[PRESSURE])
        self.set_length(length_mm)
        self._jump(pressure_pa, float(self.state[LENGTH]))

    def set_length_rate(self, rate_mm_s: float) -> None:
        """Move the stage at a steady rate, positive when lengthening, until told otherwise."""
        self._check_prescribed("set_length_rate")
        if not abs(rate_mm_s) <= 1e4:
            raise PlantError(f"rate_mm_s = {rate_mm_s!r}; allowed -10000 to 10000")
        self.state[LENGTH_RATE] = rate_mm_s * 1e-3

    def set_temperature(self, temperature_c: float) -> None:
        """Temperature of the muscle's wall. Raises `PlantError` out of -40 to 120 °C."""
        if not -40.0 <= temperature_c <= 120.0:
            raise PlantError(f"temperature_c = {temperature_c!r}; allowed -40 to 120")
        self.state[layout.TEMPERATURE] = temperature_c + 273.15
        self._refresh()

    def set_trials(self, trials: float) -> None:
        """How many trials the muscle has behind it. Raises `PlantError` below 0."""
        if not 0.0 <= trials < 1e9:
            raise PlantError(f"trials = {trials!r}; allowed 0 and above")
        self.state[layout.TRIAL] = trials
        self._refresh()

    def count_trial(self) -> None:
        """One more trial that the muscle has behind it."""
        self.set_trials(float(self.state[layout.TRIAL]) + 1.0)

    def set_supply(self, supply_kpa: float) -> None:
        """Change the gauge pressure of the supply. Raises `PlantError` out of 0 to 1200 kPa."""
        if not 0.0 <= supply_kpa <= 1200.0:
            raise PlantError(f"supply_kpa = {supply_kpa!r}; allowed 0 to 1200")
        self.state[SUPPLY] = supply_kpa * 1e3

    def set_regulator(self, pressure_kpa: float) -> None:
        """Set-point of the regulator. Raises `PlantError` out of 0 to 700 kPa."""
        if not 0.0 <= pressure_kpa <= REGULATOR_MAX_PA * 1e-3:
            raise PlantError(
                f"regulator set-point {pressure_kpa!r} kPa; allowed 0 to {REGULATOR_MAX_PA / 1e3:g}"
            )
        self.state[REGULATOR_SET] = pressure_kpa * 1e3

    def _chamber_m3(self, length_m: float) -> float:
        braid = (self.params[layout.BRAID_LENGTH], self.params[layout.TURNS])
        return float(braid_volume(length_m, *braid) + self.params[layout.DEAD_VOLUME])

    def _jump(self, pressure_pa: float, length_m: float) -> None:
        """Go to a pressure and length at once, sliding the fibres on the way."""
        change = pressure_pa - float(self.state[PRESSURE]), length_m - float(self.state[LENGTH])
        for slide in hooks.functions("slide"):
            slide(self.state, self.params, *change)
        self.state[PRESSURE] = pressure_pa
        self.state[LENGTH] = length_m
        self._refresh()

    def _refresh(self) -> None:
        """Bring the force up to date without letting time or commands move."""
        commands = (float(self.state[INLET_COMMAND]), float(self.state[OUTLET_COMMAND]))
        self._advance(self.state, self.params, 0.0, *commands)

    def _check_prescribed(self, what: str) -> None:
        if self.load != "isometric":
            raise PlantError(
                f"{what} on a bench with load {self.load!r}: the hung mass sets the length; "
                "use load='isometric' to prescribe it"
            )


def _check_length(length_m: float, constants: PlantConstants) -> None:
    if not 0.0 < length_m < constants.braid_length_m:
        raise PlantError(
            f"length_mm = {length_m * 1e3:g} is outside the braid; allowed above 0 and below "
            f"braid_length_mm = {constants.braid_length_m * 1e3:g}"
        )


def effect_slots(c: PlantConstants, effects: Effects) -> dict[int, float]:
    """Slots of the parameter array that differ from those of the nominal bench `c`.

    Effects on sensors (`plant.simulator.readings`) and on the label of the length leave no mark
    here, but for the lag of the pressure reading. Raises `PlantError` where an effect cannot be.
    """
    slots: dict[int, float] = {}
    for effect, values in effects.active():
        if effect.plant.slots is not None:
            slots.update(effect.plant.slots(values, c))
        if effect.plant.on_force:
            slots[layout.FORCE_EFFECTS] = 1.0
    return slots
