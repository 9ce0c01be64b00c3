"""A rig file from questions: what the bench has, where it is, what is known of its calibrations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count

from daq.link.ports import PortInfo
from rigs.rigfile.form import load_form
from rigs.rigfile.modbus_form import KINDS, ORDERS, ModbusForm
from rigs.setup.questions import Interview
from rigs.setup.search import (
    Answer,
    Probe,
    cameras,
    modbus_probe,
    probes,
    requests_text,
    search,
    serial_ports,
    text_probe,
)

GRAVITY = 9.80665
TOP_COUNT = 4095
NOT_CALIBRATED = "not calibrated"
"""Id of a calibration that is only the maker's range, or a guess."""
ANY_SERIAL = '# serial = "..."            # number that `pamrig doctor` prints: others are refused'
PRESSURE = {
    "solenoids": "two solenoid valves, pulsed by the controller",
    "analogue": "a proportional regulator on the controller's analogue output",
    "alicat": "an Alicat PC or PCD on a serial port",
    "itv": "an SMC ITV with RS-232C",
    "card": "a regulator on the output of a LabJack or NI card",
    "hand": "a regulator with a knob, turned by a person",
}
SENSOR = {
    "controller": "the transducer on the controller",
    "modbus": "a transmitter of its own, Modbus RTU",
    "card": "a transducer on a LabJack or NI card",
}
FORCE = {
    "balance": "a balance with MT-SICS (Mettler Toledo and others)",
    "load-cell-stream": "a load cell whose indicator sends lines by itself",
    "load-cell-polled": "a load cell whose indicator is asked for lines",
}
STAGE = {
    "grbl": "a GRBL 1.1 board",
    "marlin": "a Marlin board",
    "zaber": "a Zaber stage, ASCII protocol",
    "tmcl": "a Trinamic module, TMCL",
    "manual": "a person",
}
LENGTH = {
    "camera": "a camera that sees two markers",
    "laser": "a laser sensor or gauge over Modbus RTU",
    "gauge": "a gauge or LVDT that answers in lines",
}
CARDS = {"labjack": "LabJack T4, T7 or T8", "nidaqmx": "National Instruments, NI-DAQmx"}
PLACE = {"real": "on ports of this computer", "virtual": "simulated in the program: to try it out"}
OUTLET = {
    "open": "normally open: vents by itself when power fails",
    "closed": "normally closed: keeps the air when power fails",
}
PLANT = """[virtual.plant]
supply_kpa = 700
inlet_conductance_m3_s_pa = 1.1e-10
outlet_conductance_m3_s_pa = 1.1e-10
inlet_on_ms = 2.0
inlet_on_ms_per_kpa = 0.0
inlet_off_ms = 1.5
inlet_off_ms_per_kpa = 0.0
outlet_on_ms = 2.0
outlet_on_ms_per_kpa = 0.0
outlet_off_ms = 1.5
outlet_off_ms_per_kpa = 0.0
"""


@dataclass
class Parts:
    """What was answered, as far as several tables need it."""

    virtual: bool
    pressure: str
    sensor: str
    force: str
    stage: str
    length: str
    limit_kpa: float = 0.0
    found: dict[str, Answer] = field(default_factory=dict)
    ports: tuple[str, ...] = ()
    taken: set[str] = field(default_factory=set)

    @property
    def card(self) -> bool:
        """Whether a card is part of the bench."""
        return "card" in (self.pressure, self.sensor)

    @property
    def regulated(self) -> bool:
        """Whether a regulator is before the inlet valve."""
        return self.pressure in ("analogue", "alicat", "itv", "card")


@dataclass(frozen=True)
class Surroundings:
    """What is asked of this computer; replaced on one without devices.

    Attributes:
        ports: its serial ports.
        search: sends requests and collects answers.
    """

    ports: Callable[[], Sequence[PortInfo]] = serial_ports
    search: Callable[..., list[Answer]] = search


