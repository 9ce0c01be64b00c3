"""Force of the muscle with effects, for whole arrays at once: no time stepping, no valve.

    law = ForceLaw(constants, effects)
    law.lasting(p_pa, length_m)                 # what stays at rest, temperature and wear in
    law.force(time_s, p_pa, length_m)           # along a path: friction, speed and creep as well

The compiled bench steps the same functions of `plant.effects`; this is the form to predict force
from measured pressure and length, and to check the kernel against.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.effects.empirical import OF_CELL, SEEN, STATIC, UNCORRECTED, Corrections, braid_scales
from plant.effects.reference import TEMPERATURE_C as REFERENCE_TEMPERATURE_C
from plant.errors import PlantError
from plant.physics import layout, muscle
from plant.simulator.bench import build_params


@dataclass(frozen=True)
class ForceLaw:
    """The muscle of `constants` with `effects`; every method takes SI arrays that broadcast.

    An empirical correction of the force is added where it depends on pressure and length alone.

    Raises `PlantError` for pressures below vacuum and lengths outside the braid.
    """

    constants: PlantConstants
    effects: Effects = NONE
    corrections: Corrections = UNCORRECTED

    def lasting(
        self,
        p_pa: npt.ArrayLike,
        length_m: npt.ArrayLike,
        temperature_c: npt.ArrayLike = REFERENCE_TEMPERATURE_C,
        trials: npt.ArrayLike = 0.0,
    ) -> Array:
        """Force in N that stays when nothing moves: no friction, speed or creep."""
        muscle.force(p_pa, length_m, self.constants)
        params = build_params(self.constants, self.effects)
        p, length = np.broadcast_arrays(
            np.asarray(p_pa, dtype=np.float64), np.asarray(length_m, dtype=np.float64)
        )
        kelvin = np.asarray(temperature_c) + 273.15
        pull = self._braid(params, p, length)
        for scale in self._hooks("scale"):
            pull = scale(pull, params, p, length, kelvin, np.asarray(trials), self._braid)
        for add in self._hooks("add"):
            pull = add(pull, params, p, length)
        return np.asarray(pull + self._correction(p, length))

    def _correction(self, p: Array, length: Array) -> Array | float:
        """What `[empirical.force]` adds, N. `PlantError` where it needs more than this law has."""
        correction = self.corrections.of.get("force")
        if correction is None:
            return 0.0
        # What a force cell or a camera shows too much is no force of the muscle.
        pulls = tuple(term for term in correction.terms if term.scale not in (*OF_CELL, SEEN))
        correction = replace(correction, terms=pulls)
        for name in correction.inputs:
            if name not in STATIC:
                raise PlantError(
                    f"[empirical.force] depends on {name}; a law without time has "
                    f"{' and '.join(STATIC)} only"
                )
        at = {"pressure_kpa": p.ravel() * 1e-3, "length_mm": length.ravel() * 1e3}
        at |= braid_scales(p.ravel(), length.ravel(), self.constants)
        return np.asarray(correction.value(at, p.size).reshape(p.shape))

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
        lasting = self.lasting(p_pa, length_m, temperature_c, trials)
        rate = rate_m_s
        if rate is None:
            still = len(time_s) < 2 or not self._hooks("damping")
            rate = np.zeros(len(p_pa)) if still else np.gradient(length_m, time_s)
        return lasting + self.transient(time_s, p_pa, length_m, rate, lasting)

    def transient(
        self, time_s: Array, p_pa: Array, length_m: Array, rate_m_s: Array, lasting_n: Array
    ) -> Array:
        """Force in N that a path in time adds to the lasting force of a fresh, unloaded muscle."""
        added = np.zeros(len(p_pa))
        hooks = self._hooks("transient")
        if not hooks:
            return added
        params = build_params(self.constants, self.effects)
        slides, follows = self._hooks("slide"), self._hooks("follow")
        state = np.zeros(layout.STATE_SIZE)
        path = zip(
            *(x.tolist() for x in (time_s, p_pa, length_m, rate_m_s, lasting_n)), strict=True
        )
        before: tuple[float, ...] = ()
        for k, (time, p, length, rate, lasting) in enumerate(path):
            if before:
                for slide in slides:
                    slide(state, params, p - before[1], length - before[2])
            state[layout.PRESSURE], state[layout.LENGTH] = p, length
            if before:
                for follow in follows:
                    follow(state, params, before[1], before[3], lasting, time - before[0])
            pull = lasting
            for transient in hooks:
                pull = transient(pull, state, params, p, length, rate)
            added[k] = pull - lasting
            before = (time, p, length, lasting)
        return added

    def _hooks(self, name: str) -> list[Callable[..., Any]]:
        hooks = [getattr(effect.plant, name) for effect, _ in self.effects.active()]
        return [hook for hook in hooks if hook is not None]

    def _braid(self, params: Array, p: Array, length: Array) -> Array:
        c = self.constants
        push, inner = p, length
        threads: Any = np.full_like(p, c.braid_length_m)
        for hook in self._hooks("push"):
            push = hook(push, params, p)
        for hook in self._hooks("threads"):
            threads = hook(threads, params, p)
        for hook in self._hooks("inner"):
            inner = hook(inner, params, length)
        return np.asarray(muscle.braid_force(push, inner, threads, c.turns))
