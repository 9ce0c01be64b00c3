"""Definition of a finger: an arm, and for each joint a pair of muscles on a pulley."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.errors import PlantError
from plant.links import Arm


@dataclass(frozen=True)
class Pair:
    """Two muscles on one pulley: the agonist (+) and the antagonist (-) of a joint.

    `length_m` is the length of both muscles at joint angle 0. Raises `PlantError`.
    """

    joint: str
    pulley_radius_m: float = 0.008
    length_m: float = 0.062

    def __post_init__(self) -> None:
        for name, value in (("pulley radius", self.pulley_radius_m), ("length", self.length_m)):
            if not (math.isfinite(value) and value > 0.0):
                raise PlantError(f"pair of joint {self.joint!r}: {name} {value!r} m; expected > 0")


@dataclass(frozen=True)
class Finger:
    """An arm with a pair of muscles per joint: muscle 2 j is the agonist of joint j, 2 j + 1 the
    other.

    `stop_stiffness_n_m` and `stop_damping_n_s_m` act at the tendon. Raises `PlantError` if a pair
    names an unknown joint, or if a joint has no range or not exactly one pair.
    """

    name: str
    arm: Arm
    pairs: tuple[Pair, ...]
    stop_stiffness_n_m: float = 20e3
    stop_damping_n_s_m: float = 20.0

    def __post_init__(self) -> None:
        for pair in self.pairs:
            self.arm.joint(pair.joint)
        for joint, link in zip(self.arm.joints, self.arm.links, strict=True):
            count = sum(pair.joint == joint for pair in self.pairs)
            if count != 1:
                raise PlantError(
                    f"finger {self.name!r}: joint {joint!r} has {count} pairs of muscles; "
                    "give each joint exactly one"
                )
            if not (math.isfinite(link.low_rad) and math.isfinite(link.high_rad)):
                raise PlantError(f"finger {self.name!r}: joint {joint!r} needs range_deg")
        if not (self.stop_stiffness_n_m > 0.0 and self.stop_damping_n_s_m >= 0.0):
            raise PlantError(f"finger {self.name!r}: stops need a stiffness above 0")

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, from the base outwards."""
        return self.arm.joints

    def with_payload(self, mass_kg: float) -> Finger:
        """The same finger with a point mass at its tip. Raises `PlantError` for a negative one."""
        return dataclasses.replace(self, arm=self.arm.with_payload(mass_kg))

    def pair(self, joint: str) -> Pair:
        """The pair of a joint."""
        return next(pair for pair in self.pairs if pair.joint == joint)

    @property
    def tendons(self) -> Array:
        """(2 n, 3) for the kernel: joint, length at angle 0 (m), dL/dq (m/rad)."""
        rows = []
        for index, joint in enumerate(self.joints):
            pair = self.pair(joint)
            rows += [[index, pair.length_m, side * pair.pulley_radius_m] for side in (-1.0, 1.0)]
        return np.array(rows, dtype=np.float64)

    @property
    def stops(self) -> Array:
        """(n, 4) for the kernel: range (2, rad), stiffness (N m/rad), damping (N m s/rad)."""
        rows = []
        for link in self.arm.links:
            square = self.pair(link.joint).pulley_radius_m ** 2
            stiffness, damping = self.stop_stiffness_n_m, self.stop_damping_n_s_m
            rows.append([link.low_rad, link.high_rad, stiffness * square, damping * square])
        return np.array(rows, dtype=np.float64)

    def check_lengths(self, constants: PlantConstants) -> None:
        """Raise `PlantError` if the range of a joint takes a muscle outside its length limits."""
        for link in self.arm.links:
            pair = self.pair(link.joint)
            for angle in (link.low_rad, link.high_rad):
                for side in (-1.0, 1.0):
                    length = pair.length_m + side * pair.pulley_radius_m * angle
                    if not constants.length_min_m <= length <= constants.length_max_m:
                        raise PlantError(
                            f"finger {self.name!r}: at {math.degrees(angle):g} degrees joint "
                            f"{link.joint!r} would make a muscle {length * 1e3:.1f} mm long; "
                            f"allowed {constants.length_min_m * 1e3:g} to "
                            f"{constants.length_max_m * 1e3:g} mm: change the pulley, the length "
                            "or the range"
                        )
