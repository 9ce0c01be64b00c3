"""A controller of your own that prints columns: what stands in a line, and what it can be sent."""

from __future__ import annotations

import re
from dataclasses import dataclass

from daq.calibration import Calibration
from rigs.rigfile.device import Device
from rigs.rigfile.toml_reader import Table, load_toml

QUANTITIES = {"pressure_kpa": "kPa", "force_n": "N", "length_mm": "mm", "temperature_c": "degC"}
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
TIME_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
NUMBER = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")
COUNTER = 2**32
"""millis() and micros() start anew after so many."""
TIME = "time"


@dataclass(frozen=True)
class SetpointForm:
    """The line that sets a pressure: ``command`` with ``{value}`` in kPa, and its confirmation.

    ``confirm`` matches a whole line with the group ``value``; None where the sketch confirms
    nothing. ``high_kpa`` is the highest set-point that is sent.
    """

    command: str
    high_kpa: float
    confirm: re.Pattern[str] | None = None


@dataclass(frozen=True)
class ColumnForm(Device):
    """What such a controller prints.

    Attributes:
        name: of the device.
        columns: quantities in their order; ``time`` where it prints its own.
        delimiter: between the columns.
        time_unit: of its own time, a key of `TIME_S`.
        rate_hz: lines a second.
        checksum: True where two hexadecimal digits after ``*`` hold the exclusive or of the line.
        latency_ms: how long the adapter may hold bytes back.
        calibrations: turn the printed number into the quantity.
        limit_kpa: above it the recording ends; 0 for none.
        setpoint: None where it cannot be set.
        text: of the file.
    """

    name: str
    columns: tuple[str, ...]
    delimiter: str
    time_unit: str
    rate_hz: float
    checksum: bool
    latency_ms: float
    calibrations: dict[str, Calibration]
    limit_kpa: float
    setpoint: SetpointForm | None
    source: str
    text: str

    @property
    def channels(self) -> tuple[str, ...]:
        """The columns that are quantities."""
        return tuple(name for name in self.columns if name != TIME)


def load_columns(name: str) -> ColumnForm:
    """Read such a description, given as a path or as a shipped name.

    Raises:
        ConfigError: names file, key, what is wrong and what to do.
    """
    root = load_toml(name, "recorders")
    columns = root.texts("columns", (TIME, *QUANTITIES))
    if len(set(columns)) != len(columns) or set(columns) <= {TIME}:
        raise root.fail("columns", "expected each column once, and one that is measured")
    calibrations = {word: _calibration(root, word) for word in columns if word != TIME}
    setpoint = _setpoint(root) if "setpoint" in root else None
    if setpoint is not None and "pressure_kpa" not in columns:
        raise root.fail("setpoint", "needs the column pressure_kpa", "let the sketch print it")
    out = ColumnForm(
        root.text("port"),
        root.integer("baud", 300, 4_000_000, 115200),
        "",
        name=root.text("name"),
        columns=tuple(columns),
        delimiter=DELIMITERS[root.text("delimiter", "comma", choices=tuple(DELIMITERS))],
        time_unit=root.text("time_unit", "ms", choices=tuple(TIME_S)),
        rate_hz=root.number("rate_hz", 0.1, 2000, unit="1/s"),
        checksum=root.flag("checksum", False),
        latency_ms=root.number("latency_ms", 0, 1000, 16.0, unit="ms"),
        calibrations=calibrations,
        limit_kpa=root.number("limit_kpa", 0, 2000, 0.0, unit="kPa"),
        setpoint=setpoint,
        source=root.source,
        text=str(root.source),
    )
    root.finish()
    return out


def _calibration(root: Table, quantity: str) -> Calibration:
    t = root.table(quantity, optional=True)
    scale = t.number("scale", -1e6, 1e6, 1.0)
    if scale == 0:
        raise t.fail("scale", "a scale of 0 makes every reading the same")
    low, high = t.number("low", -1e9, 1e9, -1e9), t.number("high", -1e9, 1e9, 1e9)
    if low >= high:
        raise t.fail("high", "is not above low")
    made = Calibration(
        quantity=quantity,
        unit=QUANTITIES[quantity],
        raw_unit=t.text("unit", QUANTITIES[quantity]),
        offset=t.number("offset", -1e9, 1e9, 0.0),
        scale=scale,
        u_offset=t.number("u_offset", 0, 1e6, 0.0),
        u_gain=t.number("u_gain", 0, 1, 0.0),
        domain=(low, high),
        id=t.text("id", "as stated in the file"),
        date=t.text("date", ""),
    )
    t.finish()
    return made


def _setpoint(root: Table) -> SetpointForm:
    t = root.table("setpoint")
    command = t.text("command")
    try:
        usable = command.count("{") == 1 and command.format(value=1.5) != command
    except (ValueError, KeyError, IndexError, AttributeError):
        usable = False
    if not usable:
        raise t.fail(
            "command", f"{command!r} is not a line with {{value}}", 'as in "P={value:.1f}"'
        )
    confirm = None
    if "confirm" in t:
        try:
            confirm = re.compile(t.text("confirm"))
        except re.error as error:
            raise t.fail("confirm", f"is no regular expression ({error})") from None
        if "value" not in confirm.groupindex:
            raise t.fail("confirm", "has no group value", "write (?P<value>[0-9.]+)")
    made = SetpointForm(command, t.number("high_kpa", 1, 2000, unit="kPa"), confirm)
    t.finish()
    return made
