"""The table ``[joint]`` of a rig file: a joint between two muscles, and what reads it.

Muscle a is behind the controller ``[valve]``, muscle b behind ``[valve_b]``. Muscle a pulls towards
larger angles. A torque is positive towards larger angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rigs.rigfile.instruments import InstrumentSettings
from rigs.rigfile.toml_reader import Table

LOAD_CELL = "load_cell"
ANGLE, TORQUE = "angle_deg", "torque_n_m"
STALE_S = 0.5
TORQUE_STALE_S = 2.0
"""A gauge that is asked for its readings is left alone for a while after a late answer."""
NOT_HERE = ("balance", "stage", "force_source")
"""Tables and keys of a bench with one muscle."""


@dataclass(frozen=True)
class JointSettings:
    """A joint: which instruments read angle and torque, and its limits.

    Attributes:
        angle: instrument that reads ``angle_deg``.
        torque: instrument that reads ``torque_n_m``, or ``load_cell`` at the end of a lever; ""
            where no torque is read.
        low_deg, high_deg: a run ends, and both muscles are vented, outside this range.
        limit_n_m: likewise above this torque, in either direction.
        stale_s: how long the angle may be silent.
        lever_mm, u_lever_mm: of the load cell, with its standard uncertainty; 0 without one.
        radius_mm, u_radius_mm: lever arm of both muscles; 0 where the file does not state it.
        rest_mm: length of either muscle at angle 0; 0 where the file does not state it.
    """

    angle: str
    torque: str
    low_deg: float
    high_deg: float
    limit_n_m: float
    stale_s: float = STALE_S
    lever_mm: float = 0.0
    u_lever_mm: float = 0.0
    radius_mm: float = 0.0
    u_radius_mm: float = 0.0
    rest_mm: float = 0.0

    @property
    def instruments(self) -> tuple[str, ...]:
        """Names of those that a test cannot do without."""
        return (self.angle, self.torque) if self.torque else (self.angle,)

    def silence_s(self, instrument: str) -> float:
        """How long an instrument of the joint may be silent."""
        return self.stale_s if instrument == self.angle else max(self.stale_s, TORQUE_STALE_S)

    def as_dict(self) -> dict[str, float | str]:
        """Plain values for run.json."""
        return dict(vars(self))


def read_joint(root: Table, instruments: InstrumentSettings) -> JointSettings | None:
    """The table of a rig file; None where there is neither it nor a second controller.

    Raises:
        ConfigError: a table is missing, or does not fit the rest of the file.
    """
    for one, other in (("joint", "valve_b"), ("valve_b", "joint")):
        if one in root and other not in root:
            raise root.fail(other, f"[{one}] needs it as well", "see docs/use/joint.md")
    if "joint" not in root:
        return None
    for key in NOT_HERE:
        if key in root:
            raise root.fail(key, "does not belong to a rig with [joint]", "remove it")
    if "camera" in root and not instruments.marks:
        raise root.fail(
            "camera", "does not belong to a rig with [joint] whose angle no marks give",
            'remove it, or add an instrument with protocol = "marks"',
        )  # fmt: skip
    t = root.table("joint")
    units = {name: d.form.quantity for name, d in instruments.readers().items()}
    angle = _reads(t, "angle", units, ANGLE)
    torque = t.text("torque", "")
    lever = 0.0
    if torque == LOAD_CELL and LOAD_CELL in units:
        lever = t.number("lever_mm", 0.1, 5000, unit="mm")
    elif torque:
        _reads(t, "torque", units, TORQUE)
    ends = t.numbers("range_deg", -360, 360, unit="deg", least=2)
    if len(ends) != 2 or not ends[0] < ends[1]:
        raise t.fail("range_deg", f"expected [lowest, highest], got {list(ends)}")
    out = JointSettings(
        angle,
        torque,
        low_deg=ends[0],
        high_deg=ends[1],
        limit_n_m=t.number("torque_n_m", 1e-3, 1e5, unit="N m"),
        stale_s=t.number("stale_s", 0.1, 60, STALE_S, unit="s"),
        lever_mm=lever,
        u_lever_mm=t.number("u_lever_mm", 0, 100, 0.0, unit="mm") if lever else 0.0,
        radius_mm=t.number("radius_mm", 0, 5000, 0.0, unit="mm"),
        u_radius_mm=t.number("u_radius_mm", 0, 100, 0.0, unit="mm"),
        rest_mm=t.number("rest_mm", 0, 5000, 0.0, unit="mm"),
    )
    t.finish()
    for name in out.instruments:
        rate_hz = instruments.readers()[name].form.rate_hz
        if rate_hz * out.silence_s(name) < 2.0:
            raise t.fail(
                "stale_s",
                f"is {out.stale_s:g} s; {name} gives a reading every {1.0 / rate_hz:g} s",
                "allow two readings at least",
            )
    return out


def _reads(t: Table, key: str, units: Mapping[str, str], quantity: str) -> str:
    """The instrument that a key names, which must read this quantity."""
    name = t.text(key)
    if units.get(name) != quantity:
        fit = ", ".join(n for n, found in units.items() if found == quantity) or "none"
        what = f"reads {units[name]}" if name in units else "is no instrument of this rig"
        raise t.fail(key, f"{name!r} {what}", f"instruments that read {quantity}: {fit}")
    return name
