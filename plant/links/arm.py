"""A serial arm with revolute joints, with Denavit-Hartenberg parameters."""

from __future__ import annotations

import dataclasses
import difflib
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plant.arrays import Array
from plant.errors import LinkError
from plant.links.inertia import Six, Three, check_inertia, elements, rod_inertia, tensor


def check_name(key: str, name: object, example: str) -> None:
    """Raise `LinkError` unless the name is an identifier (for source code and file names)."""
    if not isinstance(name, str) or not name.isidentifier():
        raise LinkError(
            f'{key} = {name!r}; expected letters, digits and _, e.g. {key} = "{example}"'
        )


@dataclass(frozen=True)
class Link:
    """One link in SI: its joint, the transformation to its frame, and its body.

    The frame is at the far end of the link (thesis, section 2.2): rotate by q + offset about the z
    axis of the previous frame, move d along it, then a along the new x, then rotate by alpha
    about x.
    `com_m` and `inertia_kg_m2` (xx, yy, zz, xy, xz, yz, about the centre of mass) are in this
    frame, so the middle of a rod of length a is at (-a/2, 0, 0).

    Raises `LinkError` for impossible values.
    """

    joint: str
    a_m: float
    alpha_rad: float = 0.0
    d_m: float = 0.0
    offset_rad: float = 0.0
    mass_kg: float = 0.0
    com_m: Three = (0.0, 0.0, 0.0)
    inertia_kg_m2: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    damping_n_m_s: float = 0.0
    low_rad: float = -math.inf
    high_rad: float = math.inf

    def __post_init__(self) -> None:
        where = f"link of joint {self.joint!r}"
        check_name("joint", self.joint, "flexion")
        if not all(map(math.isfinite, (self.a_m, self.alpha_rad, self.d_m, self.offset_rad))):
            raise LinkError(f"{where}: a, alpha, d and offset must be finite numbers")
        if not self.damping_n_m_s >= 0.0:
            raise LinkError(f"{where}: joint damping {self.damping_n_m_s!r} must be 0 or more")
        if not self.low_rad < self.high_rad:
            low, high = math.degrees(self.low_rad), math.degrees(self.high_rad)
            raise LinkError(f"{where}: its range must increase, got {low:g} to {high:g} degrees")
        check_inertia(self.mass_kg, self.com_m, self.inertia_kg_m2, where)

    @classmethod
    def rod(
        cls, joint: str, length_m: float, mass_kg: float, diameter_m: float = 0.0, **more: float
    ) -> Link:
        """A uniform round rod between its joint and the next; `more` are other fields of `Link`."""
        return cls(
            joint,
            length_m,
            mass_kg=mass_kg,
            com_m=(-length_m / 2.0, 0.0, 0.0),
            inertia_kg_m2=rod_inertia(mass_kg, length_m, diameter_m),
            **more,
        )

    @property
    def twist(self) -> tuple[float, float]:
        """Cosine and sine of alpha; exactly 0 and +-1 at multiples of 90 degrees."""
        quarters = self.alpha_rad / (math.pi / 2.0)
        if abs(quarters - round(quarters)) < 1e-12:
            return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
        return math.cos(self.alpha_rad), math.sin(self.alpha_rad)


@dataclass(frozen=True)
class Arm:
    """A serial arm on a fixed base; `gravity_m_s2` is a vector in the base frame.

    Raises `LinkError` for an arm without links, two joints with the same name, or a gravity that
    is not finite.
    """

    name: str
    links: tuple[Link, ...]
    gravity_m_s2: Three = (0.0, -9.80665, 0.0)

    def __post_init__(self) -> None:
        check_name("name", self.name, "finger")
        if not self.links:
            raise LinkError(f"arm {self.name!r}: has no links; give it at least one")
        names = self.joints
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise LinkError(f"arm {self.name!r}: more than one joint has the name {twice[0]!r}")
        if len(self.gravity_m_s2) != 3 or not all(map(math.isfinite, self.gravity_m_s2)):
            raise LinkError(
                f"arm {self.name!r}: gravity {self.gravity_m_s2!r}; expected three finite numbers"
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, from the base outwards."""
        return tuple(link.joint for link in self.links)

    @property
    def degrees(self) -> int:
        """Number of joints."""
        return len(self.links)

    def joint(self, name: str) -> int:
        """Index of a joint. Raises `LinkError` for an unknown name."""
        if name in self.joints:
            return self.joints.index(name)
        near = difflib.get_close_matches(name, self.joints, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(self.joints)}"
        raise LinkError(f"arm {self.name!r}: unknown joint {name!r}; {hint}")

    def with_link(self, joint: str, **changes: object) -> Arm:
        """The same arm with fields of one link changed, e.g. `mass_kg=0.02`."""
        index = self.joint(joint)
        known = [field.name for field in dataclasses.fields(Link)]
        for key in changes:
            if key not in known:
                raise LinkError(f"link of joint {joint!r}: no field {key!r}; {', '.join(known)}")
        changed = dataclasses.replace(self.links[index], **changes)  # type: ignore[arg-type]
        return dataclasses.replace(
            self, links=(*self.links[:index], changed, *self.links[index + 1 :])
        )

    def without_link(self, joint: str) -> Arm:
        """The same arm with one link without mass and length (thesis, 2.4)."""
        return self.with_link(
            joint, mass_kg=0.0, a_m=0.0, d_m=0.0, com_m=(0.0,) * 3, inertia_kg_m2=(0.0,) * 6
        )

    def with_payload(self, mass_kg: float) -> Arm:
        """The same arm with a point mass at its tip, the origin of the last link's frame."""
        if not (math.isfinite(mass_kg) and mass_kg >= 0.0):
            raise LinkError(f"arm {self.name!r}: payload {mass_kg!r} kg; expected 0 or more")
        last = self.links[-1]
        total = last.mass_kg + mass_kg
        if total == 0.0:
            return self
        old = np.array(last.com_m)
        com = old * (last.mass_kg / total)
        body = tensor(last.inertia_kg_m2)
        for mass, arm in ((last.mass_kg, old - com), (mass_kg, -com)):
            body = body + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return self.with_link(
            last.joint,
            mass_kg=total,
            com_m=tuple(float(v) for v in com),
            inertia_kg_m2=elements(body),
        )

    def without_damping(self) -> Arm:
        """The same arm with frictionless joints; it conserves energy."""
        return dataclasses.replace(
            self, links=tuple(dataclasses.replace(k, damping_n_m_s=0.0) for k in self.links)
        )

    @cached_property
    def table(self) -> Array:
        """Parameters for `kernel`, shape (n, 16); do not write to it."""
        rows = [
            [*k.twist, k.a_m, k.d_m, k.offset_rad, k.mass_kg, *k.com_m, *k.inertia_kg_m2]
            for k in self.links
        ]
        damping = [k.damping_n_m_s for k in self.links]
        return np.column_stack([np.array(rows, dtype=np.float64), damping])

    @cached_property
    def gravity(self) -> Array:
        """`gravity_m_s2` as an array; do not write to it."""
        return np.array(self.gravity_m_s2, dtype=np.float64)
