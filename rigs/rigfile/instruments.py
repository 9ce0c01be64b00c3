"""The optional tables of a rig file that name further instruments."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from daq.calibration import MOST_DAYS, Calibration
from rigs.rigfile.calibration_file import load_calibration
from rigs.rigfile.command_form import CommandForm, load_command_form
from rigs.rigfile.device import Device
from rigs.rigfile.form import TextForm, load_form, read_form
from rigs.rigfile.modbus_form import KINDS, MOST_REGISTERS, ORDERS, ModbusForm
from rigs.rigfile.tables.channel import ControllerChannel, read_channels
from rigs.rigfile.tables.marks import MarkDevice, read_mark_device
from rigs.rigfile.toml_reader import Table

NAMED = ("thermometer", "load_cell", "flow")
"""Tables of text instruments that the bench knows what to do with; others go below
[instruments]."""
UNITS = {"pressure_kpa": "kPa", "force_n": "N", "length_mm": "mm", "temperature_c": "degC"}
QUANTITY = {
    "thermometer": "temperature_c",
    "load_cell": "force_n",
    "flow": "velocity_m_s",
    "pressure_transmitter": "pressure_kpa",
}

SCALES: dict[str, dict[str, float]] = {
    "force_n": {"kg": 9.80665, "g": 9.80665e-3},
    "torque_n_m": {"Nm": 1.0, "N m": 1.0, "Ncm": 1e-2, "mNm": 1e-3},
}
"""Newtons and newton metres in a unit that indicators print; any other unit of force is one."""


LENGTHS = {"mm": 1.0, "um": 1e-3, "in": 25.4}
"""Millimetres in a unit that displacement sensors print."""


@dataclass(frozen=True)
class TextDevice(Device):
    """A line-based instrument: its description and its calibration.

    ``virtual_value`` is what it reads on the virtual bench where the plant knows no such
    quantity; ``bore_mm`` the bore of the pipe of a flow meter, 0 for others.
    """

    form: TextForm
    rate_hz: float
    calibration: Calibration
    virtual_value: float = 0.0
    bore_mm: float = 0.0


@dataclass(frozen=True)
class ModbusDevice(Device):
    """A Modbus transmitter: its registers and its calibration."""

    form: ModbusForm
    calibration: Calibration


@dataclass(frozen=True)
class CardForm:
    """What a channel of a card measures: its quantity, in V as it comes, at the card's rate."""

    quantity: str
    unit: str
    rate_hz: float


@dataclass(frozen=True)
class CardChannel(Device):
    """One analogue input: its terminal and range in V, and the calibration from V."""

    form: CardForm
    calibration: Calibration
    terminal: str
    range_v: float


Reader = TextDevice | ModbusDevice | CardChannel | ControllerChannel | MarkDevice
"""Whatever gives readings by itself."""


@dataclass(frozen=True)
class CardOutput:
    """An analogue output that sets a pressure regulator."""

    terminal: str
    zero_v: float
    volts_per_kpa: float

    def volts(self, pressure_kpa: float) -> float:
        """The voltage for a pressure."""
        return self.zero_v + self.volts_per_kpa * pressure_kpa


@dataclass(frozen=True)
class CardDevice(Device):
    """A data acquisition card: kind, scans a second, inputs by name, and an output."""

    kind: str
    rate_hz: float
    channels: dict[str, CardChannel]
    output: CardOutput | None


@dataclass(frozen=True)
class SupplyDevice(Device):
    """The bench supply of the solenoids, and the description of the lines that it understands."""

    voltage_v: float
    max_v: float
    form: CommandForm


MANUAL_UNITS = {
    "mass": "kg", "length": "mm", "pressure": "kPa", "temperature": "degC", "angle": "deg",
}  # fmt: skip
"""Units of what tests request of a person; another axis may have any."""


@dataclass(frozen=True)
class ManualAxisSettings:
    """Something that a person sets: which sensor looks after it, and how close is close."""

    quantity: str
    unit: str
    check: str
    tolerance: float


@dataclass(frozen=True)
class LoadSettings:
    """Masses that are hung on the muscle: how well they are known (relative, k = 1), how fast
    the pressure is let down under them, in kPa/s, how far below a load a catch is set, in mm
    (0: there is none), and by what part of ``limits.length_max_mm`` a load may stretch the vented
    muscle beyond it.
    """

    u_mass: float = 1e-4
    lower_kpa_s: float = 150.0
    catch_mm: float = 0.0
    stretch: float = 0.05