def ask_rig(ask: Interview, here: Surroundings | None = None) -> str:
    """Ask what a bench has and return its rig file.

    Args:
        ask: the questions; what it holds afterwards are all answers.
        here: ports and search; those of this computer when none are given.

    Raises:
        ConfigError: an answer is refused.
    """
    here = here or Surroundings()
    name = ask.text("name", "Name of the bench", "my-bench", _named)
    parts = _parts(ask)
    out = [_head(name, parts)]
    out.append(_limits(ask, parts))
    out.append(_conditions(ask))
    registers = {key: _registers(ask, key) for key in _modbus_of(parts)}
    if not parts.virtual:
        _ports(ask, parts, registers, here)
    out.append(_valve(ask, parts))
    if parts.card:
        out.append(_card(ask, parts))
    out.append(_source(ask, parts))
    out.append(_force(ask, parts))
    out.append(_stage(ask, parts))
    out.append(_length(ask, parts, registers))
    if parts.sensor == "modbus":
        out.append(_transmitter(ask, parts, registers["pressure_transmitter"]))
    out.append(_calibrations(ask, parts))
    if parts.virtual:
        out.append(_virtual(parts))
    ask.finish()
    return "\n".join(text for text in out if text)


def _named(word: str) -> str:
    return "" if 0 < len(word) <= 60 else "expected a name of 1 to 60 characters"


def _parts(ask: Interview) -> Parts:
    virtual = ask.choice("bench", "Where is the bench?", PLACE, "real") == "virtual"
    pressure = ask.choice("pressure", "What sets the pressure?", PRESSURE, "solenoids")
    has_card = pressure == "card"
    sensors = {k: v for k, v in SENSOR.items() if k != "card" or has_card}
    sensor = ask.choice("sensor", "Whose reading is the pressure of a test?", sensors,
                        "card" if has_card else "controller")  # fmt: skip
    return Parts(
        virtual,
        pressure,
        sensor,
        ask.choice("force", "What reads the force?", FORCE, "balance"),
        ask.choice("stage", "What sets the length?", STAGE, "grbl"),
        ask.choice("length", "What reads the length?", LENGTH, "camera"),
    )


def _head(name: str, parts: Parts) -> str:
    source = f'length_source = "{parts.length}"\n' if parts.length != "camera" else ""
    force = "" if parts.force == "balance" else 'force_source = "load_cell"\n'
    return f"""# Rig file made by `pamrig init`. Every key: docs/reference/files.md.
# After a change: pamrig doctor --rig THIS_FILE
name = "{name}"
description = "{PRESSURE[parts.pressure]}; {FORCE[parts.force]}"
{force}{source}"""


def _limits(ask: Interview, parts: Parts) -> str:
    limit = parts.limit_kpa = ask.number(
        "limit_kpa", "Highest pressure that is ever set", 500.0, 1, 2000, "kPa"
    )
    trip = ask.number("trip_kpa", "Pressure at which the controller vents", round(1.08 * limit),
                      limit, 2000, "kPa")  # fmt: skip
    low = ask.number("length_min_mm", "Shortest length of the muscle", 51.0, 1, 5000, "mm")
    high = ask.number("length_max_mm", "Longest length of the muscle", max(72.5, low), low, 5000,
                      "mm")  # fmt: skip
    force = ask.number("limit_n", "Force at which a test is ended", 200.0, 0.1, 1e5, "N")
    return f"""[limits]
pressure_kpa = {limit:g}          # highest set-point the host will send
trip_kpa = {trip:g}              # the firmware vents and latches above this
length_min_mm = {low:g}
length_max_mm = {high:g}
force_n = {force:g}
"""


def _conditions(ask: Interview) -> str:
    celsius = ask.number("temperature_c", "Temperature of the air", 21.0, -20, 80, "°C")
    return f"""[conditions]
temperature_c = {celsius:g}        # entered by hand until a thermometer is connected
u_temperature_c = 1.0
gravity_m_s2 = {GRAVITY}      # local gravity, if you know it better
"""


# ---- ports ------------------------------------------------------------------------------


def _modbus_of(parts: Parts) -> list[str]:
    keys = ["pressure_transmitter"] if parts.sensor == "modbus" else []
    return keys + (["laser"] if parts.length == "laser" else [])


