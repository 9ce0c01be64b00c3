"""Proportional regulators in a rig file: the keys of their table, and the file of their dynamics.

The file is what ``pamrig calibrate regulator`` writes.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from analysis.regression.regulator import Regulator
from daq.calibration import MOST_DAYS, Calibration
from daq.errors import ConfigError
from daq.wholefile import write_whole
from rigs.rigfile.toml_reader import Table, load_toml

SIGNALS = {"0-10 V": (0.0, 10.0), "0-5 V": (0.0, 5.0), "4-20 mA": (4.0, 20.0)}
OUT_ZERO = 65536
"""The firmware's ``out_zero_x16`` for an output of 0 at set-point 0."""
TOP_COUNT = 4095
"""The controller's analogue output has 12 bits here, and sixteenths of a count."""
ACCURACY = 0.01
"""Of the full scale, where the rig file states nothing."""


@dataclass(frozen=True)
class MonitorForm:
    """A regulator's own reading: how often it is asked for, and how long an answer may take."""

    quantity: str
    unit: str
    rate_hz: float
    timeout_s: float


@dataclass(frozen=True)
class SerialRegulator:
    """Keys that serial regulators share: full scale, accuracy, and their own reading."""

    full_kpa: float
    accuracy_kpa: float
    form: MonitorForm


@dataclass(frozen=True)
class Dynamics:
    """Identified dynamics with standard uncertainties by name, and the file they came from."""

    regulator: Regulator
    u: dict[str, float]
    date: str
    path: str
    valid_days: int = 0

    def to_dict(self) -> dict[str, Any]:
        """For run.json."""
        return {**_finite(vars(self.regulator)), "u": dict(self.u), "date": self.date}


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def read_monitor(t: Table) -> SerialRegulator:
    """The keys that serial regulators share."""
    full = t.number("full_kpa", 1, 2000, unit="kPa")
    return SerialRegulator(
        full,
        t.number("accuracy_kpa", 0, 100, ACCURACY * full, unit="kPa"),
        MonitorForm(
            "regulator_kpa",
            "kPa",
            t.number("monitor_hz", 0.1, 20, 5.0, unit="1/s"),
            t.number("timeout_s", 0.02, 5, 0.2, unit="s"),
        ),
    )


def check_reach(file: str, limit_kpa: float, full_kpa: float) -> None:
    """Refuse a rig whose limit is above what its regulator can set.

    Raises:
        ConfigError: names file and key.
    """
    if limit_kpa > full_kpa * (1.0 + 1e-9):
        raise ConfigError(
            f"{file}: limits.pressure_kpa",
            f"{limit_kpa:g} kPa is above what the regulator can set ({full_kpa:.4g} kPa)",
            "lower the limit, or correct the keys of [pressure_source]",
        )


def read_analogue(t: Table, limit_kpa: float) -> tuple[Calibration, float]:
    """Counts of the controller's output to kPa for a regulator on an analogue line; its accuracy.

    ``signal`` and ``range_kpa`` are the regulator's input and the pressures at its ends;
    ``conditioner`` is what the conditioner between output and regulator gives at count 0 and 4095.

    Raises:
        ConfigError: a key is missing or wrong, or the output cannot reach a pressure from 0 to the
            rig's limit.
    """
    low, high = SIGNALS[t.text("signal", choices=tuple(SIGNALS))]
    unit = "mA" if high == 20.0 else "V"
    span = t.numbers("range_kpa", -100, 2000, unit="kPa", least=2)
    given = t.numbers("conditioner", -30, 30, unit=unit, least=2)
    for key, pair in (("range_kpa", span), ("conditioner", given)):
        if len(pair) != 2 or not pair[0] < pair[1]:
            raise t.fail(key, f"expected [low, high], got {list(pair)}")
    per_unit = (span[1] - span[0]) / (high - low)
    bottom = span[0] + (given[0] - low) * per_unit
    top = span[0] + (min(given[1], high) - low) * per_unit
    if bottom > 0.0 or top < limit_kpa * (1.0 - 1e-9):
        raise t.fail(
            "conditioner",
            f"{given[0]:g} to {given[1]:g} {unit} reach {bottom:.1f} to {top:.1f} kPa, and 0 to"
            f" {limit_kpa:g} kPa are needed (limits.pressure_kpa)",
            "correct the conditioner or the limit",
        )
    scale = (given[1] - given[0]) * per_unit / TOP_COUNT
    accuracy = t.number("accuracy_kpa", 0, 100, ACCURACY * (span[1] - span[0]), unit="kPa")
    output = Calibration("setpoint_kpa", "kPa", "count", bottom, scale, id="analogue output")
    return output, accuracy