@dataclass(frozen=True)
class InstrumentSettings:
    """All of them; empty for a rig file that names none.

    ``operator`` is the address of a simulated person ("tcp://host:port", as `pamrig virtual`
    writes it), or "terminal" for the one there, also on a virtual bench; where it is empty a
    virtual bench has a person of its own.
    """

    text: dict[str, TextDevice] = field(default_factory=dict)
    modbus: dict[str, ModbusDevice] = field(default_factory=dict)
    supply: SupplyDevice | None = None
    card: CardDevice | None = None
    channels: dict[str, ControllerChannel] = field(default_factory=dict)
    manual: dict[str, ManualAxisSettings] = field(default_factory=dict)
    load: LoadSettings = field(default_factory=LoadSettings)
    operator: str = ""
    marks: dict[str, MarkDevice] = field(default_factory=dict)

    def ports(self) -> dict[str, Device]:
        """Every device that has a port, by name."""
        out: dict[str, Device] = {**self.text, **self.modbus}
        if self.supply is not None:
            out["supply"] = self.supply
        if self.card is not None:
            out["card"] = self.card
        return out

    def readers(self) -> dict[str, Reader]:
        """Every device that gives readings by itself, by name."""
        of_card = self.card.channels if self.card is not None else {}
        return {**self.text, **self.modbus, **of_card, **self.channels, **self.marks}


def read_instruments(root: Table) -> InstrumentSettings:
    """The optional tables of a rig file.

    Raises:
        ConfigError: names file, key, what is wrong and what to do.
    """
    text: dict[str, TextDevice] = {}
    modbus: dict[str, ModbusDevice] = {}
    marks: dict[str, MarkDevice] = {}
    for name in NAMED:
        if name in root:
            text[name] = _text(root.table(name), name)
    group = root.table("instruments", optional=True)
    for name in group.keys():  # noqa: SIM118
        if name in (*NAMED, "valve", "valve_b", "balance", "stage", "camera", "supply"):
            raise group.fail(name, "is the name of a table of its own", f"write it as [{name}]")
        if not name.isidentifier():
            raise group.fail(name, "is not a valid name for a stream", "use letters, digits and _")
        table = group.table(name)
        protocol = table.text("protocol", "text", choices=("text", "modbus", "marks"))
        if protocol == "modbus":
            modbus[name] = _modbus(table, name)
        elif protocol == "marks":
            marks[name] = read_mark_device(table)
        else:
            text[name] = _text(table, name)
    group.finish()
    if "pressure_transmitter" in root:
        t = root.table("pressure_transmitter")
        modbus["pressure_transmitter"] = _modbus(t, "pressure_transmitter")
    supply = _supply(root.table("supply")) if "supply" in root else None
    card = _card(root.table("card"), (*text, *modbus, *marks)) if "card" in root else None
    of_card = card.channels if card is not None else {}
    channels = read_channels(root, (*text, *modbus, *marks, *of_card))
    manual = {}
    axes = root.table("manual", optional=True)
    for name in axes.keys():  # noqa: SIM118
        manual[name] = _manual(axes.table(name), name)
    axes.finish()
    load = root.table("load", optional=True)
    person = root.table("operator", optional=True)
    out = InstrumentSettings(
        text, modbus, supply, card, channels, manual,
        LoadSettings(
            u_mass=load.number("u_mass", 0, 1, 1e-4),
            lower_kpa_s=load.number("lower_kpa_s", 1, 2000, 150.0, unit="kPa/s"),
            catch_mm=load.number("catch_mm", 0, 500, 0.0, unit="mm"),
            stretch=load.number("stretch", 0, 1, 0.05),
        ),
        person.text("port", ""),
        marks,
    )  # fmt: skip
    load.finish()
    person.finish()
    return out


def _port(t: Table) -> tuple[str, int, str]:
    return t.text("port"), t.integer("baud", 300, 4_000_000, 9600), t.ascii("serial", "")


def _text(t: Table, name: str) -> TextDevice:
    port, baud, serial = _port(t)
    # A description in a file of its own, or written out in the table.
    form = load_form(t.text("form")) if "form" in t else read_form(t)
    if name in QUANTITY and form.quantity != QUANTITY[name]:
        raise t.fail("form", f"measures {form.quantity}, not {QUANTITY[name]}", "choose another")
    # An indicator's reading in kg is compared with grams by the load cell's driver.
    domain = (form.low, form.high)
    out = TextDevice(
        port,
        baud,
        serial,
        form=form,
        rate_hz=t.number("rate_hz", 0.001, 1000, form.rate_hz, unit="1/s"),
        calibration=_calibration(t, form.quantity, form.unit, domain, serial),
        virtual_value=t.number("virtual_value", -1e9, 1e9, 0.0),
        bore_mm=t.number("bore_mm", 0.1, 1000, 4.0, unit="mm") if name == "flow" else 0.0,
    )
    t.finish()
    return out