def _registers(ask: Interview, key: str) -> ModbusForm:
    """Where a transmitter keeps its reading, as its manual says."""
    ask.tell("", f"The next answers on the {key} are in its manual.")
    laser = key == "laser"
    return ModbusForm(
        quantity="length_mm" if laser else "pressure_kpa",
        unit="mm" if laser else "kPa",
        device_id=round(ask.number(f"{key}_device_id", "Modbus address", 1, 1, 247)),
        register=round(ask.number(f"{key}_register", "Register, counted from 0", 0, 0, 65535)),
        function=ask.choice(f"{key}_function", "Kind of register",
                            {"holding": "function 3", "input": "function 4"}, "holding"),
        kind=ask.choice(f"{key}_kind", "Number format", dict.fromkeys(KINDS, ""), "float32"),
        word_order=ask.choice(f"{key}_word_order", "Order of the bytes",
                              dict.fromkeys(ORDERS, ""), "ABCD"),
        scale=ask.number(f"{key}_scale", "Value of one step" if laser else "Factor to kPa",
                         0.001 if laser else 1.0, -1e6, 1e6, "mm" if laser else ""),
    )  # fmt: skip


def _wanted(parts: Parts, registers: dict[str, ModbusForm]) -> list[Probe]:
    """The requests of the devices that this bench is said to have."""
    out = probes("valve", "controller")
    source = {"alicat": "alicat-pcd", "itv": "smc-itv"}.get(parts.pressure, "")
    out += probes("pressure_source", source)
    if parts.force == "balance":
        out += probes("balance", "mt-sics")
    else:
        out.append(text_probe("load_cell", parts.force, load_form(parts.force)))
    out += probes("stage", parts.stage)
    if parts.length == "gauge":
        out.append(text_probe("gauge", "gauge-text", load_form("gauge-text")))
    out += [modbus_probe(key, form, 19200) for key, form in registers.items()]
    # A number alone is taken for an ITV's answer: it comes last.
    return sorted(out, key=lambda probe: probe.kind == "smc-itv")


def _ports(
    ask: Interview, parts: Parts, registers: dict[str, ModbusForm], here: Surroundings
) -> None:
    known = here.ports()
    if known:
        ask.tell("", "Serial ports of this computer:")
        ask.tell(*(f"  {p.name}  {p.about}" for p in known))
    else:
        ask.tell("", "This computer lists no serial port.")
    names = ask.text("ports", "Ports of the bench, separated by commas",
                     ", ".join(p.name for p in known))  # fmt: skip
    parts.ports = tuple(dict.fromkeys(word.strip() for word in names.split(",") if word.strip()))
    if not parts.ports:
        return
    wanted = _wanted(parts, registers)
    ask.tell("", *requests_text(wanted, parts.ports))
    if ask.yes_no("ask_devices", "Send this and see who answers?", False):
        for answer in here.search(wanted, parts.ports, ask.tell):
            parts.found[answer.probe.device] = answer
            parts.taken.add(answer.port)


def _link(ask: Interview, parts: Parts, device: str, what: str, baud: int) -> str:
    """The lines port, baud and serial of a device."""
    if parts.virtual:
        return f'port = "virtual"\nbaud = {baud}\n'
    answer = parts.found.get(device)
    left = [port for port in parts.ports if port not in parts.taken]
    guess = answer.port if answer else left[0] if left else _free_port(parts.taken)
    port = ask.text(f"port_{device}", f"Port of the {what}", guess, _given)
    parts.taken.add(port)
    if answer is not None and answer.port == port:
        baud, serial = answer.baud, answer.identity
    else:
        baud = round(ask.number(f"baud_{device}", f"Baud rate of the {what}", baud, 300, 4_000_000))
        serial = ""
    identity = (
        f'serial = "{serial}"  # a device with another number is refused' if serial else ANY_SERIAL
    )
    return f'port = "{port}"\nbaud = {baud}\n{identity}\n'


def _free_port(taken: set[str]) -> str:
    """A port to begin with where none was found, another one for each device."""
    return next(port for n in count() if (port := f"/dev/ttyUSB{n}") not in taken)


def _given(word: str) -> str:
    return "" if word else "a port is needed, such as /dev/ttyUSB0, COM3 or socket://host:port"


# ---- tables -----------------------------------------------------------------------------


