"""The optional instruments of the virtual bench: which emulator reads what of the plant."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from daq.calibration import Calibration
from daq.clock import Clock
from daq.errors import ConfigError
from plant.constants import GAS_CONSTANT_J_KG_K
from plant.physics.layout import (
    BRAID_LENGTH,
    GRAVITY,
    LENGTH,
    LENGTH_MAX,
    LENGTH_RATE,
    LOAD,
    MASS,
    MASS_OUT,
    PRESSURE,
    STOP_STIFFNESS,
)
from plant.simulator.bench import BenchSim
from rigs.rigfile.config import RigConfig
from rigs.rigfile.instruments import CardDevice, TextDevice
from rigs.rigfile.pressure_source import source_module
from rigs.rigfile.tables.channel import ControllerChannel
from rigs.rigfile.tables.marks import MarkDevice
from rigs.virtual.board.inputs import VirtualInputs
from rigs.virtual.board.joint_load import JointLoad
from rigs.virtual.emulators.cards import VirtualCard, library_of
from rigs.virtual.emulators.emulator import Emulator
from rigs.virtual.emulators.modbus import VirtualModbus
from rigs.virtual.emulators.operator import VirtualOperator
from rigs.virtual.emulators.pictures.joint_eye import JointEye
from rigs.virtual.emulators.proportional.outlet import RegulatorOutlet, draw
from rigs.virtual.emulators.sensor_error import SensorError
from rigs.virtual.emulators.supply import VirtualSupply
from rigs.virtual.emulators.text import VirtualText

CELL_NOISE_N = 0.05
CELL_SLOW_N = 0.2
CELL_SLOW_S = 2.0
THERMOMETER_NOISE_C = 0.05
TRANSMITTER_NOISE_KPA = 0.02
VELOCITY_NOISE = 0.002
ENCODER_NOISE_DEG = 0.003
TORQUE_NOISE_N_M = 0.0003
DISPLACEMENT_NOISE_MM = 0.003
SUPPLY_NOISE_V = 0.002
HAND = {"length": 0.03, "pressure": 1.0, "supply": 1.0, "angle": 0.1, "holders": 0.01}
"""How exactly a person sets a length (mm) or an angle (degrees), turns a regulator (kPa), and
measures the distance of the holders with gauge blocks (mm)."""


def hang(plant: BenchSim, mass_kg: float) -> None:
    """Hang a mass on the vented muscle, led down by hand until the muscle holds it; 0: take it off.

    Without a load the muscle's lower end is where it was, held by whatever holds it then.
    """
    if mass_kg > 0.0:
        stretch_m = mass_kg * float(plant.params[GRAVITY] / plant.params[STOP_STIFFNESS])
        longest_m = 0.999 * float(plant.params[BRAID_LENGTH])
        plant.load = "isometric"
        plant.params[LOAD] = 0.0
        plant.lead_to(1e3 * min(float(plant.params[LENGTH_MAX]) + stretch_m, longest_m))
        plant.load = "isotonic"
        plant.params[LOAD] = 1.0
        plant.params[MASS] = mass_kg
    else:
        plant.load = "isometric"
        plant.params[LOAD] = 0.0
        low, high = float(plant.params[LENGTH_MAX]) * 0.5, float(plant.params[LENGTH_MAX])
        plant.state[LENGTH] = min(max(float(plant.state[LENGTH]), low), high)
    plant.state[LENGTH_RATE] = 0.0


class Surroundings(Protocol):
    """The bench that these instruments belong to."""

    config: RigConfig
    plant: BenchSim
    sensor_error: SensorError

    @property
    def clock(self) -> Clock | None:
        """The virtual clock of the bench, if it has one."""
        ...

    @property
    def time_s(self) -> float:
        """Time of the bench since power-on."""
        ...

    def transmit(self, name: str, data: bytes) -> None:
        """Send an instrument's bytes to the host."""
        ...


