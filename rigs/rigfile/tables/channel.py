"""[channels.NAME] of a rig file: sensors on the valve controller's further inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from daq.calibration import Calibration
from rigs.rigfile.calibration_file import load_calibration
from rigs.rigfile.device import Device
from rigs.rigfile.form import STANDARD_GRAVITY_M_S2
from rigs.rigfile.toml_reader import Table

QUANTITIES = {
    "force_n": "N", "length_mm": "mm", "pressure_kpa": "kPa", "temperature_c": "degC",
    "angle_deg": "deg", "torque_n_m": "N m",
}  # fmt: skip
CHIPS = ("hx711", "ads1232", "ads1115", "encoder", "analogue")
BRIDGES = ("hx711", "ads1232")
BRIDGE_SETTING = {("hx711", 128): 1, ("hx711", 64): 2, ("hx711", 32): 3, ("ads1232", 0): 4}
MULTIPLEXER = ("0-1", "0-3", "1-3", "2-3", "0", "1", "2", "3")
RANGES_V = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
ANALOGUE = ("second", "third")
ENDS = {
    "hx711": (-(2**23), 2**23 - 1),
    "ads1232": (-(2**23), 2**23 - 1),
    "ads1115": (-(2**15), 2**15 - 1),
    "encoder": (-(2**31), 2**31 - 1),
    "analogue": (0, 4095),
}
"""First and last reading of each, counts."""
MOST_READINGS_S = 180.0
"""So many fit on the serial line beside the telemetry: 9 bytes each of the 2.3 kB/s that it leaves,
and a frame around a dozen of them."""
GRAMS_PER_N = 1000.0 / STANDARD_GRAVITY_M_S2


@dataclass(frozen=True)
class ChannelForm:
    """What an input measures: its quantity, in counts as it comes, and how often."""

    quantity: str
    rate_hz: float
    unit: str = "count"


@dataclass(frozen=True)
class ControllerChannel(Device):
    """One sensor on an input of the controller; ``serial`` is that of the sensor.

    Attributes:
        chip: one of ``CHIPS``.
        input: which of the controller's inputs (``valvefw.wire.INPUTS``).
        gain: of a bridge converter.
        multiplexer, range_v: of an ADS1115: which of its pins, and its range.
        form, calibration: from counts to the quantity.
    """

    chip: str
    input: str
    form: ChannelForm
    calibration: Calibration
    gain: int = 0
    multiplexer: str = ""
    range_v: float = 0.0


def read_channels(root: Table, taken: tuple[str, ...]) -> dict[str, ControllerChannel]:
    """The tables of a rig file, by name.

    Args:
        root: the file.
        taken: names of its other instruments.

    Raises:
        ConfigError: names file, key, what is wrong and what to do.
    """
    group = root.table("channels", optional=True)
    out: dict[str, ControllerChannel] = {}
    used: dict[str, str] = {}
    own = ("valve", "valve_b", "balance", "load_cell", "stage", "camera", "supply", "card")
    for name in group.keys():  # noqa: SIM118
        if not name.isidentifier() or name in (*taken, *own):
            raise group.fail(name, "is not a valid name for a stream, or is another's")
        t = group.table(name)
        channel = _channel(t)
        if channel.input in used:
            raise t.fail(
                "chip", f"has the same pins of the controller as [channels.{used[channel.input]}]",
                "keep one of them",
            )  # fmt: skip
        used[channel.input] = name
        t.finish()
        out[name] = channel
    group.finish()
    total = sum(channel.form.rate_hz for channel in out.values())
    if total > MOST_READINGS_S:
        raise root.fail(
            "channels",
            f"{total:g} readings a second together; the serial line has room for"
            f" {MOST_READINGS_S:g} beside the pressure",
            "lower a rate_hz",
        )
    return out


def _channel(t: Table) -> ControllerChannel:
    chip = t.text("chip", choices=CHIPS)
    quantity = t.text("quantity", choices=tuple(QUANTITIES))
    if chip in BRIDGES:
        rate_hz = t.number("rate_hz", 10, 80, unit="1/s")
        if rate_hz not in (10.0, 80.0):
            raise t.fail("rate_hz", f"{rate_hz:g} is not 10 or 80", "take what its rate pin sets")
    elif chip == "ads1115":
        rate_hz = t.number("rate_hz", 1, 125, unit="1/s")
    else:
        rate_hz = t.number("rate_hz", 1, 100, unit="1/s")
    gain = t.integer("gain", 1, 128, 128) if chip in BRIDGES else 0
    allowed = (32, 64, 128) if chip == "hx711" else (1, 2, 64, 128)
    if gain and gain not in allowed:
        raise t.fail("gain", f"{gain} is not one of {', '.join(map(str, allowed))}")
    which = {"ads1115": "adc16", "encoder": "encoder"}.get(chip, "bridge")
    if chip == "analogue":
        which = t.text("input", "second", choices=ANALOGUE)
    serial = t.ascii("serial", "")
    range_v = t.number("range_v", 0.256, 6.144, 2.048, unit="V") if chip == "ads1115" else 0.0
    if range_v and range_v not in RANGES_V:
        raise t.fail("range_v", f"{range_v:g} is not one of {', '.join(map(str, RANGES_V))}")
    return ControllerChannel(
        "valve", 115200, serial,
        chip=chip,
        input=which,
        form=ChannelForm(quantity, rate_hz),
        calibration=_calibration(t, quantity, chip, serial),
        gain=gain,
        multiplexer=t.text("input", "0-1", choices=MULTIPLEXER) if chip == "ads1115" else "",
        range_v=range_v,
    )  # fmt: skip


def _calibration(t: Table, quantity: str, chip: str, serial: str) -> Calibration:
    """Of a file, or as stated in the table; the ends of the converter bound what it reads."""
    if "calibration" in t:
        return load_calibration(
            t.text("calibration"), t.source, quantity, "count", serial
        ).calibration
    unit = QUANTITIES[quantity]
    offset, scale = t.number("offset", -1e6, 1e6, 0.0), t.number("scale", -1e6, 1e6)
    if scale == 0:
        raise t.fail("scale", "a scale of 0 makes every reading the same")
    ends = sorted(offset + scale * count for count in ENDS[chip])
    return Calibration(
        quantity=quantity,
        unit=unit,
        raw_unit="count",
        offset=offset,
        scale=scale,
        u_offset=t.number("u_offset", 0, 1e6, 0.0, unit=unit),
        u_gain=t.number("u_gain", 0, 1, 0.0),
        domain=(t.number("low", -1e9, 1e9, ends[0]), t.number("high", -1e9, 1e9, ends[1])),
        id=t.text("id", "as stated in the rig file"),
        date=t.text("date", ""),
    )


def net_grams(cell: Calibration) -> tuple[float, Calibration]:
    """A load cell on the controller as a force sensor that is tared: grams a count, g to N.

    A test tares it, so that only its scale counts; what is uncertain about zero stays.
    """
    calibration = Calibration(
        quantity=cell.quantity, unit=cell.unit, raw_unit="g", offset=0.0, scale=1.0 / GRAMS_PER_N,
        u_offset=cell.u_offset, u_gain=cell.u_gain, domain=cell.domain, id=cell.id, date=cell.date,
        note=cell.note,
    )  # fmt: skip
    return cell.scale * GRAMS_PER_N, calibration


def channel_parameters(channels: Mapping[str, ControllerChannel]) -> dict[str, int]:
    """What the firmware is set to; nothing for a rig without such channels."""
    if not channels:
        return {}
    out = {"bridge": 0, "adc16": 0, "encoder_ms": 0, "second_ms": 0, "third_ms": 0}
    for channel in channels.values():
        period_ms = round(1000.0 / channel.form.rate_hz)
        if channel.chip in BRIDGES:
            gain = channel.gain if channel.chip == "hx711" else 0
            fast = 4 if channel.form.rate_hz == 80.0 else 0
            out["bridge"] = BRIDGE_SETTING[channel.chip, gain] + fast
        elif channel.chip == "ads1115":
            pins, range_v = MULTIPLEXER.index(channel.multiplexer), RANGES_V.index(channel.range_v)
            out["adc16"] = 1 + pins + 8 * range_v
            out["adc16_ms"] = period_ms
        else:
            out[f"{channel.input}_ms"] = period_ms
    return out
