"""References of the finger: a step of one joint, and a circle of the fingertip.

A reference has angles, rates and accelerations every millisecond, so that a law can use future
values. The circle (15 mm radius in the flexion plane, one turn in 4 s) does not determine all three
flexion joints: the angle of the tip joint equals that of the middle joint. (With two thirds of it,
as in a hand, the fingertip reaches only 66 to 97 mm, just enough for the circle.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.finger import Finger
from plant.links import Arm

GRID_S = 1e-3
COUPLING = 1.0
"""Ratio of the angles of tip joint and middle joint on the circle."""
CIRCLE_RADIUS_M = 0.015
CIRCLE_TURN_S = 4.0
CIRCLE_POSTURE_DEG = (0.0, 10.0, 46.0, 46.0)
"""The centre of the circle is the position of the tip in this posture."""
STEP_POSTURE_DEG = (0.0, 10.0, 25.0, 25.0)
STEP_DEG = 20.0
SOFT_S = 0.3
"""Duration of the softened step: two periods of the slowest oscillation of the nominal finger."""


@dataclass(frozen=True)
class Reference:
    """Angles, rates, accelerations (samples, n) every `GRID_S`, and reference position of the tip.

    Figures of merit start at `scored_from_s`. Before 0 and after the end the end values hold.
    """

    q: Array
    qd: Array
    qdd: Array
    scored_from_s: float
    tip: Array | None = None
    softened: Reference | None = None

    @property
    def smooth(self) -> Reference:
        """The reference without jumps, for laws that need rates: a step takes `SOFT_S`."""
        return self.softened or self

    @property
    def duration_s(self) -> float:
        """Duration of the reference."""
        return (len(self.q) - 1) * GRID_S

    def at(self, time_s: float) -> tuple[Array, Array, Array]:
        """Angles, rates and accelerations at a time, (n,) each."""
        k = min(max(round(time_s / GRID_S), 0), len(self.q) - 1)
        return self.q[k], self.qd[k], self.qdd[k]


def tips(arm: Arm, q: Array) -> Array:
    """Tip positions (samples, 3) of angles (samples, n), by the DH chain."""
    count = len(q)
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    place = np.zeros((count, 3))
    for index, link in enumerate(arm.links):
        ca, sa = link.twist
        ct, st = np.cos(q[:, index] + link.offset_rad), np.sin(q[:, index] + link.offset_rad)
        zero, one = np.zeros(count), np.ones(count)
        shift = np.stack([link.a_m * ct, link.a_m * st, link.d_m * one], axis=-1)
        turn = np.stack(
            [
                np.stack([ct, -ca * st, sa * st], axis=-1),
                np.stack([st, ca * ct, -sa * ct], axis=-1),
                np.stack([zero, sa * one, ca * one], axis=-1),
            ],
            axis=-2,
        )
        place = place + np.einsum("sij,sj->si", rotation, shift)
        rotation = rotation @ turn
    return place


def step(
    finger: Finger,
    joint: str = "flexion",
    degrees: float = STEP_DEG,
    hold_s: float = 2.5,
    lead_s: float = 1.5,
    posture_deg: tuple[float, ...] = STEP_POSTURE_DEG,
) -> Reference:
    """A posture, and a step of one joint by `degrees` at `lead_s`. Raises `LinkError`."""
    index = finger.arm.joint(joint)
    count = round((lead_s + hold_s) / GRID_S) + 1
    q = np.tile(np.radians(posture_deg), (count, 1))
    jump = math.radians(degrees)
    still = np.zeros_like(q)
    soft, rate, acceleration = q.copy(), still.copy(), still.copy()
    q[round(lead_s / GRID_S) :, index] += jump
    s = np.clip((np.arange(count) * GRID_S - lead_s) / SOFT_S, 0.0, 1.0)
    soft[:, index] += jump * (10 * s**3 - 15 * s**4 + 6 * s**5)
    rate[:, index] = jump * (30 * s**2 - 60 * s**3 + 30 * s**4) / SOFT_S
    acceleration[:, index] = jump * (60 * s - 180 * s**2 + 120 * s**3) / SOFT_S**2
    return Reference(q, still, still, lead_s, softened=Reference(soft, rate, acceleration, lead_s))


def circle(
    finger: Finger,
    turns: int = 3,
    lead_s: float = 1.5,
    radius_m: float = CIRCLE_RADIUS_M,
    turn_s: float = CIRCLE_TURN_S,
    posture_deg: tuple[float, ...] = CIRCLE_POSTURE_DEG,
) -> Reference:
    """The fingertip on a circle in the flexion plane; figures of merit exclude the first turn.

    The finger waits at the first point of the circle, then the speed rises over half a second.
    """
    arm = finger.arm
    samples = 512
    phase = np.arange(samples) / samples * 2.0 * np.pi
    centre = tips(arm, np.radians([posture_deg]))[0]
    goal = centre + radius_m * np.stack([np.cos(phase), 0 * phase, np.sin(phase)], axis=-1)
    q = _solve(arm, goal, np.radians(posture_deg))
    # The motion is periodic: its Fourier series and its derivatives are exact between samples.
    series = np.fft.rfft(q, axis=0) / samples
    series[1:] *= 2.0
    gentle_s = 0.5
    time = np.arange(round((lead_s + turns * turn_s + gentle_s) / GRID_S) + 1) * GRID_S - lead_s
    share = np.clip(time / (2.0 * gentle_s), 0.0, 1.0)
    # The speed rises as 3 s^2 - 2 s^3 over 2 gentle_s; its integral lags by gentle_s.
    speed = 3 * share**2 - 2 * share**3
    turned = np.where(
        time < 2 * gentle_s,
        2 * gentle_s * (share**3 - share**4 / 2),
        time - gentle_s,
    )
    pace = np.where(share < 1.0, (6 * share - 6 * share**2) / (2 * gentle_s), 0.0)
    angle = 2.0 * np.pi * turned / turn_s
    angle_rate = 2.0 * np.pi * speed / turn_s
    angle_acceleration = 2.0 * np.pi * pace / turn_s
    orders = np.arange(24)
    basis = np.exp(1j * np.outer(angle, orders))
    kept = series[:24]
    q_t = (basis @ kept).real
    slope = (basis @ (1j * orders[:, None] * kept)).real
    bend = (basis @ (-(orders[:, None] ** 2) * kept)).real
    qd = slope * angle_rate[:, None]
    qdd = bend * angle_rate[:, None] ** 2 + slope * angle_acceleration[:, None]
    wanted = centre + radius_m * np.stack(
        [np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1
    )
    return Reference(q_t, qd, qdd, lead_s + gentle_s + turn_s, wanted)


def _solve(arm: Arm, goal: Array, start: Array) -> Array:
    """Angles (samples, 4) with the tip at `goal` in the flexion plane, by Newton's method."""
    free = np.tile(start[1:3], (len(goal), 1))

    def angles(two: Array) -> Array:
        zero = np.zeros(len(two))
        return np.stack([zero, two[:, 0], two[:, 1], COUPLING * two[:, 1]], axis=-1)

    for _ in range(30):
        here = tips(arm, angles(free))[:, ::2]
        small = 1e-6
        columns = [
            (tips(arm, angles(free + small * np.eye(2)[k]))[:, ::2] - here) / small
            for k in range(2)
        ]
        jacobian = np.stack(columns, axis=-1)
        missing = goal[:, ::2] - here
        free = free + np.linalg.solve(jacobian, missing[..., None])[..., 0]
        if np.abs(missing).max() < 1e-12:
            break
    return angles(free)
