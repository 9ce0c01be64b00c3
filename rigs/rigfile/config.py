"""A rig file as values: which devices, where, with which calibrations and limits."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from daq.calibration import Calibration
from daq.errors import ConfigError
from rigs.rigfile.calibration_file import load_calibration, read_fields
from rigs.rigfile.camera_calibration import load_camera_calibration
from rigs.rigfile.device import Device as Device
from rigs.rigfile.form import GRAMS
from rigs.rigfile.instruments import InstrumentSettings, read_instruments
from rigs.rigfile.pressure_source import PressureSourceSettings, read_pressure_source
from rigs.rigfile.tables.channel import net_grams
from rigs.rigfile.tables.joint import JointSettings, read_joint
from rigs.rigfile.tables.marks import load_marks, marks_file
from rigs.rigfile.tables.stage import MANUAL, read_stage
from rigs.rigfile.tables.stage import StageDevice as StageDevice
from rigs.rigfile.toml_reader import Table, find_config, load_toml
from vision.pose.measure import MarkSettings

SENSORS = {"pressure_kpa": "valve", "pressure_b_kpa": "valve_b", "force_n": "balance"}
"""Whose serial number a calibration file of this quantity must be of."""
TOP_COUNT = 4095
"""The controller's converter has 12 bits; a calibration's domain may be narrower."""
VIRTUAL = "virtual"
"""The port of a device that is simulated in this process."""
REPLAY = "replay:"
CAMERA = "camera"
"""``length_source`` of a rig whose camera measures the length."""
MOST_SEED = 2**63 - 1
PRESSURE_B = "pressure_b_kpa"
"""Calibration of the transducer of a second controller."""
BEHIND_VALVES = {"pwm": "solenoids", "reg": "regulator-output"}
"""The pressure source that a controller is by itself, by its ``static_scheme``."""
NONE = "none"
"""Source of the force of a rig without one."""


@dataclass(frozen=True)
class Limits:
    """What the host will never ask of a rig; the firmware's trip stands behind it."""

    pressure_kpa: float
    trip_kpa: float
    length_min_mm: float
    length_max_mm: float
    force_n: float


@dataclass(frozen=True)
class Conditions:
    """What surrounds the test and is entered by hand until an instrument reads it."""

    temperature_c: float
    u_temperature_c: float
    gravity_m_s2: float


@dataclass(frozen=True)
class ValveDevice(Device):
    """The valve controller, its firmware settings and how it makes a static pressure."""

    firmware: str
    outlet_normally: str
    static_scheme: str
    parameters: dict[str, int] = field(default_factory=dict)


Box = tuple[int, int, int, int]
"""Left, top, width, height in pixels."""


CAMERA_SETTINGS: dict[str, tuple[float, float]] = {
    "width": (16, 20_000),
    "height": (16, 20_000),
    "fps": (0.1, 1000),
    "exposure": (-20, 100_000),
    "gain": (0, 100_000),
    "focus": (0, 100_000),
}
"""Settings of a webcam and their ranges: pixels, frames per second, then units of its driver."""


@dataclass(frozen=True)
class CameraSync:
    """How the sync LED is seen: its patch of the picture, and the camera's timing.

    ``exposure_ms`` is that of a row, ``readout_ms`` the time between the first and the last
    row (0 for a global shutter), ``frames`` how many are taken at the start of a run.
    """

    patch: Box
    exposure_ms: float
    readout_ms: float
    frames: int
    bit_ms: int