def _modbus(t: Table, name: str) -> ModbusDevice:
    port, baud, serial = _port(t)
    quantity = QUANTITY[name] if name in QUANTITY else t.text("quantity")
    pressure = quantity == "pressure_kpa"
    unit = t.text("unit", "kPa", choices=("kPa",)) if pressure else t.text("unit")
    lowest, highest = (-101.0, 2000.0) if pressure else (-1e9, 1e9)
    form = ModbusForm(
        quantity=quantity,
        unit=unit,
        device_id=t.integer("device_id", 1, 247, 1),
        register=t.integer("register", 0, 65535),
        function=t.text("function", "holding", choices=("holding", "input")),
        kind=t.text("kind", "float32", choices=tuple(KINDS)),
        word_order=t.text("word_order", "ABCD", choices=tuple(ORDERS)),
        scale=t.number("scale", -1e6, 1e6, 1.0),
        offset=t.number("offset", -1e6, 1e6, 0.0),
        overload=t.number("overload", -4e38, 4e38, math.nan) if "overload" in t else math.nan,
        underload=t.number("underload", -4e38, 4e38, math.nan) if "underload" in t else math.nan,
        unit_register=t.integer("unit_register", 0, 65535) if "unit_register" in t else -1,
        unit_code=t.integer("unit_code", 0, 65535, 0),
        low=t.number("low", -1e9, 1e9, lowest, unit=unit),
        high=t.number("high", -1e9, 1e9, highest, unit=unit),
        rate_hz=t.number("rate_hz", 0.001, 100, 5.0, unit="1/s"),
        timeout_s=t.number("timeout_s", 0.01, 10, 0.3, unit="s"),
        loopback=t.flag("loopback", True),
    )
    if form.scale == 0:
        raise t.fail("scale", "a scale of 0 makes every reading the same")
    if form.count > MOST_REGISTERS:
        raise t.fail(
            "unit_register",
            f"makes {form.count} registers to read, at most {MOST_REGISTERS} are read at once",
            "leave it out",
        )
    out = ModbusDevice(
        port, baud, serial, form, _calibration(t, form.quantity, unit, (form.low, form.high),
                                               serial)
    )  # fmt: skip
    t.finish()
    return out


def _calibration(
    t: Table, quantity: str, raw_unit: str, domain: tuple[float, float], serial: str
) -> Calibration:
    """Of a calibration file, or as the manufacturer states it in the table itself."""
    if "calibration" in t:
        return load_calibration(
            t.text("calibration"), t.source, quantity, raw_unit, serial
        ).calibration
    if quantity == "length_mm":
        return _length_calibration(t, raw_unit, domain)
    unit = quantity.rpartition("_")[2]
    known = SCALES.get(quantity, {})
    if quantity == "torque_n_m":
        unit = "torque"
        if raw_unit not in known:
            raise t.fail("form", f"unit {raw_unit!r} is not one of {', '.join(known)}")
    return Calibration(
        quantity=quantity,
        unit={"c": "degC", "n": "N", "kpa": "kPa", "s": "m/s", "torque": "N m"}.get(unit, raw_unit),
        raw_unit=raw_unit,
        offset=0.0,
        scale=known.get(raw_unit, 1.0),
        u_offset=t.number("u_offset", 0, 1e6, 0.0),
        u_gain=t.number("u_gain", 0, 1, 0.0),
        domain=domain,
        id=t.text("id", "as the manufacturer states"),
        date=t.text("date", ""),
        valid_days=t.integer("valid_days", 0, MOST_DAYS, 0),
    )


def _length_calibration(t: Table, raw_unit: str, domain: tuple[float, float]) -> Calibration:
    """Length of the muscle by a displacement: ``zero_mm`` at reading 0, growing by ``direction``.

    A laser that looks at the muscle's end from beyond it reads less when the muscle grows.
    """
    if raw_unit not in LENGTHS:
        known = ", ".join(LENGTHS)
        raise t.fail("unit", f"{raw_unit!r} is not a unit of length", f"known: {known}")
    direction = t.integer("direction", -1, 1, 1)
    if direction == 0:
        raise t.fail("direction", "is 1 or -1")
    zero_mm, scale = t.number("zero_mm", -1e4, 1e4, 0.0, unit="mm"), direction * LENGTHS[raw_unit]
    ends = sorted(zero_mm + scale * value for value in domain)
    return Calibration(
        quantity="length_mm",
        unit="mm",
        raw_unit=raw_unit,
        offset=zero_mm,
        scale=scale,
        u_offset=t.number("u_offset", 0, 1e6, 0.0, unit="mm"),
        u_gain=t.number("u_gain", 0, 1, 0.0),
        domain=(ends[0], ends[1]),
        id=t.text("id", "as the manufacturer states"),
        date=t.text("date", ""),
        valid_days=t.integer("valid_days", 0, MOST_DAYS, 0),
    )


