"""The blind bench as something to stand before: commands in, readings out, step by step.

For a virtual bench whose physics hides an effect. Whoever drives it keeps time, adds its own
instruments' noise and bytes, and asks for the answer only when it is to be revealed.
"""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from blind.design import draw_design, true_constants
from blind.mimic import measure
from blind.noise import draw_noise
from blind.physics import numbers as n
from blind.physics.bench import Trial, label_shift, no_effect, nominal, with_keys
from blind.physics.entries import CATALOGUE, ENTRIES, OUTSIDE, Hidden, draw
from blind.physics.kernel import QUEUE, SINCE, TIMES, VALVE_CELLS, command, slopes
from blind.physics.laws import relaxation
from blind.physics.readings import frame_delay_s, read_force, read_length, read_pressure
from blind.physics.stepping import advance, at_rest
from blind.recalibrate import Recalibration
from blind.seal import seal
from blind.sets import sized

FRAME_MEMORY_S = 0.5
HAIR_S = 1e-9


@dataclass(frozen=True)
class Shown:
    """What instruments without noise would show, and what is so (`true_*`).

    Gauge kPa, N, mm; the camera's length is as old as the hidden frame delay makes it.
    """

    time_s: float
    pressure_kpa: float
    force_n: float
    length_mm: float
    supply_kpa: float
    true_pressure_kpa: float
    true_force_n: float
    true_length_mm: float


@dataclass(frozen=True)
class Secret:
    """What a live bench hides: its effects, its constants, and how well they could be told."""

    hidden: tuple[Hidden, ...]
    constants: np.ndarray
    measured: dict[str, object]

    def answer(self) -> dict[str, Any]:
        """The secret as plain JSON values."""
        return {
            "schema": 1,
            "kind": "live",
            "effects": [h.as_dict() for h in self.hidden],
            "measured": self.measured,
        }


_DRAWS = 8
"""Most draws of one secret: about one in twenty is too small."""


def draw_secret(
    entropy: int | None = None,
    keys: Mapping[str, float] | None = None,
    size: tuple[float, float] = (3.0, 6.0),
    outside_share: float = 0.0,
    nominal_share: float = 0.0,
    effects: Sequence[str] | None = None,
    held_out: bool = False,
) -> Secret:
    """A secret effect of `size` floors (range) on a mixed design, in a form of its own.

    One that leaves less than half of the least size is drawn again: a form without a strength, such
    as a valve that swallows short pulses, may show nothing on this bench, and others are limited.

    entropy: None takes the operating system's. keys: constants by a bench file's names.
    effects: ids to draw from (all of the catalogue otherwise). held_out: in a form that is held
    out, for a campaign alone.
    """
    seed = secrets.randbits(96) if entropy is None else entropy
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    stated = with_keys(nominal(), keys or {})
    true = true_constants(rng, stated)
    lot = rng.random()
    if lot < nominal_share:
        return Secret((), true, {})
    pool = [e.id for e in (OUTSIDE if lot < nominal_share + outside_share else CATALOGUE)]
    for _ in range(_DRAWS):
        entry = ENTRIES[str(rng.choice(list(effects) if effects else pool))]
        design = draw_design(rng, [entry.needs], False, False, False)
        design = replace(design, stated=stated, true=true, keys=dict(keys or {}))
        recalibration = Recalibration(design, draw_noise(rng, False))
        drawn = draw(entry, rng, stated, held_out=held_out)
        hidden = sized(drawn, float(rng.uniform(*size)), recalibration, design)
        measured = measure(recalibration, [hidden])
        reached = measured["gap_over_floor"]
        if isinstance(reached, float) and reached >= 0.5 * size[0]:
            break
    return Secret((hidden,), true, measured)