@dataclass(frozen=True)
class CameraDevice:
    """The camera: "virtual", "uvc:INDEX", "genicam:SERIAL", "tcp://host:port", "replay:PATH".

    A rig with an instrument for the length, or a joint whose angle no marks give, has none: its
    ``source`` is "".
    ``gentl`` is the file of the GenTL producer of a GenICam camera.
    ``repeat`` lets the pictures of a replay begin anew after the last one.
    ``region`` is where the marks are looked for (None: the whole picture); ``lens`` the
    distortion that the camera's calibration file holds, as its plain values. ``settings`` are
    those of a webcam (`CAMERA_SETTINGS`), in the units of its driver. ``marks`` are the marks whose
    pose is measured, as plain values of :class:`vision.pose.measure.MarkSettings`.
    """

    source: str
    serial: str
    jpeg_quality: int
    region: Box | None = None
    sync: CameraSync | None = None
    lens: dict[str, float] | None = None
    repeat: bool = False
    settings: dict[str, float] | None = None
    marks: dict[str, Any] | None = None
    gentl: str = ""

    @property
    def replayed(self) -> bool:
        """Whether its pictures were taken before, of another muscle or at another time."""
        return self.source.startswith(REPLAY)

    @property
    def unseen(self) -> bool:
        """Whether it sees nothing of this bench: there is none, or its pictures are older."""
        return self.replayed or not self.source


@dataclass(frozen=True)
class VirtualBenchConfig:
    """How the simulated bench departs from the reference plant and how its sensors err."""

    seed: int
    draw_calibration_errors: bool
    source: str
    plant: dict[str, Any]
    effects: dict[str, dict[str, Any]]
    pressure_noise_kpa: float
    force_noise_n: float
    blur_px: float
    frame_noise_levels: float
    camera_delay_ms: float
    load: str = "muscle"
    joint: dict[str, Any] = field(default_factory=dict)
    regulator: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RigConfig:
    """A whole rig file, checked.

    ``crc32`` is over the text of the file, so that a run tells which version it used.
    ``force_source`` is "balance", "load_cell" or a cell on the controller (a name of
    ``instruments.channels``); ``balance`` is meaningless when there is none.
    ``length_source`` is "camera", or the instrument whose reading is the length of a test; a rig
    with such an instrument needs no camera, whose ``source`` is then "".
    A rig with a ``joint`` has a second controller, ``valve_b``, and neither balance nor stage,
    and a camera only for marks; its ``force_source`` is "none".
    """

    name: str
    description: str
    source: str
    text: str
    crc32: str
    limits: Limits
    conditions: Conditions
    valve: ValveDevice
    balance: Device
    stage: StageDevice
    camera: CameraDevice
    calibrations: dict[str, Calibration]
    virtual: VirtualBenchConfig | None
    instruments: InstrumentSettings = field(default_factory=InstrumentSettings)
    force_source: str = "balance"
    length_source: str = CAMERA
    pressure_source: PressureSourceSettings = field(
        default_factory=lambda: PressureSourceSettings("", 0, "")
    )
    joint: JointSettings | None = None
    valve_b: ValveDevice | None = None

    @property
    def side_b(self) -> RigConfig | None:
        """The rig as its second controller sees it: that controller and its own transducer."""
        if self.valve_b is None:
            return None
        pressure = replace(self.calibrations[PRESSURE_B], quantity="pressure_kpa")
        kind = BEHIND_VALVES[self.valve_b.static_scheme]
        return replace(
            self,
            valve=self.valve_b,
            valve_b=None,
            joint=None,
            calibrations={**self.calibrations, "pressure_kpa": pressure},
            instruments=replace(self.instruments, channels={}),
            pressure_source=PressureSourceSettings("", 0, "", kind, file=self.source),
        )

    @property
    def pressure_calibration(self) -> Calibration:
        """That of the sensor whose reading is the pressure of a test."""
        sensor = self.pressure_source.sensor
        if not sensor:
            return self.calibrations["pressure_kpa"]
        return self.instruments.readers()[sensor].calibration

    def sensor_band_kpa(self, pressure_kpa: float) -> float:
        """How far the controller's reading may differ from that of the pressure's own sensor.

        Where the rig file states no band: three standard uncertainties of the difference by both
        calibrations, and two steps of the controller's converter.
        """
        if self.pressure_source.sensor_band_kpa:
            return self.pressure_source.sensor_band_kpa
        controller = self.calibrations["pressure_kpa"]
        u = math.hypot(
            float(controller.u(pressure_kpa)), float(self.pressure_calibration.u(pressure_kpa))
        )
        return 3.0 * u + 2.0 * abs(controller.scale)

    @property
    def is_virtual(self) -> bool:
        """True when every device of this rig is simulated in this process."""
        return self.valve.port == VIRTUAL