def _supply(t: Table) -> SupplyDevice:
    port, baud, serial = _port(t)
    most = t.number("max_v", 0.1, 60, 24.0, unit="V")
    form = load_command_form(t.text("form", "scpi-supply"))
    missing = [f"[set.{key}]" for key in ("voltage_v", "output") if key not in form.settings]
    missing += [f"[get.{key}]" for key in ("voltage_v", "current_a") if key not in form.queries]
    if missing:
        raise t.fail("form", f"that description has no {', '.join(missing)}", "add it")
    out = SupplyDevice(
        port,
        baud,
        serial,
        voltage_v=t.number("voltage_v", 0.1, most, unit="V"),
        max_v=most,
        form=form,
    )
    t.finish()
    return out


def _card(t: Table, taken: tuple[str, ...]) -> CardDevice:
    port, serial = t.text("port"), t.ascii("serial", "")
    kind = t.text("kind", choices=("labjack", "nidaqmx"))
    rate_hz = t.number("rate_hz", 1, 10_000, unit="1/s")
    group = t.table("channels")
    channels = {}
    for name in group.keys():  # noqa: SIM118
        if not name.isidentifier() or name in (*taken, "valve", "balance", "stage", "camera"):
            raise group.fail(name, "is not a valid name for a stream, or is another's")
        c = group.table(name)
        quantity = c.text("quantity", choices=("pressure_kpa", "force_n", "length_mm",
                                               "temperature_c"))  # fmt: skip
        range_v = c.number("range_v", 0.01, 10, 10.0, unit="V")
        calibration = _channel_calibration(c, quantity, range_v)
        form = CardForm(quantity, "V", rate_hz)
        channels[name] = CardChannel(port, 9600, "", form, calibration, c.text("terminal"), range_v)
        c.finish()
    group.finish()
    if not channels:
        raise t.fail("channels", "has no channel", "add [card.channels.NAME]")
    if t.raw("valves", None) is not None:
        raise t.fail(
            "valves", "valves are not connected to a card: it does not vent by itself in 0.3 s",
            "leave them on the valve controller; see docs/reference/cards.md",
        )  # fmt: skip
    output = _card_output(t.table("output")) if "output" in t else None
    t.finish()
    return CardDevice(port, 9600, serial, kind, rate_hz, channels, output)


def _channel_calibration(c: Table, quantity: str, range_v: float) -> Calibration:
    """Of a file, or as stated in the table of the channel."""
    if "calibration" in c:
        return load_calibration(c.text("calibration"), c.source, quantity, "V").calibration
    scale, offset = c.number("scale", -1e6, 1e6), c.number("offset", -1e6, 1e6, 0.0)
    if scale == 0:
        raise c.fail("scale", "a scale of 0 makes every reading the same")
    ends = sorted((offset - abs(scale) * range_v, offset + abs(scale) * range_v))
    return Calibration(
        quantity=quantity,
        unit=UNITS[quantity],
        raw_unit="V",
        offset=offset,
        scale=scale,
        u_offset=c.number("u_offset", 0, 1e6, 0.0),
        u_gain=c.number("u_gain", 0, 1, 0.0),
        domain=(c.number("low", -1e9, 1e9, ends[0]), c.number("high", -1e9, 1e9, ends[1])),
        id=c.text("id", "as stated in the rig file"),
        date=c.text("date", ""),
        valid_days=c.integer("valid_days", 0, MOST_DAYS, 0),
    )


def _card_output(t: Table) -> CardOutput:
    made = CardOutput(
        t.text("terminal"),
        t.number("zero_v", -10, 10, 0.0, unit="V"),
        t.number("volts_per_kpa", 1e-4, 1, unit="V/kPa"),
    )
    t.finish()
    return made


def _manual(t: Table, name: str) -> ManualAxisSettings:
    quantity, unit = t.text("quantity"), t.text("unit")
    want = MANUAL_UNITS.get(name, unit)
    if unit != want:
        what = f"is {unit!r}; the program reckons manual.{name} in {want}"
        raise t.fail("unit", what, f"write {want!r}, and state values in it")
    out = ManualAxisSettings(
        quantity=quantity,
        unit=unit,
        check=t.text("check", ""),
        tolerance=t.number("tolerance", 0, 1e6, 0.0),
    )
    t.finish()
    return out