def output_parameters(output: Calibration | None, transducer: Calibration) -> dict[str, int]:
    """What the firmware is set to so that its output follows a set-point in transducer counts.

    Args:
        output: counts of the output to kPa; None for a regulator that has the transducer's scale.
        transducer: counts of the transducer to kPa.
    """
    if output is None:
        return {}
    return {
        "out_scale": round(4096 * transducer.scale / output.scale),
        "out_zero_x16": OUT_ZERO + round(16 * float(output.raw(transducer.offset))),
    }


NAMES = tuple(f.name for f in fields(Regulator))
UNITS = {"s": "s", "kpa": "kPa"}
LOWEST = {"offset_kpa": -1000.0, "gain_error": -1.0}


def load_dynamics(name: str, rig_source: str, serial: str = "") -> Dynamics:
    """Read the file of a regulator's dynamics that a rig file names.

    Args:
        name: path, relative to the rig file's folder.
        rig_source: the rig file.
        serial: the regulator it must be of; "" for any.

    Raises:
        ConfigError: missing, damaged, or of another regulator.
    """
    path = Path(name)
    if not path.is_absolute() and os.path.exists(Path(rig_source).parent / path):
        path = Path(rig_source).parent / path
    t = load_toml(str(path), "rigs")
    found = t.text("quantity")
    if found != "regulator dynamics":
        raise ConfigError(
            f"{rig_source}: pressure_source.dynamics", f"{name} holds {found}", "name another file"
        )
    of = t.text("regulator", "")
    if serial and of and serial != of:
        raise ConfigError(
            f"{rig_source}: pressure_source.dynamics",
            f"{name} is of regulator {of}, the rig has {serial}",
            "calibrate this regulator, or name its file",
        )
    values = t.table("values")
    numbers = {key: values.number(key, LOWEST.get(key, 0.0), 1e6) for key in NAMES
               if key != "slew_kpa_s"}  # fmt: skip
    slew = values.number("slew_kpa_s", 1e-3, 1e6) if "slew_kpa_s" in values else math.inf
    values.finish()
    if numbers["time_constant_s"] <= 0.0:
        raise values.fail("time_constant_s", "must be above 0")
    u = t.table("standard_uncertainties")
    uncertain = {key: u.number(key, 0.0, 1e6) for key in NAMES if key in u}
    u.finish()
    date = t.text("date", "")
    valid_days = t.integer("valid_days", 0, MOST_DAYS, 0)
    for key in ("record", "note", "misfit_kpa", "ramp_kpa", "replicates", "slew_above_kpa_s"):
        t.raw(key, None)
    t.finish()
    return Dynamics(Regulator(slew_kpa_s=slew, **numbers), uncertain, date, str(path), valid_days)


def write_dynamics(
    path: Path, found: Regulator, u: dict[str, float], about: dict[str, Any], overwrite: bool
) -> None:
    """Write such a file.

    Args:
        path: where.
        found, u: the values and their standard uncertainties.
        about: date, regulator, record, note and figures of merit.
        overwrite: replace an existing file.

    Raises:
        ConfigError: the file exists, or cannot be written.
    """
    if path.exists() and not overwrite:
        raise ConfigError(str(path), "exists already", "choose another --out, or add --replace")
    lines = [
        "# Dynamics of a proportional regulator as mounted: regulator, line and muscle together.",
        "# Uncertainties are standard (k = 1).",
        'quantity = "regulator dynamics"',
        *(f"{key} = {json.dumps(value)}" for key, value in about.items()),
        "",
        "[values]",
        *(f"{k} = {v:.6g}" for k, v in vars(found).items() if math.isfinite(v)),
        "",
        "[standard_uncertainties]",
        *(f"{k} = {v:.3g}" for k, v in u.items() if math.isfinite(v)),
    ]
    try:
        write_whole(path, "\n".join(lines) + "\n")
    except OSError as error:
        raise ConfigError(str(path), f"cannot be written: {error.strerror}") from None