def load_rig(name: str, seed: int | None = None) -> RigConfig:
    """Read a rig file given as a path or as a shipped name ("virtual", "virtual-thesis").

    Args:
        name: path or shipped name.
        seed: replaces the seed of the virtual bench.

    Raises:
        ConfigError: names file, key, what is wrong and what to do.
    """
    text, _ = find_config(name, "rigs")
    root = load_toml(name, "rigs")
    instruments = read_instruments(root)
    joint = read_joint(root, instruments)
    if joint is not None:
        return _finished(_joint_rig(root, text, instruments, joint, seed), root)
    if instruments.marks:
        which = next(iter(instruments.marks))
        raise root.fail(
            f"instruments.{which}.protocol", "marks are for a rig with [joint]",
            "see docs/use/pose.md for marks in the pictures of other tests",
        )  # fmt: skip
    limits = _limits(root.table("limits"))
    length_source = root.text("length_source", CAMERA)
    if length_source == CAMERA:
        camera, length = _camera(root.table("camera"))
    else:
        camera, length = CameraDevice("", "", 95), _length_reader(root, instruments, length_source)
    force_source = _force_source(root, instruments)
    files = {"length_mm": length, "force_n": _cell(instruments, force_source)}
    serials = {q: root.table(t, optional=True).raw("serial", "") for q, t in SENSORS.items()}
    calibrations = _calibrations(root.table("calibrations"), files, serials, force_source)
    valve = _valve(root.table("valve"))
    rig = RigConfig(
        name=root.text("name"),
        description=root.text("description", ""),
        source=root.source,
        text=text,
        crc32=f"{zlib.crc32(text.encode()):08x}",
        limits=limits,
        conditions=_conditions(root.table("conditions")),
        valve=valve,
        balance=_device(root.table("balance")) if "balance" in root else Device("", 9600, ""),
        stage=read_stage(root.table("stage")),
        camera=camera,
        calibrations=calibrations,
        virtual=_virtual(root, seed),
        instruments=instruments,
        force_source=force_source,
        length_source=length_source,
        pressure_source=read_pressure_source(
            root, valve.static_scheme, "pressure" in instruments.manual, limits.pressure_kpa
        ),
    )
    return _finished(rig, root)


def _force_source(root: Table, instruments: InstrumentSettings) -> str:
    """Balance, or load cell, also on the controller; the first that there is without the key."""
    cells = [n for n, c in instruments.channels.items() if c.form.quantity == "force_n"]
    there = [name for name in ("balance", "load_cell") if name in root] + cells
    known = ("balance", "load_cell", *cells)
    source = root.text("force_source", there[0] if there else "balance", choices=known)
    if source not in there:
        raise root.fail("force_source", f"there is no table [{source}]", "add it")
    return source


def _joint_rig(
    root: Table,
    text: str,
    instruments: InstrumentSettings,
    joint: JointSettings,
    seed: int | None,
) -> RigConfig:
    """A rig with two muscles on a joint."""
    valve, valve_b = _valve(root.table("valve")), _valve(root.table("valve_b"))
    limits = _limits(root.table("limits"), of_joint=True)
    by_hand = "pressure" in instruments.manual
    source = read_pressure_source(root, valve.static_scheme, by_hand, limits.pressure_kpa)
    if source.kind not in BEHIND_VALVES.values() or source.sensor:
        raise root.fail(
            "pressure_source",
            "both muscles of a joint are behind the controllers' own valves and transducers",
            f"one of: {', '.join(BEHIND_VALVES.values())}, without a sensor",
        )
    return RigConfig(
        name=root.text("name"),
        description=root.text("description", ""),
        source=root.source,
        text=text,
        crc32=f"{zlib.crc32(text.encode()):08x}",
        limits=limits,
        conditions=_conditions(root.table("conditions")),
        valve=valve,
        balance=Device("", 9600, ""),
        stage=StageDevice("", 0, "", 0.0, "manual"),
        camera=_joint_camera(root, instruments),
        calibrations=_two_pressures(root),
        virtual=_virtual(root, seed, "joint"),
        instruments=instruments,
        force_source=NONE,
        pressure_source=source,
        joint=joint,
        valve_b=valve_b,
    )