def _valve(ask: Interview, parts: Parts) -> str:
    link = _link(ask, parts, "valve", "valve controller", 115200)
    outlet = ask.choice("outlet", "The outlet valve is", OUTLET, "open")
    scheme = 'static_scheme = "reg"       # the regulator is before the inlet valve\n'
    slew = "slew = 92" if parts.regulated else "slew = 10"
    note = (
        "# nothing changes the pressure faster, counts per ms (docs/reference/safety-contract.md)"
    )
    parameters = f"{slew}  {note}" if parts.virtual else f"# {slew}  {note}"
    return f"""[valve]
{link}firmware = "0.2"            # version this rig is set up with; "0.2" takes any 0.2.x
outlet_normally = "{outlet}"
{scheme if parts.regulated else ""}
[valve.parameters]          # firmware settings, see docs/reference/wire-format.md
{parameters}
"""


def _card(ask: Interview, parts: Parts) -> str:
    kind = ask.choice("card", "Which card?", CARDS, "labjack")
    labjack = kind == "labjack"
    port = "virtual"
    if not parts.virtual:
        port = ask.text("card_port", "Identifier of the card", "ANY" if labjack else "Dev1", _given)
    terminal = ask.text("card_input", "Input of the pressure transducer",
                        "AIN0" if labjack else "ai0", _given)  # fmt: skip
    scale = ask.number("card_kpa_per_v", "Scale of the transducer", 100.0, 1e-3, 1e6, "kPa/V")
    output = ask.text("card_output", "Output to the regulator", "DAC0" if labjack else "ao0",
                      _given)  # fmt: skip
    volts = ask.number("card_v_per_kpa", "Voltage of the regulator", 0.007, 1e-4, 1, "V/kPa")
    return f"""[card]
kind = "{kind}"
port = "{port}"
rate_hz = 100               # scans a second, by the card's clock

[card.channels.transducer]  # {NOT_CALIBRATED}: the maker's range
terminal = "{terminal}"
quantity = "pressure_kpa"
range_v = 10.0
scale = {scale:g}               # kPa for each V
offset = 0.0                # kPa at 0 V
u_offset = {0.01 * 10 * scale:g}              # kPa
u_gain = 0.01
id = "{NOT_CALIBRATED}"

[card.output]               # the regulator
terminal = "{output}"
zero_v = 0.0
volts_per_kpa = {volts:g}
"""


def _source(ask: Interview, parts: Parts) -> str:
    sensor = {"modbus": "pressure_transmitter", "card": "transducer"}.get(parts.sensor, "")
    reads = f'sensor = "{sensor}"      # its reading is the pressure of a test\n' if sensor else ""
    match parts.pressure:
        case "alicat" | "itv":
            kind = "alicat-pcd" if parts.pressure == "alicat" else "smc-itv"
            link = _link(ask, parts, "pressure_source", "regulator",
                         19200 if parts.pressure == "alicat" else 9600)  # fmt: skip
            least = parts.limit_kpa
            full = ask.number("regulator_full_kpa", "Full scale of the regulator",
                              max(700.0, least), least, 2000, "kPa")  # fmt: skip
            letter = 'unit = "A"                  # letter set at its panel\n'
            return f"""[pressure_source]  # before the inlet valve, kept open by the controller
kind = "{kind}"
{link}{letter if kind == "alicat-pcd" else ""}full_kpa = {full:g}
monitor_hz = 5.0            # its own reading is the stream `regulator`
{reads}# dynamics = "regulator.toml"   # as `pamrig calibrate regulator` writes it
"""
        case "analogue":
            signals = {"0-10 V": "", "0-5 V": "", "4-20 mA": ""}
            signal = ask.choice("regulator_signal", "Input of the regulator", signals, "0-10 V")
            full = ask.number("regulator_full_kpa", "Pressure at the end of that signal",
                              parts.limit_kpa, parts.limit_kpa, 2000, "kPa")  # fmt: skip
            ends = {"0-10 V": (0.0, 10.2), "0-5 V": (0.0, 5.1), "4-20 mA": (3.9, 20.4)}[signal]
            return f"""[pressure_source]  # before the inlet valve, kept open by the controller
kind = "analogue-regulator"
signal = "{signal}"
range_kpa = [0.0, {full:g}]     # pressures at the ends of the signal
conditioner = [{ends[0]}, {ends[1]}]  # V or mA behind it at count 0 and 4095: measure them
accuracy_kpa = {0.01 * full:g}          # how far it may rest from the set-point
{reads}# dynamics = "regulator.toml"   # as `pamrig calibrate regulator` writes it
"""
        case "card":
            return f'[pressure_source]\nkind = "card-output"\n{reads}'
        case "hand":
            check = f'check = "{sensor or "pressure"}"'
            kind = f'[pressure_source]\nkind = "hand-regulator"\n{reads}\n' if reads else ""
            return f"""{kind}[manual.pressure]           # the regulator is turned by a person
quantity = "pressure_kpa"
unit = "kPa"
{check}          # the sensor that looks after it
tolerance = 3.0
"""
    return f'[pressure_source]\nkind = "solenoids"\n{reads}' if reads else ""


