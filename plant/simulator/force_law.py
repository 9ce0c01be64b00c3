"""Force of the muscle with effects, for whole arrays at once: no time stepping, no valve.

    law = ForceLaw(constants, effects)
    law.lasting(p_pa, length_m)                 # what stays at rest, temperature and wear in
    law.force(time_s, p_pa, length_m)           # along a path: friction, speed and creep as well

The compiled bench steps the same formulas (`plant.physics.additions`, `plant.physics.muscle`);
this is the form to predict force from measured pressure and length, and to check the kernel
against.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.physics import additions, layout, muscle
from plant.physics.friction import REFERENCE_PRESSURE_PA, slip_history
from plant.simulator.bench import REFERENCE_TEMPERATURE_C
from plant.simulator.effect_slots import effect_slots

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ForceLaw:
    """The muscle of `constants` with `effects`; every method takes SI arrays that broadcast.

    Raises `PlantError` for pressures below vacuum and lengths outside the braid.
    """

    constants: PlantConstants
    effects: Effects = NONE

    def lasting(
        self,
        p_pa: npt.ArrayLike,
        length_m: npt.ArrayLike,
        temperature_c: npt.ArrayLike = REFERENCE_TEMPERATURE_C,
        trials: npt.ArrayLike = 0.0,
    ) -> Array:
        """Force in N that stays when nothing moves: no friction, speed or creep."""
        c, at = self.constants, effect_slots(self.constants, self.effects)
        muscle.force(p_pa, length_m, c)
        p, length = np.broadcast_arrays(
            np.asarray(p_pa, dtype=np.float64), np.asarray(length_m, dtype=np.float64)
        )
        pull = self._braid(p, length, at)
        if at[layout.WARMING] != 0.0:
            stated = np.full_like(p, additions.STRETCH_PRESSURE_PA)
            grown = pull + at[layout.WARMING_FLAT] * (self._braid(stated, length, at) - pull)
            warmer = np.asarray(temperature_c) + 273.15 - at[layout.WARMING_FROM]
            pull = pull + at[layout.WARMING] * warmer * grown
        pull = pull * (1.0 + at[layout.WEAR] * np.asarray(trials))
        if at[layout.BLADDER] != 0.0:
            rest, bend = at[layout.BLADDER_REST], at[layout.BLADDER_HARDENING]
            pull = pull + additions.bladder_force(length, at[layout.BLADDER], rest, bend)
        if at[layout.LIMIT_FORCE] != 0.0:
            lost, scale = at[layout.LIMIT_FORCE], at[layout.LIMIT_SCALE]
            pull = pull - additions.limit_force(length, lost, c.length_min_m, scale)
        return np.asarray(pull)

    def viscous(self, p_pa: npt.ArrayLike, rate_m_s: npt.ArrayLike) -> Array:
        """Force in N that the speed adds; `rate_m_s` is positive when lengthening."""
        at = effect_slots(self.constants, self.effects)
        form = at[layout.VISCOUS], at[layout.VISCOUS_EXPONENT], at[layout.VISCOUS_PRESSURE]
        return np.asarray(additions.viscous_force(np.asarray(rate_m_s), np.asarray(p_pa), *form))

    def friction(self, p_pa: Array, length_m: Array) -> Array:
        """Force in N that friction takes along a path that starts with fresh fibres."""
        at = effect_slots(self.constants, self.effects)
        if at[layout.FRICTION_FORCE] == 0.0:
            return np.zeros(len(p_pa))
        travel = at[layout.FRICTION_TRAVEL_PRESSURE], at[layout.FRICTION_TRAVEL_LENGTH]
        load = at[layout.FRICTION_FORCE] * np.maximum(p_pa, 0.0) / REFERENCE_PRESSURE_PA
        return np.asarray(load * slip_history(p_pa, length_m, *travel))

    def crept(self, time_s: Array, lasting_n: Array) -> Array:
        """Force in N lost to creep along a path of the lasting force that starts unloaded."""
        at = effect_slots(self.constants, self.effects)
        gain = at.get(layout.CREEP_GAIN, 0.0)
        lost = np.zeros(len(time_s))
        if gain == 0.0:
            return lost
        for i in range(layout.CREEP_ELEMENTS):
            tau, value = at[layout.CREEP_TIME + i], 0.0
            for k in range(1, len(time_s)):
                before, after = float(lasting_n[k - 1]), float(lasting_n[k])
                span = float(time_s[k] - time_s[k - 1])
                value = additions.follow(value, before, after, span, tau)
                lost[k] += gain * value
        return lost

    def force(
        self,
        time_s: Array,
        p_pa: Array,
        length_m: Array,
        temperature_c: npt.ArrayLike = REFERENCE_TEMPERATURE_C,
        trials: npt.ArrayLike = 0.0,
        rate_m_s: Array | None = None,
    ) -> Array:
        """Force in N along a path in time, shape (samples,), from a fresh and unloaded muscle.

        `rate_m_s` is taken from `length_m` by central differences where it is not given; give it
        when the length is a noisy measurement.
        """
        held = self.lasting(p_pa, length_m, temperature_c, trials)
        out = held - self.crept(time_s, held) - self.friction(p_pa, length_m)
        if "viscosity" in self.effects:
            rate = np.gradient(length_m, time_s) if rate_m_s is None else rate_m_s
            out = out + self.viscous(p_pa, rate)
        return np.asarray(out)

    def _braid(self, p: Array, length: Array, at: dict[int, float]) -> Array:
        c = self.constants
        push = p
        if at[layout.LINER_LOST] > 0.0:
            push = muscle.liner_pressure(p, at[layout.LINER_LOST], at[layout.LINER_WIDTH])
        threads = additions.stretched(np.full_like(p, c.braid_length_m), p, at[layout.STRETCH])
        inner = additions.effective_length(length, at[layout.CAP_SHARE], at[layout.CAP_REST])
        return np.asarray(muscle.braid_force(push, inner, threads, c.turns))
