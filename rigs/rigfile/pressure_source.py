"""Which kinds of pressure source there are, and the table ``[pressure_source]`` of a rig file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from daq.calibration import Calibration
from daq.user_program import installed, load_installed
from rigs.rigfile.device import Device
from rigs.rigfile.tables.regulator import Dynamics, load_dynamics, read_analogue
from rigs.rigfile.toml_reader import Table

MODULES: dict[str, str] = {
    "solenoids": "solenoids",
    "regulator-output": "regulator_output",
    "hand-regulator": "hand_regulator",
    "analogue-regulator": "analogue_regulator",
    "alicat-pcd": "proportional.alicat_pcd",
    "smc-itv": "proportional.smc_itv",
    "card-output": "card_output",
}
"""Kind in a rig file to module.

The module of that name in ``rigs.devices.pressure`` holds ``open_source(parts)``. A kind that is
not of ``WITHOUT_PORT`` has a port, and a module of the same name in ``rigs.virtual.emulators`` with
``emulator(settings, plant, send)``.
"""

GROUP = "pamrig.pressure_sources"
"""Entry points of installed packages: kind to a module with ``open_source`` and, for the virtual
bench, ``emulator``. Such a kind has a port."""

WITHOUT_PORT = (
    "solenoids", "regulator-output", "hand-regulator", "analogue-regulator", "card-output"
)  # fmt: skip
PROPORTIONAL = ("analogue-regulator", "alicat-pcd", "smc-itv")
"""Kinds whose own loop makes the pressure; `pamrig calibrate regulator` identifies them."""
SENSOR_LAG_S = 0.5
SENSOR_STALE_S = 1.5
SENSOR_KEYS = ("sensor", "sensor_band_kpa", "sensor_lag_s", "sensor_stale_s")
CONTROLLER = "controller"
"""The sensor of a rig file that names no other."""
SCHEME = {"solenoids": "pwm", "regulator-output": "reg", "analogue-regulator": "reg",
          "alicat-pcd": "reg", "smc-itv": "reg", "card-output": "reg"}  # fmt: skip
"""The controller's scheme that a kind needs; a driver with a port checks it by itself."""


@dataclass(frozen=True)
class PressureSourceSettings(Device):
    """The pressure source of a rig; ``port`` is empty for one without a port of its own.

    ``output`` turns counts of the controller's analogue output into the set-point of a regulator
    there (None: it has the transducer's scale), ``accuracy_kpa`` is how far that regulator may
    rest from it. ``dynamics`` is what `pamrig calibrate regulator` found, None where no file is
    named.

    ``own`` are the keys that only its driver knows; :meth:`table` reads them.

    ``sensor`` names the instrument whose reading is the pressure of a test; empty for the
    controller's own. ``sensor_band_kpa`` is how far the two may differ (0: as their calibrations
    allow), ``sensor_lag_s`` how late its readings are at most, ``sensor_stale_s`` how long it may
    be silent.
    """

    kind: str = "solenoids"
    sensor: str = ""
    sensor_band_kpa: float = 0.0
    sensor_lag_s: float = SENSOR_LAG_S
    sensor_stale_s: float = SENSOR_STALE_S
    own: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    output: Calibration | None = None
    accuracy_kpa: float = 0.0
    dynamics: Dynamics | None = None

    def table(self) -> Table:
        """The driver's own keys; who reads them calls ``finish()`` at the end."""
        return Table(dict(self.own), self.file, "pressure_source")


def read_pressure_source(
    root: Table, scheme: str, by_hand: bool, limit_kpa: float
) -> PressureSourceSettings:
    """The table of a rig file, or what its other tables imply where there is none.

    Args:
        root: the rig file.
        scheme: ``valve.static_scheme``.
        by_hand: whether there is a ``[manual.pressure]``.
        limit_kpa: ``limits.pressure_kpa``.

    Raises:
        ConfigError: unknown kind, or one that does not fit the rest of the file.
    """
    implied = {"pwm": "solenoids", "reg": "regulator-output"}[scheme]
    implied = "hand-regulator" if by_hand else implied
    if "pressure_source" not in root:
        return PressureSourceSettings("", 0, "", implied, file=root.source)
    t = root.table("pressure_source")
    kind = t.text("kind", implied)
    if kind not in MODULES and kind not in installed(GROUP):
        raise t.fail("kind", f"{kind!r} is not one of {', '.join((*MODULES, *installed(GROUP)))}")
    named = t.text("sensor", CONTROLLER)
    sensor: dict[str, Any] = {}
    if named != CONTROLLER:
        sensor = {
            "sensor": named,
            "sensor_band_kpa": t.number("sensor_band_kpa", 0, 1000, 0.0, unit="kPa"),
            "sensor_lag_s": t.number("sensor_lag_s", 0.05, 10, SENSOR_LAG_S, unit="s"),
            "sensor_stale_s": t.number("sensor_stale_s", 0.1, 60, SENSOR_STALE_S, unit="s"),
        }
    if kind == "hand-regulator" and not by_hand:
        raise t.fail("kind", "needs the table [manual.pressure]", "add it (docs/instruments.md)")
    if by_hand and kind != "hand-regulator":
        raise t.fail("kind", f"is {kind!r}, and [manual.pressure] is there too", "remove one")
    if SCHEME.get(kind, scheme) != scheme:
        raise t.fail("kind", f'{kind!r} needs valve.static_scheme = "{SCHEME[kind]}"', "change one")
    if "dynamics" in t:
        serial = t.ascii("serial", "") if kind not in WITHOUT_PORT else ""
        sensor["dynamics"] = load_dynamics(t.text("dynamics"), root.source, serial)
    if kind == "analogue-regulator":
        sensor["output"], sensor["accuracy_kpa"] = read_analogue(t, limit_kpa)
    if kind in WITHOUT_PORT:
        t.finish()
        return PressureSourceSettings("", 0, "", kind, file=root.source, **sensor)
    common = ("kind", "port", "baud", "serial", "dynamics", *SENSOR_KEYS)
    return PressureSourceSettings(
        t.text("port"),
        t.integer("baud", 300, 4_000_000, 9600),
        t.ascii("serial", ""),
        kind=kind,
        own={key: t.raw(key) for key in t.keys() if key not in common},  # noqa: SIM118
        file=root.source,
        **sensor,
    )


def source_module(kind: str, package: str) -> Any:
    """The module of a kind: that in ``package``, or the one that an installed package brings.

    Raises:
        ConfigError: the installed package cannot be loaded.
    """
    if kind in MODULES:
        return import_module(f"{package}.{MODULES[kind]}")
    return load_installed(GROUP, kind)