def _joint_camera(root: Table, instruments: InstrumentSettings) -> CameraDevice:
    """The camera of a joint whose angle marks give; none otherwise."""
    if not instruments.marks:
        return CameraDevice("", "", 95)
    if len(instruments.marks) > 1:
        which = sorted(instruments.marks)[1]
        what = "is a second instrument of marks; a picture gives one angle"
        raise root.fail(f"instruments.{which}", what, "remove it")
    t = root.table("camera")
    for key in ("calibration", "region", "sync"):
        if key in t:
            raise t.fail(key, "is for the length of one muscle", "remove it")
    camera, _ = _camera(t)
    if camera.replayed:
        raise t.fail("source", "recorded pictures show no joint of this bench", "use a camera")
    if camera.marks is None:
        raise t.fail("marks", "is missing: which marks the camera sees", "see docs/use/pose.md")
    measured = MarkSettings.from_dict(camera.marks).measured
    for name, device in instruments.marks.items():
        if device.mark not in measured:
            raise root.fail(
                f"instruments.{name}.mark", f"{device.mark!r} is no measured mark of camera.marks",
                f"one of: {', '.join(measured)}",
            )  # fmt: skip
    return camera


def _two_pressures(root: Table) -> dict[str, Calibration]:
    """The calibrations of both controllers' transducers."""
    t = root.table("calibrations")
    out = {}
    for quantity in ("pressure_kpa", PRESSURE_B):
        c = t.table(quantity)
        if "calibration" in c:
            name, serial = c.text("calibration"), root.table(SENSORS[quantity]).raw("serial", "")
            # The file of the second transducer was made on a rig of its own, under the usual name.
            found = load_calibration(name, t.source, "pressure_kpa", "count", serial).calibration
            out[quantity] = replace(found, quantity=quantity)
        else:
            out[quantity] = read_fields(c, quantity, "kPa", "count")
        c.finish()
    t.finish()
    return out


def _finished(rig: RigConfig, root: Table) -> RigConfig:
    """The rig, once nothing of its file is unknown and all of it fits together."""
    root.finish()
    _check_whole(rig, root)
    return rig


def _length_reader(root: Table, instruments: InstrumentSettings, name: str) -> Calibration:
    """Calibration of the instrument whose reading is the length of a test."""
    if "camera" in root:
        what = "measures the length as well, and length_source names an instrument for it"
        raise root.fail("camera", what, "remove one of them")
    readers = instruments.readers()
    fit = [n for n, device in readers.items() if device.form.quantity == "length_mm"]
    if name not in fit:
        what = "reads no length" if name in readers else "is no instrument of this rig"
        known = ", ".join((CAMERA, *fit))
        raise root.fail("length_source", f"{name!r} {what}", f"one of: {known}")
    return readers[name].calibration


def _check_whole(rig: RigConfig, root: Table) -> None:
    """What no single key can tell: mixed rigs, and limits beyond a sensor's range."""
    ports = {
        "valve": rig.valve.port == VIRTUAL,
        **({} if rig.camera.unseen else {"camera": rig.camera.source == VIRTUAL}),
        **{k: d.port == VIRTUAL for k, d in rig.instruments.ports().items()},
    }
    if rig.balance.port:
        ports["balance"] = rig.balance.port == VIRTUAL
    if rig.pressure_source.port:
        ports["pressure_source"] = rig.pressure_source.port == VIRTUAL
    if rig.valve_b is not None:
        ports["valve_b"] = rig.valve_b.port == VIRTUAL
    if rig.stage.kind != MANUAL:
        ports["stage"] = rig.stage.port == VIRTUAL
    if len(set(ports.values())) > 1:
        real = sorted(k for k, virtual in ports.items() if not virtual)
        raise root.fail(
            f"{real[0]}.port",
            "a rig is either wholly virtual or wholly on ports; this one mixes both",
            'start `pamrig virtual` and use its ports, or set all to "virtual"',
        )
    _check_sensor(rig, root)
    if rig.is_virtual and rig.virtual is None:
        raise root.fail("virtual", "a virtual rig needs a [virtual] table", "see configs/rigs")
    transducers = [c for name, c in rig.calibrations.items() if name.startswith("pressure_")]
    high = min(float(calibration.apply(TOP_COUNT)) for calibration in transducers)
    if rig.limits.trip_kpa > high:
        raise root.fail(
            "limits.trip_kpa",
            f"{rig.limits.trip_kpa:g} kPa is above the pressure sensor's range ({high:g} kPa)",
            "use a trip pressure inside the range of the sensor",
        )