class Extras:
    """Makes the emulators that a rig file names and joins them to the plant.

    Attributes:
        devices: emulators by name; ``without_port`` those that no byte reaches.
        regulator: the outlet of an emulated proportional regulator, where the rig has one.
        temperature_c: of the bench now; set it to warm the bench.
        hung_kg: dead weight on the force sensor in place of the muscle, None for the muscle.
    """

    def __init__(self, bench: Surroundings) -> None:
        self._bench = bench
        self._config = bench.config
        settings = self._config.instruments
        self.temperature_c = self._config.conditions.temperature_c
        self.hung_kg: float | None = None
        self.devices: dict[str, Emulator] = {}
        self.supply: VirtualSupply | None = None
        for name, text in settings.text.items():
            read = self._sensor(name, self._truth(name, text.form.quantity, text), text.calibration)
            self.devices[name] = VirtualText(
                text.form, read, self._sender(name), text.serial or name, text.rate_hz
            )
        for name, modbus in settings.modbus.items():
            truth = self._truth(name, modbus.form.quantity)
            read = self._sensor(name, truth, modbus.calibration)
            self.devices[name] = VirtualModbus(modbus.form, read, self._sender(name))
        if settings.supply is not None:
            rng = self._rng("supply")
            self.devices["supply"] = self.supply = VirtualSupply(
                self._sender("supply"),
                settings.supply.serial or "supply",
                max_v=settings.supply.max_v,
                noise_v=lambda: float(rng.normal(0.0, SUPPLY_NOISE_V)),
            )
        self.inputs: VirtualInputs | None = None
        """What is connected to the controller's further inputs."""
        if settings.channels:
            self.inputs = self._inputs(settings.channels)
        self.card: VirtualCard | None = None
        if settings.card is not None:
            self.devices["card"] = self.card = self._card(settings.card)
        self.eye: JointEye | None = None
        """What the camera of a joint sees."""
        for name, marks in settings.marks.items():
            self.eye = self._eye(name, marks)
        self.regulator: RegulatorOutlet | None = None
        self.without_port: dict[str, Emulator] = {}
        source = self._config.pressure_source
        if source.port:
            made = self.devices["pressure_source"] = self._pressure_source()
            self._has_outlet(getattr(made, "outlet", None))
        elif source.kind == "analogue-regulator":
            outlet = self.without_port["regulator"] = RegulatorOutlet(self._bench.plant)
            self._has_outlet(outlet)

    def _inputs(self, channels: dict[str, ControllerChannel]) -> VirtualInputs:
        truth = {
            name: self._sensor(name, self._truth(name, c.form.quantity), c.calibration, noisy=False)
            for name, c in channels.items()
        }
        return VirtualInputs(channels, truth, self._rng("inputs"))

    def _eye(self, name: str, device: MarkDevice) -> JointEye:
        plant, virtual = self._bench.plant, self._config.virtual
        camera = self._config.camera
        assert isinstance(plant, JointLoad)
        assert virtual is not None
        assert camera.marks is not None
        truth = self._truth(name, device.form.quantity)
        return JointEye(
            camera.marks,
            device.mark,
            self._sensor(name, truth, device.calibration, noisy=False),
            lambda: plant.rate_deg_s * device.calibration.scale,
            self._rng("camera"),
            virtual.blur_px,
            virtual.frame_noise_levels,
            self._config.source,
        )

    @property
    def card_library(self) -> Any:
        """The mock of the manufacturer's package."""
        return None if self.card is None else library_of(self.card)

    def _card(self, device: CardDevice) -> VirtualCard:
        truths: dict[str, Callable[[], float]] = {
            "temperature_c": lambda: self.temperature_c,
            "force_n": lambda: self._cell_n("load_cell"),
            "pressure_kpa": lambda: self._bench.plant.pressure_kpa,
            "length_mm": lambda: self._bench.plant.length_mm,
        }
        read = {
            channel.terminal: self._sensor(name, truths[channel.form.quantity], channel.calibration)
            for name, channel in device.channels.items()
        }

        def set_volts(terminal: str, volts: float) -> None:
            output = device.output
            if output is not None and terminal == output.terminal:
                kpa = (volts - output.zero_v) / output.volts_per_kpa
                self._bench.plant.set_regulator(min(max(kpa, 0.0), 700.0))

        clock = self._bench.clock
        return VirtualCard(device, read, set_volts, time.sleep if clock is None else clock.sleep)

    def _pressure_source(self) -> Emulator:
        """That of the rig's pressure source, of the module with its driver's name."""
        kind = self._config.pressure_source.kind
        module = source_module(kind, "rigs.virtual.emulators")
        made: Emulator = module.emulator(
            self._config.pressure_source, self._bench.plant, self._sender("pressure_source")
        )
        return made

    def _has_outlet(self, outlet: RegulatorOutlet | None) -> None:
        """The pressure upstream of the inlet is that of an emulated regulator, which is drawn."""
        virtual = self._config.virtual
        if outlet is None or virtual is None:
            return
        if virtual.source != "regulator":
            raise ConfigError(
                f"{self._config.source}: virtual.source",
                f"is {virtual.source!r}, and {self._config.pressure_source.kind!r} is a regulator",
                'set it to "regulator"',
            )
        rng = self._rng("regulator")
        outlet.dynamics = draw(rng, virtual.regulator)
        outlet.seed(rng)
        self.regulator = outlet

    def regulator_input(self) -> Callable[[float, int], None] | None:
        """Takes counts of the controller's analogue output and the bench time in ns.

        None: they go to the plant's own regulator.
        """
        outlet, output = self.regulator, self._config.pressure_source.output
        if outlet is None:
            return None
        if output is None:  # it has a port of its own: nothing hangs on the analogue output
            return lambda counts, at_ns: None

        def take(counts: float, at_ns: int) -> None:
            outlet.set_point(max(float(output.apply(counts)), 0.0), at_ns)

        return take

    def _rng(self, name: str) -> np.random.Generator:
        seed = self._config.virtual.seed if self._config.virtual is not None else 0
        return np.random.default_rng([seed, 50, zlib.crc32(name.encode())])

    def _sender(self, name: str) -> Callable[[bytes], None]:
        return lambda data: self._bench.transmit(name, data)

    def _sensor(
        self,
        name: str,
        truth: Callable[[], float],
        calibration: Calibration,
        noisy: bool = True,
    ) -> Callable[[], float]:
        """The truth with this sensor's zero and gain error and noise, in its own unit."""
        rng = self._rng(name)
        drawn = self._config.virtual is not None and self._config.virtual.draw_calibration_errors
        zero, gain = rng.standard_normal(2) if drawn else (0.0, 0.0)
        noise = self._noise(calibration.quantity, rng) if noisy else lambda value: 0.0

        def read() -> float:
            value = truth()
            value += zero * calibration.u_offset + gain * calibration.u_gain * value + noise(value)
            return float(calibration.raw(value))

        return read

    def _noise(self, quantity: str, rng: np.random.Generator) -> Callable[[float], float]:
        if quantity == "force_n":
            slow = {"n": 0.0, "t": 0.0}

            def cell(value: float) -> float:
                del value
                now_s = self._bench.time_s
                keep = math.exp(-(now_s - slow["t"]) / CELL_SLOW_S)
                slow["t"] = now_s
                step = CELL_SLOW_N * math.sqrt(1.0 - keep * keep)
                slow["n"] = keep * slow["n"] + float(rng.normal(0.0, step))
                return slow["n"] + float(rng.normal(0.0, CELL_NOISE_N))

            return cell
        share = {
            "temperature_c": THERMOMETER_NOISE_C, "pressure_kpa": TRANSMITTER_NOISE_KPA,
            "angle_deg": ENCODER_NOISE_DEG, "torque_n_m": TORQUE_NOISE_N_M,
            "length_mm": DISPLACEMENT_NOISE_MM,
        }  # fmt: skip
        if quantity == "velocity_m_s":
            return lambda value: float(rng.normal(0.0, VELOCITY_NOISE * max(abs(value), 0.1)))
        return lambda value: float(rng.normal(0.0, share.get(quantity, 0.0)))

    def _truth(
        self, name: str, quantity: str, text: TextDevice | None = None
    ) -> Callable[[], float]:
        plant = self._bench.plant
        if isinstance(plant, JointLoad) and quantity in ("angle_deg", "torque_n_m"):
            angle = quantity == "angle_deg"
            return lambda: plant.angle_deg if angle else plant.lock_torque_n_m
        match quantity:
            case "temperature_c":
                return lambda: self.temperature_c
            case "force_n":
                return lambda: self._cell_n(name)
            case "pressure_kpa":
                return lambda: self._bench.plant.pressure_kpa
            case "length_mm":
                return self._length(name)
            case "velocity_m_s" if text is not None:
                return self._velocity(text.bore_mm)
        return lambda: text.virtual_value if text is not None else 0.0

    def _length(self, name: str) -> Callable[[], float]:
        """Length of the muscle; effects on the length reading concern the source of the length."""
        if name != self._config.length_source:
            return lambda: self._bench.plant.length_mm
        return lambda: self._bench.sensor_error.length_mm(self._bench.plant.length_mm)

    def pull_n(self) -> float:
        """Pull on the load cell: the muscle's, or a dead weight's in its place.

        A load that hangs on the muscle pulls with its weight, whatever part of it the braid and
        what part its stop bears; what it takes to start and stop the load is left out.
        """
        gravity, plant = self._config.conditions.gravity_m_s2, self._bench.plant
        if self.hung_kg is not None:
            return self.hung_kg * gravity
        return float(plant.params[MASS]) * gravity if plant.load == "isotonic" else plant.force_n

    def _cell_n(self, name: str) -> float:
        """What the load cell shows of it; effects on the force reading concern one sensor."""
        joint, plant = self._config.joint, self._bench.plant
        if joint is not None and isinstance(plant, JointLoad):
            return plant.lock_torque_n_m / (joint.lever_mm * 1e-3)
        pull = self.pull_n()
        if self._config.force_source != name:
            return pull
        return self._bench.sensor_error.force_n(pull)

    def _velocity(self, bore_mm: float) -> Callable[[], float]:
        """Mean velocity of the air in the outlet line since the last reading, in m/s."""
        area_m2 = math.pi / 4 * (bore_mm * 1e-3) ** 2
        constants = self._bench.plant.constants
        density = constants.atmosphere_pa / (GAS_CONSTANT_J_KG_K * constants.gas_temperature_k)
        last = {"kg": 0.0, "s": 0.0, "v": 0.0}

        def read() -> float:
            kg, now_s = float(self._bench.plant.state[MASS_OUT]), self._bench.time_s
            if now_s > last["s"]:
                last["v"] = (kg - last["kg"]) / (density * area_m2 * (now_s - last["s"]))
                last["kg"], last["s"] = kg, now_s
            return last["v"]

        return read

    def solenoid_volts(self) -> float:
        """What the supply gives the solenoids now."""
        return self.supply.volts if self.supply is not None else 0.0

    def operator(self, clock: Clock | None = None, seconds: float = 5.0) -> VirtualOperator | None:
        """A person at this bench; None where neither it nor the caller has a clock."""
        clock = clock or self._bench.clock
        if clock is None:
            return None
        plant = self._bench.plant

        def weigh(kg: float) -> None:
            self.hung_kg = kg

        def unhang(value: float) -> None:
            del value
            self.hung_kg = None
            self._bench.sensor_error.take_block()

        def turn(value: float) -> None:
            if isinstance(plant, JointLoad):
                plant.lock(value)

        def free(value: float) -> None:
            del value
            if isinstance(plant, JointLoad):
                plant.release()

        def warm(value: float) -> None:
            self.temperature_c = value

        return VirtualOperator(
            clock,
            steps={
                "length": plant.set_length,
                "pressure": plant.set_regulator,
                "supply": plant.set_supply,
                "dead weight": weigh,
                "muscle": unhang,
                "muscle off": lambda _: weigh(0.0),
                "temperature": warm,
                "mass": lambda kg: hang(plant, kg),
                "angle": turn,
                "lock off": free,
                "block": self._bench.sensor_error.place_block,
            },
            reads={
                "reference pressure": lambda: float(plant.state[PRESSURE]) * 1e-3,
                "temperature": lambda: self.temperature_c,
                "holders": lambda: float(plant.state[LENGTH]) * 1e3,
            },
            rng=self._rng("operator"),
            spread=HAND,
            seconds=seconds,
        )
