"""Simulation of a finger, tick by tick or from a recording of valve commands."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.catalogue import CATALOGUE
from plant.effects.effects import NONE, Effects
from plant.errors import PlantError
from plant.finger import kernel
from plant.finger.body import Finger
from plant.links.dynamics import total_energy
from plant.physics import layout
from plant.physics.muscle import braid_volume
from plant.simulator.bench import build_params, build_state

STEP_MAX_S = 1e-3
SUPPORTED_EFFECTS = tuple(
    sorted(
        effect.id
        for effect in CATALOGUE.values()
        if effect.stage not in ("load", "sensor") and effect.plant.follow is None
    )
)
"""Effects of the catalogue that the finger's equations include: those on muscle, valve and gas,
except creep (which has a memory of its own)."""


class FingerSim:
    """Simulated finger with n joints and 2 n muscles.

    Starts at rest at angles `q_rad` with the muscles at `pressure_kpa` (a scalar or (2 n,)) and
    closed valves. `muscles` (2 n, STATE_SIZE) and `params` (2 n, PARAMS_SIZE) are rows in the
    layout of the one-muscle bench; `joints` (2 n,) holds angles and rates. Muscle 2 j is the
    agonist of joint j.

    Raises:
        PlantError: a negative payload, a range that takes a muscle outside its length limits,
            angles outside their range, an effect that is not in `SUPPORTED_EFFECTS`.
    """

    def __init__(
        self,
        finger: Finger,
        constants: PlantConstants,
        effects: Effects = NONE,
        payload_kg: float = 0.0,
        q_rad: npt.ArrayLike | None = None,
        pressure_kpa: npt.ArrayLike = 0.0,
        step_max_s: float = STEP_MAX_S,
    ) -> None:
        for name in effects.values:
            if name not in SUPPORTED_EFFECTS:
                raise PlantError(
                    f"effect {name!r}: not in the finger's equations; it has "
                    f"{', '.join(SUPPORTED_EFFECTS)}"
                )
        if not step_max_s > 0.0:
            raise PlantError(f"step_max_s = {step_max_s!r}; expected more than 0")
        constants.check_plain("a finger")
        finger.check_lengths(constants)
        self.finger = finger.with_payload(payload_kg)
        self.constants = constants
        self.step_max_s = step_max_s
        n = finger.arm.degrees
        self.tendons = finger.tendons
        self.stops = finger.stops
        self.table = np.array(self.finger.arm.table)
        self.gravity = np.array(self.finger.arm.gravity)
        self.joints = np.zeros(2 * n)
        if q_rad is not None:
            self.joints[:n] = self._angles(q_rad)
        self.params = np.stack([build_params(constants, effects) for _ in range(2 * n)])
        pressure = np.broadcast_to(np.asarray(pressure_kpa, dtype=float), (2 * n,))
        if not np.all((pressure > -constants.atmosphere_pa * 1e-3) & (pressure <= 1200.0)):
            raise PlantError(f"pressure_kpa = {pressure_kpa!r}; allowed above vacuum, up to 1200")
        rows = []
        for i in range(2 * n):
            row = build_state(constants, self._length(i))
            row[layout.OUTLET_OPEN] = row[layout.OUTLET_COMMAND] = row[layout.SPOOL + 1] = 0.0
            row[layout.PRESSURE] = pressure[i] * 1e3
            rows.append(row)
        self.muscles = np.stack(rows)
        self._no_traces = np.empty((0, 4 * n))

    def advance(self, dt_s: float, on_s: Array) -> None:
        """One control tick: `on_s` (2 n, 2) is the on-time of each inlet and outlet from its start.

        A value of at least `dt_s` keeps the command on at the end, as in
        `plant.simulator.bench.advance`.
        """
        self._run(dt_s, on_s.reshape(1, *on_s.shape), self._no_traces)

    def replay(self, dt_s: float, on_s: Array) -> Array:
        """Simulate many ticks, `on_s` (ticks, 2 n, 2), in one compiled call.

        Returns (ticks, 4 n): angles (rad), rates (rad/s) and gauge pressures (Pa) after each.
        """
        n = self.finger.arm.degrees
        if on_s.ndim != 3 or on_s.shape[1:] != (2 * n, 2):
            raise PlantError(f"on_s has shape {on_s.shape}; expected (ticks, {2 * n}, 2)")
        traces = np.empty((len(on_s), 4 * n))
        self._run(dt_s, np.ascontiguousarray(on_s, dtype=np.float64), traces)
        return traces

    def _run(self, dt_s: float, on_s: Array, traces: Array) -> None:
        fine = kernel.advance(
            self.muscles,
            self.params,
            self.joints,
            self.tendons,
            self.stops,
            self.table,
            self.gravity,
            dt_s,
            self.step_max_s,
            on_s,
            traces,
        )
        if not fine:
            raise PlantError(
                f"finger {self.finger.name!r}: its inertia matrix is singular at "
                f"{self.time_s:g} s; give the links after each joint mass or inertia"
            )

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self.muscles[0, layout.TIME])

    @property
    def q_rad(self) -> Array:
        """Angles, (n,)."""
        return np.array(self.joints[: len(self.joints) // 2])

    @property
    def qd_rad_s(self) -> Array:
        """Rates, (n,)."""
        return np.array(self.joints[len(self.joints) // 2 :])

    @property
    def pressure_kpa(self) -> Array:
        """True gauge pressures, (2 n,)."""
        return np.array(self.muscles[:, layout.PRESSURE] * 1e-3)

    @property
    def energy_j(self) -> float:
        """Energy of links and gas in J; constant with closed valves and frictionless joints.

        For isothermal gas: kinetic and potential energy of the links, plus for each chamber
        -P V ln(V / 6 ml) + P_atm V, the energy of its gas and of the atmosphere.
        """
        c = self.constants
        total = float(total_energy(self.finger.arm, self.q_rad, self.qd_rad_s))
        for row in self.muscles:
            volume = float(braid_volume(row[layout.LENGTH], c.braid_length_m, c.turns))
            chamber = volume + c.dead_volume_m3
            content = (row[layout.PRESSURE] + c.atmosphere_pa) * chamber
            total += float(c.atmosphere_pa * chamber - content * np.log(chamber / 6e-6))
        return total

    def _length(self, i: int) -> float:
        joint, rest, arm = self.tendons[i]
        return float(rest + arm * self.joints[int(joint)])

    def _angles(self, q_rad: npt.ArrayLike) -> Any:
        q = np.asarray(q_rad, dtype=float)
        arm = self.finger.arm
        if q.shape != (arm.degrees,):
            raise PlantError(f"q_rad has shape {q.shape}; expected ({arm.degrees},)")
        for angle, link in zip(q, arm.links, strict=True):
            if not link.low_rad <= angle <= link.high_rad:
                raise PlantError(
                    f"joint {link.joint!r} at {np.degrees(angle):g} degrees; its range is "
                    f"{np.degrees(link.low_rad):g} to {np.degrees(link.high_rad):g}"
                )
        return q