def _check_sensor(rig: RigConfig, root: Table) -> None:
    """The sensor of the pressure is an instrument of the rig that reads kPa."""
    sensor = rig.pressure_source.sensor
    if not sensor:
        return
    readers = rig.instruments.readers()
    fit = [n for n, device in readers.items() if device.form.quantity == "pressure_kpa"]
    if sensor not in fit:
        what = "reads no pressure" if sensor in readers else "is no instrument of this rig"
        raise root.fail(
            "pressure_source.sensor",
            f"{sensor!r} {what}",
            f"one of: controller{''.join(', ' + name for name in fit)}",
        )


def _limits(t: Table, of_joint: bool = False) -> Limits:
    pressure = t.number("pressure_kpa", 1, 2000, unit="kPa")
    if of_joint:  # those of angle and torque stand in [joint]
        joint = Limits(pressure, t.number("trip_kpa", pressure, 2000, unit="kPa"), 1, 5000, 1e5)
        t.finish()
        return joint
    low = t.number("length_min_mm", 1, 5000, unit="mm")
    out = Limits(
        pressure_kpa=pressure,
        trip_kpa=t.number("trip_kpa", pressure, 2000, unit="kPa"),
        length_min_mm=low,
        length_max_mm=t.number("length_max_mm", low, 5000, unit="mm"),
        force_n=t.number("force_n", 0.1, 1e5, unit="N"),
    )
    t.finish()
    return out


def _conditions(t: Table) -> Conditions:
    out = Conditions(
        temperature_c=t.number("temperature_c", -20, 80, unit="°C"),
        u_temperature_c=t.number("u_temperature_c", 0, 20, unit="°C"),
        gravity_m_s2=t.number("gravity_m_s2", 9.7, 9.9, 9.80665, unit="m/s2"),
    )
    t.finish()
    return out


def _port(t: Table) -> tuple[str, int, str]:
    return t.text("port"), t.integer("baud", 300, 4_000_000), t.ascii("serial", "")


def _device(t: Table) -> Device:
    port, baud, serial = _port(t)
    t.finish()
    return Device(port, baud, serial)


def _valve(t: Table) -> ValveDevice:
    port, baud, serial = _port(t)
    parameters = t.table("parameters", optional=True)
    out = ValveDevice(
        port,
        baud,
        serial,
        firmware=t.text("firmware", "0.2"),
        outlet_normally=t.text("outlet_normally", choices=("open", "closed")),
        static_scheme=t.text("static_scheme", "pwm", choices=("pwm", "reg")),
        parameters={k: parameters.integer(k, 0, 2**31 - 1) for k in parameters.keys()},  # noqa: SIM118
    )
    t.finish()
    return out


def _box(t: Table, key: str) -> Box:
    values = t.numbers(key, 0, 65535, unit="pixel", least=4)
    if len(values) != 4 or any(v != int(v) for v in values) or values[2] < 1 or values[3] < 1:
        raise t.fail(key, f"expected [left, top, width, height], got {list(values)}")
    left, top, width, height = (int(v) for v in values)
    return left, top, width, height


