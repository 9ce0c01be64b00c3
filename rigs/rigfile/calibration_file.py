"""A calibration as a TOML file: written by `pamrig calibrate`, named by a rig file."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.calibration import MOST_DAYS, Calibration
from daq.errors import ConfigError
from daq.wholefile import write_whole
from rigs.rigfile.toml_reader import Table, load_toml

NO_SERIAL = (
    '# instrument = "..."  # serial number of the sensor, which did not report one; a rig with'
    " another one refuses this file"
)


@dataclass(frozen=True)
class CalibrationFile:
    """What such a file holds.

    Attributes:
        calibration: offset, scale, uncertainty, domain, identity and date.
        instrument: serial number of the calibrated instrument, "" when it has none.
        linearity: largest residual of the fit, in the calibration's unit.
        reference: what it was calibrated against, with its own identity.
        path: where it was read from.
    """

    calibration: Calibration
    instrument: str
    linearity: float
    reference: str
    path: str = ""


def read_fields(t: Table, quantity: str, unit: str, raw_unit: str) -> Calibration:
    """The keys that a calibration has in a rig file and in a file of its own."""
    low, high = t.numbers("domain", -1e6, 1e6, least=2)[:2]
    scale = t.number("scale", -1e6, 1e6)
    if scale == 0:
        raise t.fail("scale", "a scale of 0 makes every reading the same")
    return Calibration(
        quantity=quantity,
        unit=t.text("unit", choices=(unit,) if unit else None),
        raw_unit=t.text("raw_unit", choices=(raw_unit,) if raw_unit else None),
        offset=t.number("offset", -1e6, 1e6),
        scale=scale,
        u_offset=t.number("u_offset", 0, 1e6, unit=unit),
        u_gain=t.number("u_gain", 0, 1),
        domain=(low, high),
        id=t.text("id"),
        date=t.text("date"),
        note=t.text("note", ""),
        valid_days=t.integer("valid_days", 0, MOST_DAYS, 0),
    )


def load_calibration(
    name: str, rig_source: str, quantity: str, raw_unit: str = "", serial: str = ""
) -> CalibrationFile:
    """Read a calibration file that a rig file names.

    Args:
        name: path, relative to the rig file's folder.
        rig_source: the rig file, for messages and as the folder.
        quantity: what it must calibrate.
        raw_unit: unit of the readings it must take; "" for any.
        serial: the instrument it must be of; "" for any.

    Raises:
        ConfigError: missing, of another quantity or of another instrument.
    """
    path = Path(name)
    if not path.is_absolute() and os.path.exists(Path(rig_source).parent / path):
        path = Path(rig_source).parent / path
    t = load_toml(str(path), "rigs")
    found = t.text("quantity")
    if found != quantity:
        raise ConfigError(
            f"{rig_source}: calibration = {name!r}",
            f"the file calibrates {found}, not {quantity}",
            "name the right file",
        )
    instrument = t.text("instrument", "")
    if serial and instrument and serial != instrument:
        raise ConfigError(
            f"{rig_source}: calibration = {name!r}",
            f"the file is of instrument {instrument}, the rig has {serial}",
            "calibrate this instrument, or name its file",
        )
    calibration = read_fields(t, quantity, "", raw_unit)
    out = CalibrationFile(
        calibration=calibration,
        instrument=instrument,
        linearity=t.number("linearity", 0, 1e6, 0.0),
        reference=t.text("reference", ""),
        path=str(path),
    )
    t.raw("points")
    t.finish()
    return out


def write_calibration(
    path: Path,
    file: CalibrationFile,
    points: Sequence[tuple[float, float, float]],
    overwrite: bool = False,
) -> None:
    """Write a calibration file.

    Args:
        path: where; an existing file is only replaced when ``overwrite`` says so.
        file: what it holds.
        points: (reading, reference, residual) of each point.

    Raises:
        ConfigError: the file exists, or cannot be written.
    """
    if path.exists() and not overwrite:
        raise ConfigError(str(path), "exists already", "choose another --out, or add --replace")
    c = file.calibration
    rows = ",\n".join(f"    [{raw:.9g}, {ref:.9g}, {res:.4g}]" for raw, ref, res in points)
    days = f"valid_days = {c.valid_days}\n" if c.valid_days else ""
    instrument = f"instrument = {json.dumps(file.instrument)}" if file.instrument else NO_SERIAL
    text = f"""# {c.unit} = offset + scale * {c.raw_unit}; uncertainties are standard (k = 1).
quantity = {json.dumps(c.quantity)}
id = {json.dumps(c.id)}
date = {json.dumps(c.date)}
{instrument}
reference = {json.dumps(file.reference)}
unit = {json.dumps(c.unit)}
raw_unit = {json.dumps(c.raw_unit)}
offset = {c.offset!r}
scale = {c.scale!r}
u_offset = {c.u_offset:.6g}
u_gain = {c.u_gain:.6g}
domain = [{float(c.domain[0])!r}, {float(c.domain[1])!r}]
linearity = {file.linearity:.6g}
note = {json.dumps(c.note)}
{days}# reading in {c.raw_unit}, reference in {c.unit}, residual in {c.unit}
points = [
{rows},
]
"""
    try:
        write_whole(path, text)
    except OSError as error:
        raise ConfigError(
            str(path), f"cannot be written: {error.strerror}", "choose another --out"
        ) from None
