"""What sets the muscle's length: the table ``[stage]`` of a rig file."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rigs.rigfile.device import Device
from rigs.rigfile.toml_reader import Table

MANUAL = "manual"
MODULES: dict[str, str] = {"grbl": "grbl", "marlin": "marlin", "zaber": "zaber", "tmcl": "tmcl"}
"""Kind in a rig file to module.

The module of that name in ``rigs.devices.motion`` holds ``open_stage(link, event_loop, device)``,
that in ``rigs.virtual.emulators.motion`` holds ``emulator(device, limits_mm, start_mm, set_motion,
send)``.
"""
IN_COUNTS = ("zaber", "tmcl")
"""Kinds that count microsteps and know nothing of millimetres."""


@dataclass(frozen=True)
class StageDevice(Device):
    """What sets the muscle's length: a motor stage, or a person (kind "manual").

    A stage that counts microsteps has ``counts_per_mm`` (negative where the count falls while the
    muscle gets longer) and ``zero_mm``, the length at count 0. ``address`` is that of the device on
    its line, ``axis`` the number of its axis or motor.
    """

    speed_mm_s: float
    kind: str = "grbl"
    tolerance_mm: float = 0.2
    counts_per_mm: float = 0.0
    zero_mm: float = 0.0
    address: int = 1
    axis: int = 1

    def counts(self, length_mm: float) -> int:
        """The nearest count to a length in mm."""
        return round((length_mm - self.zero_mm) * self.counts_per_mm)

    def length_mm(self, counts: int) -> float:
        """The length in mm at a count."""
        return self.zero_mm + counts / self.counts_per_mm


def read_stage(t: Table) -> StageDevice:
    """The table ``[stage]``.

    Raises:
        ConfigError: unknown kind or key, or a value outside its range.
    """
    kind = t.text("kind", "grbl", choices=(*MODULES, MANUAL))
    if kind == MANUAL:
        tolerance = t.number("tolerance_mm", 0.001, 100, 0.2, unit="mm")
        t.finish()
        return StageDevice("", 0, "", 0.0, kind, tolerance)
    port, baud, serial = t.text("port"), t.integer("baud", 300, 4_000_000), t.ascii("serial", "")
    speed = t.number("speed_mm_s", 0.1, 100, 10.0, unit="mm/s")
    if kind not in IN_COUNTS:
        t.finish()
        return StageDevice(port, baud, serial, speed, kind)
    counts_per_mm = t.number("counts_per_mm", -1e7, 1e7, unit="1/mm")
    if abs(counts_per_mm) < 50:
        raise t.fail(
            "counts_per_mm",
            f"{counts_per_mm:g} is too coarse to set a length within 0.01 mm",
            "use at least 50 (or -50) microsteps a millimetre",
        )
    out = StageDevice(
        port, baud, serial, speed, kind,
        counts_per_mm=counts_per_mm,
        zero_mm=t.number("zero_mm", -5000, 5000, unit="mm"),
        address=t.integer("address", 1, 99 if kind == "zaber" else 255, 1),
        axis=t.integer("axis", 1, 9, 1) if kind == "zaber" else t.integer("axis", 0, 5, 0),
    )  # fmt: skip
    t.finish()
    return out


def stage_module(kind: str, package: str) -> Any:
    """The module of a kind of motor stage in ``package``."""
    return import_module(f"{package}.{MODULES[kind]}")