def _sync(t: Table) -> CameraSync:
    out = CameraSync(
        patch=_box(t, "patch"),
        exposure_ms=t.number("exposure_ms", 0.01, 1000, unit="ms"),
        readout_ms=t.number("readout_ms", 0, 1000, 0.0, unit="ms"),
        frames=t.integer("frames", 30, 1000, 80),
        bit_ms=t.integer("bit_ms", 5, 1000, 23),
    )
    t.finish()
    return out


def _camera(t: Table) -> tuple[CameraDevice, Calibration | None]:
    """The camera, and the calibration of lengths where it names a file of its own."""
    length, lens = _camera_calibration(t) if "calibration" in t else (None, None)
    out = CameraDevice(
        source=_camera_source(t),
        serial=t.ascii("serial", ""),
        repeat=t.flag("repeat", False),
        jpeg_quality=t.integer("jpeg_quality", 50, 100, 95),
        region=_box(t, "region") if "region" in t else None,
        sync=_sync(t.table("sync")) if "sync" in t else None,
        lens=lens,
        settings=_settings(t.table("settings")) if "settings" in t else None,
        gentl=t.text("gentl", ""),
        marks=load_marks(marks_file(t.text("marks"), t.source)).to_dict() if "marks" in t else None,
    )
    scheme = out.source.split(":")[0]
    known = (VIRTUAL, "uvc", "genicam", "tcp", REPLAY[:-1])
    if scheme not in known or out.source in (REPLAY, "genicam:"):
        raise t.fail(
            "source", f"{out.source!r} is not a camera source",
            'use "virtual", "uvc:0", "genicam:SERIAL", "tcp://host:port" or "replay:FOLDER"',
        )  # fmt: skip
    if out.repeat and not out.replayed:
        raise t.fail("repeat", "is for recorded pictures", 'use it with source = "replay:FOLDER"')
    if out.settings and scheme not in ("uvc", "genicam"):
        raise t.fail(
            "settings", "only a webcam (uvc) and genicam have settings", "remove the table"
        )
    missing = sorted(set(out.settings or {}) & {"fps", "focus"})
    if scheme == "genicam" and missing:
        raise t.fail(f"settings.{missing[0]}", "is a setting of a webcam only", "remove it")
    if bool(out.gentl) != (scheme == "genicam"):
        what = 'names the GenTL producer of a camera with source = "genicam:SERIAL", and only there'
        raise t.fail("gentl", what)
    t.finish()
    return out, length


def _camera_source(t: Table) -> str:
    """The source as given; the path of recorded pictures is relative to the rig file."""
    source = t.text("source")
    if not source.startswith(REPLAY) or source == REPLAY:
        return source
    return REPLAY + str(Path(t.source).parent / source.removeprefix(REPLAY))


def _settings(t: Table) -> dict[str, float]:
    """What a webcam is set to; a key that is left out stays as the driver has it."""
    found = {key: t.number(key, low, high) for key, (low, high) in CAMERA_SETTINGS.items()
             if key in t}  # fmt: skip
    if ("width" in found) != ("height" in found):
        raise t.fail("width", "width and height belong together", "give both, in pixels")
    t.finish()
    return found


def _camera_calibration(t: Table) -> tuple[Calibration, dict[str, float] | None]:
    """What ``pamrig calibrate camera`` wrote; leaving the plane widens the gain's part."""
    path = Path(t.source).parent / t.text("calibration")
    return load_camera_calibration(path).frozen()


def _cell(instruments: InstrumentSettings, force_source: str) -> Calibration | None:
    """The load cell's calibration file in net grams, where it is the force sensor.

    A test tares it, so that only its scale counts; what is uncertain about zero stays.
    """
    if force_source in instruments.channels:
        return net_grams(instruments.channels[force_source].calibration)[1]
    cell = instruments.text.get("load_cell") if force_source == "load_cell" else None
    if cell is None or cell.form.unit not in GRAMS or not cell.calibration.date:
        return None
    scale = cell.calibration.scale / GRAMS[cell.form.unit]
    tared = "every test tares the load cell, so that its offset is 0"
    note = "; ".join(filter(None, (cell.calibration.note, tared)))
    return replace(cell.calibration, raw_unit="g", offset=0.0, scale=scale, note=note)