class LiveBench:
    """One muscle with valve block, stage or load, advanced step by step.

    Give what the bench is told; take what its instruments show:

        bench = LiveBench(secret=draw_secret())
        digest, envelope = bench.sealed()        # publish digest, keep envelope until asked
        bench.start_trial(length_mm=60.0)        # or load_kg=2.0; resets air, time and memories
        shown = bench.step(1e-3, inlet=1, outlet=0)
        shown = bench.step(1e-3, inlet=0, outlet=1, length_mm=60.2)      # a stage that moves
        shown = bench.step(1e-2, regulator_kpa=300.0)                    # a regulator drives it

    Valve delays are inside: `inlet` and `outlet` are commands (1 fills, 1 vents). Steps may be of
    any length; edges fall on their starts. Each `start_trial` counts as a trial for wear, unless
    `order` is given. `air` and memories persist with `keep=True`.
    """

    def __init__(
        self,
        secret: Secret | None = None,
        hidden: Sequence[Hidden] = (),
        keys: Mapping[str, float] | None = None,
    ) -> None:
        c = with_keys(nominal(), keys or {})
        self.secret = secret or Secret(tuple(hidden), c, {})
        self.constants = self.secret.constants.copy()
        self.effects = no_effect()
        for one in self.secret.hidden:
            one.put(self.effects)
        row = self.effects[n.CREEP]
        self._w = np.zeros((2, n.MEMORIES))
        self._w[1] = 1.0
        if row[0] >= 0.0:
            self._w = relaxation(row[0], row[2])
        self._trials = 0
        self.time_s = 0.0
        self._vs: np.ndarray = np.zeros(VALVE_CELLS)
        self._frames: deque[tuple[float, float]] = deque()
        self._none = np.zeros(0), np.zeros((0, 7))
        self.start_trial()

    def sealed(self) -> tuple[str, dict[str, Any]]:
        """Salted digest of the answer to publish, and the envelope to keep."""
        return seal(self.secret.answer())

    def start_trial(
        self,
        length_mm: float = 60.0,
        load_kg: float = 0.0,
        pressure_kpa: float = 0.0,
        temperature_c: float = 21.0,
        order: int | None = None,
        mounting: int = 1,
        keep: bool = False,
    ) -> None:
        """Begin a trial from rest: a held length (as written down) or a hanging mass."""
        self._trials += 1
        count = self._trials if order is None else order
        self.trial = Trial("", "", "free", 0, mounting, count, 1.0, temperature_c=temperature_c)
        c = self.constants
        c[n.MASS], c[n.MUSCLE_C], c[n.TRIAL] = load_kg, temperature_c, count
        if keep:  # what the valves remember happened so long before the new beginning
            self._vs[SINCE : SINCE + 2] -= self.time_s
            for base in (TIMES, TIMES + 2 * QUEUE):
                self._vs[base : base + QUEUE] -= self.time_s
        self.time_s, self._step = 0.0, 1e-3
        self._written = length_mm
        self._length = self._true_length(length_mm)
        if not keep:
            self._y, self._vs = at_rest(pressure_kpa, self._length, c, self.effects)
        elif load_kg > 0.0 and self._y[n.Y_L] == 0.0:
            self._y[n.Y_L] = self._length
        self._frames.clear()
        self._drive = (False, 0.0)

    def _true_length(self, written: float) -> float:
        return written + label_shift(self.effects, written, self.trial.mounting)

    def step(
        self,
        dt: float,
        inlet: int = 0,
        outlet: int = 0,
        length_mm: float | None = None,
        load_kg: float | None = None,
        regulator_kpa: float | None = None,
        temperature_c: float | None = None,
    ) -> Shown:
        """Advance by dt seconds under these commands; returns the readings at its end.

        length_mm: where the stage is to be at the end of the step, as written down (linear in
        between); load_kg changes the hanging mass; a regulator overrides the valve.
        """
        c, e, y, vs = self.constants, self.effects, self._y, self._vs
        if load_kg is not None:
            if load_kg > 0.0 and c[n.MASS] == 0.0:
                y[n.Y_L], y[n.Y_V] = self._length, 0.0
            c[n.MASS] = load_kg
        if temperature_c is not None:
            c[n.MUSCLE_C] = temperature_c
        start, end = self.time_s, self.time_s + dt
        goal = self._length
        if length_mm is not None:
            goal = self._true_length(length_mm)
        len_t, len_v = np.array([start, end]), np.array([self._length, goal])
        regulated = regulator_kpa is not None
        level = float(regulator_kpa or 0.0)
        set_t, set_v = np.array([start, end]), np.array([level, level])
        command(start, 0, inlet > 0, y, vs, c, e)
        command(start, 1, outlet > 0, y, vs, c, e)
        times, out = self._none
        self._step, _ = advance(
            start, end, self._step, y, vs, c, e, self._w, regulated, set_t, set_v, len_t, len_v,
            times, out, 0, 1.0,
        )  # fmt: skip
        self.time_s = end
        dy = np.zeros(n.STATES)
        # A hair before the end: at a course's last corner nothing moves any more.
        last = end - min(HAIR_S, 0.5 * dt)
        force, length, _, _ = slopes(
            last, y, dy, vs, c, e, self._w, regulated, set_t, set_v, len_t, len_v
        )
        self._length = float(length)
        return self._shown(float(force), float(length))

    def read_block(self, true_mm: float) -> float:
        """What the camera shows of a gauge block in the place of the muscle, mm."""
        return float(read_length(np.array([true_mm]), self.constants, self.effects)[0])

    def _shown(self, force: float, length: float) -> Shown:
        c, e, y, now = self.constants, self.effects, self._y, self.time_s
        at = np.array([now])
        gauge = float(y[n.Y_P] - c[n.ATMOSPHERE])
        tap = gauge
        if e[n.P_LAG, 0] >= 0.0:
            tap = float(y[n.Y_TAP + 1] if e[n.P_LAG, 0] == 2.0 else y[n.Y_TAP])
        self._frames.append((now, length))
        while self._frames and self._frames[0][0] < now - FRAME_MEMORY_S:
            self._frames.popleft()
        exposed = now - float(frame_delay_s(at, e)[0])
        seen = length
        for stamp, value in reversed(self._frames):
            seen = value
            if stamp <= exposed:
                break
        return Shown(
            now,
            float(read_pressure(np.array([tap]), at, self.trial, e)[0]),
            float(read_force(np.array([force]), at, self.trial, e)[0]),
            float(read_length(np.array([seen]), c, e)[0]),
            float(c[n.SUPPLY] - c[n.ATMOSPHERE]),
            gauge,
            force,
            length,
        )