def _force(ask: Interview, parts: Parts) -> str:
    if parts.force == "balance":
        return "[balance]\n" + _link(ask, parts, "balance", "balance", 9600)
    link = _link(ask, parts, "load_cell", "load cell's indicator", 9600)
    return f"""[load_cell]                 # {NOT_CALIBRATED}: `pamrig calibrate force`
{link}form = "{parts.force}"   # a shipped description, or a file of your own
u_offset = 1.0              # N
u_gain = 0.01
id = "{NOT_CALIBRATED}"
"""


def _stage(ask: Interview, parts: Parts) -> str:
    if parts.stage == "manual":
        return """[stage]                     # the length is set by a person
kind = "manual"
tolerance_mm = 0.2
"""
    baud = {"tmcl": 9600}.get(parts.stage, 115200)
    link = _link(ask, parts, "stage", "stage", baud)
    text = f'[stage]\nkind = "{parts.stage}"\n{link}speed_mm_s = 5.0\n'
    if parts.stage in ("grbl", "marlin"):
        return text + "# axis X in mm: position of the stage = length of the muscle\n"
    tmcl = parts.stage == "tmcl"
    what = "Microsteps a millimetre (negative: the count falls as the muscle gets longer)"
    usual = 25600.0 if tmcl else 20997.375
    counts = ask.number("stage_counts_per_mm", what, usual, -1e7, 1e7)
    zero = ask.number("stage_zero_mm", "Length of the muscle at position 0", 50.0, -5000, 5000,
                      "mm")  # fmt: skip
    axis = 0 if tmcl else 1
    return text + f"address = 1\naxis = {axis}\ncounts_per_mm = {counts!r}\nzero_mm = {zero:g}\n"


def _length(ask: Interview, parts: Parts, registers: dict[str, ModbusForm]) -> str:
    if parts.length == "camera":
        return _camera(ask, parts)
    zero = ask.number("length_zero_mm", "Length of the muscle at a reading of 0", 95.0, -1e4, 1e4,
                      "mm")  # fmt: skip
    direction = round(ask.number("length_direction", "1: the reading grows with the muscle, -1: it"
                                 " falls", -1, -1, 1))  # fmt: skip
    direction = direction or -1
    if parts.length == "laser":
        link = _link(ask, parts, "laser", "laser sensor", 19200)
        what = 'quantity = "length_mm"\nunit = "mm"\nrate_hz = 20.0\n'
        reads = f'protocol = "modbus"\n{link}{_written(registers["laser"])}{what}'
    else:
        reads = _link(ask, parts, "gauge", "gauge", 9600) + 'form = "gauge-text"\n'
    return f"""[instruments.{parts.length}]          # {NOT_CALIBRATED}: `pamrig calibrate length`
{reads}zero_mm = {zero:g}              # length of the muscle at a reading of 0
direction = {direction}              # -1: it reads less when the muscle grows
u_offset = 1.0              # mm
u_gain = 0.01
id = "{NOT_CALIBRATED}"
"""


def _written(form: ModbusForm) -> str:
    return f"""device_id = {form.device_id}
register = {form.register}                # counted from 0; makers often count from 1 or 40001
function = "{form.function}"
kind = "{form.kind}"
word_order = "{form.word_order}"
scale = {form.scale!r}
"""