def _calibrations(
    t: Table, files: dict[str, Calibration | None], serials: dict[str, str], force_source: str
) -> dict[str, Calibration]:
    """The three that every rig has; ``files`` are those that an instrument's table names."""
    units = {"pressure_kpa": ("kPa", "count"), "force_n": ("N", "g"), "length_mm": ("mm", "pixel")}
    out = {}
    for quantity, (unit, raw_unit) in units.items():
        named = files.get(quantity)
        if named is not None:
            if quantity in t:
                table = "camera" if quantity == "length_mm" else force_source
                what = f"{table}.calibration names a file for it as well"
                if named.raw_unit != "pixel" and quantity == "length_mm":
                    what = "the instrument of length_source has a calibration of its own"
                elif quantity == "force_n" and force_source != "load_cell":
                    what = f"{force_source} has a calibration of its own, of its counts"
                raise t.fail(quantity, what, "keep one")
            out[quantity] = named
            continue
        c = t.table(quantity)
        if "calibration" in c:
            name = c.text("calibration")
            serial = serials.get(quantity, "")
            out[quantity] = load_calibration(name, t.source, quantity, raw_unit, serial).calibration
        else:
            out[quantity] = read_fields(c, quantity, unit, raw_unit)
        c.finish()
    t.finish()
    return out


def _virtual(
    root: Table, seed: int | None, usual_load: str = "muscle"
) -> VirtualBenchConfig | None:
    effects = root.raw("effects", {})
    if "virtual" not in root:
        return None
    t = root.table("virtual")
    sensors = t.table("sensors", optional=True)
    stated = t.integer("seed", 0, MOST_SEED, 1)
    if seed is not None and not 0 <= seed <= MOST_SEED:
        raise ConfigError("--seed", f"expected a whole number from 0 to {MOST_SEED}, got {seed}")
    out = VirtualBenchConfig(
        seed=stated if seed is None else seed,
        draw_calibration_errors=t.flag("draw_calibration_errors", True),
        source=t.text("source", "valve", choices=("valve", "regulator")),
        load=t.text(
            "load", usual_load, choices=("joint",) if usual_load == "joint" else ("muscle", "ram")
        ),
        joint=dict(t.table("joint", optional=True).values()) if usual_load == "joint" else {},
        plant=dict(t.table("plant", optional=True).values()),
        effects=effects,
        regulator=_regulator(t.table("regulator", optional=True)),
        pressure_noise_kpa=sensors.number("pressure_noise_kpa", 0, 50, 0.5, unit="kPa"),
        force_noise_n=sensors.number("force_noise_n", 0, 10, 0.005, unit="N"),
        blur_px=sensors.number("blur_px", 0.3, 5, 0.8, unit="pixel"),
        frame_noise_levels=sensors.number("frame_noise_levels", 0, 30, 2.0),
        camera_delay_ms=sensors.number("camera_delay_ms", 0, 500, 12.0, unit="ms"),
    )
    sensors.finish()
    t.finish()
    return out


def _regulator(t: Table) -> dict[str, float]:
    """What is stated of the emulated proportional regulator; the rest is drawn."""
    known = ("dead_time_s", "time_constant_s", "slew_kpa_s", "dead_band_kpa", "hysteresis_kpa",
             "offset_kpa", "gain_error")  # fmt: skip
    least = {"offset_kpa": -100.0, "gain_error": -0.5, "time_constant_s": 1e-3, "slew_kpa_s": 1.0}
    found = {key: t.number(key, least.get(key, 0.0), 1e5) for key in known if key in t}
    t.finish()
    return found


def camera_values(config: RigConfig) -> dict[str, Any]:
    """How pictures are to be measured: what a replay must know."""
    camera = config.camera
    return {
        "region": list(camera.region) if camera.region else None,
        "sync": {**vars(camera.sync), "patch": list(camera.sync.patch)} if camera.sync else None,
        "lens": camera.lens,
        **({"marks": camera.marks} if camera.marks else {}),
    }