def _camera(ask: Interview, parts: Parts) -> str:
    if parts.virtual:
        return '[camera]\nsource = "virtual"\nserial = "CAM-0001"\njpeg_quality = 95\n'
    gentl = ask.text("camera_gentl", "GenTL producer (.cti) of a GenICam camera, empty for none",
                     "")  # fmt: skip
    found = list(cameras(gentl))
    ask.tell("", "Cameras found:" if found else "No camera was found.")
    ask.tell(*(f"  {source}  {what}" for source, what in found))
    first = found[-1][0] if gentl and found else found[0][0] if found else "uvc:0"
    source = ask.text("camera", "Camera", first, _source_given)
    producer = f'gentl = "{gentl}"\n' if gentl and source.startswith("genicam") else ""
    return f"""[camera]
source = "{source}"
{producer}{ANY_SERIAL}
jpeg_quality = 95
# calibration = "camera.toml"   # as `pamrig calibrate camera` writes it, in place of
#                               # [calibrations.length_mm]
# [camera.sync] finds the delay of the camera by the LED of the controller: docs/use/length.md
"""


def _source_given(word: str) -> str:
    known = ("uvc:", "genicam:", "tcp://", "replay:")
    return (
        "" if word.startswith(known) else f"{word!r}: expected {', '.join(known)} and what follows"
    )


def _transmitter(ask: Interview, parts: Parts, form: ModbusForm) -> str:
    link = _link(ask, parts, "pressure_transmitter", "pressure transmitter", 19200)
    return f"""[pressure_transmitter]      # Modbus RTU; {NOT_CALIBRATED}: the maker's range
{link}{_written(form)}rate_hz = 20.0
low = -100.0
high = 1100.0
u_offset = 5.0              # kPa
u_gain = 0.01
id = "{NOT_CALIBRATED}"
"""


def _calibrations(ask: Interview, parts: Parts) -> str:
    ask.tell("", "Ranges of sensors, until they are calibrated.")
    low = ask.number("transducer_low_kpa", "The controller's transducer at count 0", 0.0, -1000,
                     1000, "kPa")  # fmt: skip
    high = ask.number("transducer_high_kpa", "The same at count 4095", 1000.0, low + 1, 5000,
                      "kPa")  # fmt: skip
    span = high - low
    text = f"""# {NOT_CALIBRATED}: ranges as the makers state them, with wide uncertainties.
# `pamrig calibrate pressure` (or force, camera, length) writes a file; name it here as
# calibration = "FILE" in place of the keys of that table.
[calibrations.pressure_kpa] # of the transducer on the controller
id = "{NOT_CALIBRATED}"
date = ""                   # of the calibration, as "2026-01-31"; there was none yet
unit = "kPa"
raw_unit = "count"
offset = {low!r}
scale = {span / TOP_COUNT!r}
u_offset = {0.005 * span:g}
u_gain = 0.01
domain = [{low!r}, {high!r}]
"""
    balance = parts.force == "balance"
    sign = "weight taken off the balance" if balance else "net grams of the load cell"
    text += f"""
[calibrations.force_n]
id = "{NOT_CALIBRATED}"
date = ""                   # of the calibration, as "2026-01-31"; there was none yet
unit = "N"
raw_unit = "g"
offset = 0.0
scale = {(-1 if balance else 1) * GRAVITY / 1000!r}  # {sign}
u_offset = {0.2 if balance else 1.0}
u_gain = {0.001 if balance else 0.01}
domain = [-50.0, 200.0]
"""
    if parts.length != "camera":
        return text
    offset, scale = 40.0, 0.11
    if not parts.virtual:
        scale = ask.number("camera_mm_per_pixel", "Millimetres a pixel, roughly", 0.11, 1e-4, 10)
        offset = ask.number("camera_offset_mm", "Length when the two markers touch, roughly", 40.0,
                            -1e4, 1e4, "mm")  # fmt: skip
    return f"""{text}
[calibrations.length_mm]    # a guess: `pamrig calibrate camera`
id = "{NOT_CALIBRATED}"
date = ""                   # of the calibration, as "2026-01-31"; there was none yet
unit = "mm"
raw_unit = "pixel"
offset = {offset!r}               # length at zero gap
scale = {scale!r}
u_offset = 2.0
u_gain = 0.05
domain = [50.0, 75.0]
"""


def _virtual(parts: Parts) -> str:
    source = 'source = "regulator"\n' if parts.regulated else ""
    plant = "" if parts.regulated else f"\n{PLANT}"
    return f"""[virtual]
seed = 1
draw_calibration_errors = false   # nothing is calibrated yet
{source}{plant}"""
