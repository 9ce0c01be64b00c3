"""The virtual bench: byte-level instruments over one plant, on one clock."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.clock import VirtualClock
from daq.errors import ConfigError, LinkLost, PortError
from daq.link.transport import Link, memory_pair
from plant.constants import nominal
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.simulator.bench import BenchSim
from rigs.rigfile.config import PRESSURE_B, RigConfig
from rigs.rigfile.tables.stage import MANUAL, stage_module
from rigs.virtual.board.board import Advance, PressureSensor, SimBoard
from rigs.virtual.board.joint_load import JointBoard, JointLoad, Pair, read_joint_constants
from rigs.virtual.board.ram_load import RamLoad
from rigs.virtual.board.solenoids import Solenoids
from rigs.virtual.emulators.balance import VirtualBalance
from rigs.virtual.emulators.emulator import Emulator
from rigs.virtual.emulators.pictures.camera import CameraModel, led_exposure, render
from rigs.virtual.emulators.pictures.joint_eye import EXPOSURE_S, JointEye
from rigs.virtual.emulators.sensor_error import SensorError, refuse_changing_scales
from rigs.virtual.extras import Extras

DRIFT = 25e-6
"""The controller's crystal is slower than the host's by this much: a clock fit has work."""

Send = Callable[[int, bytes], None]
Slots = npt.NDArray[np.float64]


class VirtualBench:
    """Valve controller, balance, stage and camera on one simulated muscle.

    Bytes go in through :meth:`feed` and come out through ``send[device]``, stamped with the
    host time of sending. With a virtual clock the bench hangs itself onto that clock and
    offers in-memory links; without one somebody else calls :meth:`advance_to`.

    Args:
        config: a rig with a [virtual] table.
        clock: virtual clock to run on, or None.
        origin_ns: host time at power-on, when there is no virtual clock.

    Raises:
        ConfigError: the plant refuses a constant or an effect of the rig file.
    """

    def __init__(
        self, config: RigConfig, clock: VirtualClock | None = None, origin_ns: int = 0
    ) -> None:
        if config.virtual is None:
            raise ConfigError(config.source, "has no [virtual] table", "see configs/rigs")
        self.config = config
        self._v = config.virtual
        self._clock = self.clock = clock
        self._origin_ns = clock.now_ns() if clock is not None else origin_ns
        self._now_ns = 0
        self.send: dict[str, Send] = {}
        self.links: dict[str, Link] = {}
        self._device_ends: dict[str, Link] = {}
        self._unplugged: set[str] = set()
        self._frames = 0
        streams = [np.random.default_rng([self._v.seed, k]) for k in range(6)]
        self.plant = self._make_plant()
        self.sensor_error = self._make_sensor_error()
        self.extras = Extras(self)
        on_joint = isinstance(self.plant, JointLoad)
        own = ("valve", "valve_b") if on_joint else ("valve", "balance", "stage")
        self.devices = (*own, *self.extras.devices)
        """Names of everything that has a port."""
        if clock is not None:
            self._make_links(clock)
        self._errors = self._draw_errors(streams[4])
        self.boards = self._make_boards(streams[0], streams[5])
        """Controllers by their names in the rig file."""
        self.board = self.boards["valve"]
        self.board.regulator_input = self.extras.regulator_input()
        self.board.inputs = self.extras.inputs
        self.board.output_joined = config.pressure_source.kind != "card-output"
        self.emulators: dict[str, Emulator] = dict(self.boards)
        """Every device, in the order in which time reaches them."""
        self._camera_rng = streams[2]
        if not on_joint:
            self._make_muscle_devices(streams[1])
        self.emulators |= {**self.extras.devices, **self.extras.without_port}
        if clock is not None:
            clock.on_advance(self.advance_to)

    # ---- building -------------------------------------------------------------------

    def _make_muscle_devices(self, rng: np.random.Generator) -> None:
        """Balance, stage and camera, which a bench with a joint does not have."""
        config = self.config
        self.balance = self._make_balance(rng)
        self.stage = self._make_stage()
        self.emulators |= {"stage": self.stage, "balance": self.balance}
        cal = config.calibrations["length_mm"]
        sync = config.camera.sync
        self.camera_model = CameraModel(
            offset_mm=cal.offset,
            mm_per_pixel=cal.scale,
            blur_px=self._v.blur_px,
            noise=self._v.frame_noise_levels,
            exposure_s=sync.exposure_ms * 1e-3 if sync else 0.004,
            readout_s=sync.readout_ms * 1e-3 if sync else 0.0,
        )

    def _make_plant(self) -> BenchSim:
        source = self.config.source
        try:
            constants = nominal().with_overrides(self._v.plant)
            effects = Effects.from_config(self._v.effects)
            refuse_changing_scales(effects)
            low = self.config.limits.length_min_mm
            high = self.config.limits.length_max_mm
            if self._v.load == "ram":
                return RamLoad(constants, effects)
            if self._v.load == "joint":
                return JointLoad(
                    constants,
                    effects,
                    read_joint_constants(self._v.joint, source),
                    "regulator" if self._v.source == "regulator" else "valve",
                )
            return BenchSim(
                constants,
                effects,
                source="regulator" if self._v.source == "regulator" else "valve",
                length_m=(low + high) / 2 * 1e-3,
            )
        except PlantError as error:
            raise ConfigError(f"{source}: virtual.plant / effects", str(error)) from None

    def _make_sensor_error(self) -> SensorError:
        sensor_error = SensorError(self.plant)
        try:
            sensor_error.length_mm(self.plant.length_mm)
        except PlantError as error:
            raise ConfigError(f"{self.config.source}: effects", str(error)) from None
        return sensor_error

    def _make_links(self, clock: VirtualClock) -> None:
        for name in self.devices:
            self._plug_in(name, clock)

    def _plug_in(self, name: str, clock: VirtualClock) -> Link:
        self.links[name], end = memory_pair(clock, name)
        self._device_ends[name] = end

        def send(host_ns: int, data: bytes) -> None:
            clock.set_now_ns(host_ns)
            if self._device_ends.get(name) is end:
                with contextlib.suppress(LinkLost):  # a device does not notice a pulled cable
                    end.write(data)

        self.send[name] = send
        return self.links[name]

    def plug_in(self) -> VirtualClock:
        """Connect every device anew, as a host does that comes back for another test.

        Returns:
            The clock that the bench hangs on.

        Raises:
            PortError: the bench hangs on no virtual clock.
        """
        if self.clock is None:
            raise PortError("bench", "runs in real time, behind ports of its own")
        for name in self.devices:
            self._plug_in(name, self.clock)
        return self.clock

    def unplug(self, name: str) -> None:
        """Pull a device's cable; :meth:`reopen` fails until :meth:`replug`."""
        end = self._device_ends.pop(name)
        self._unplugged.add(name)
        end.close()

    def replug(self, name: str) -> None:
        """Put the cable back; the host must open the port anew."""
        self._unplugged.discard(name)

    def reopen(self, name: str) -> Link:
        """Open a device's port anew, as a host does after it was lost.

        Raises:
            PortError: it is still unplugged.
        """
        if name in self._unplugged or self._clock is None:
            raise PortError(name, "no such port", "plug the device in")
        return self._plug_in(name, self._clock)

    def _draw_errors(self, rng: np.random.Generator) -> dict[str, tuple[float, float]]:
        """Zero and gain error of each sensor, as its calibration allows (k = 1)."""
        out = {}
        for quantity, cal in sorted(self.config.calibrations.items()):
            zero, gain = rng.standard_normal(2)
            on = 1.0 if self._v.draw_calibration_errors else 0.0
            out[quantity] = (on * zero * cal.u_offset, on * gain * cal.u_gain)
        return out

    def _make_boards(
        self, rng: np.random.Generator, rng_b: np.random.Generator
    ) -> dict[str, SimBoard]:
        plant, second = self.plant, self.config.side_b
        if not isinstance(plant, JointLoad) or second is None:
            return {"valve": self._make_board(rng)}
        boards = []
        for unit, (name, config, own) in enumerate(
            (("valve", self.config, rng), ("valve_b", second, rng_b))
        ):
            quantity = "pressure_kpa" if name == "valve" else PRESSURE_B
            boards.append(
                JointBoard(
                    plant.scene, unit, own,
                    sensor=self._transducer(quantity),
                    serial=config.valve.serial,
                    outlet_normally_open=config.valve.outlet_normally == "open",
                    has_regulator=self._v.source == "regulator",
                    sink=self._sink(name),
                )
            )  # fmt: skip
        Pair(plant, (boards[0], boards[1]))
        return {"valve": boards[0], "valve_b": boards[1]}

    def _sink(self, name: str) -> Callable[[int, bytes], None]:
        return lambda bench_us, data: self._send(name, data, bench_us * 1000)

    def _transducer(self, quantity: str) -> PressureSensor:
        zero, gain = self._errors[quantity]
        cal = self.config.calibrations[quantity]
        return PressureSensor(
            low_kpa=cal.offset,
            high_kpa=cal.offset + cal.scale * 4095,
            noise_kpa=self._v.pressure_noise_kpa,
            zero_kpa=zero + self.sensor_error.pressure_zero_kpa,
            gain=(1.0 + gain) * (1.0 + self.sensor_error.pressure_gain) - 1.0,
        )

    def _make_board(self, rng: np.random.Generator) -> SimBoard:
        return SimBoard(
            self.plant,
            rng,
            sensor=self._transducer("pressure_kpa"),
            serial=self.config.valve.serial,
            outlet_normally_open=self.config.valve.outlet_normally == "open",
            has_regulator=self._v.source == "regulator",
            sink=self._sink("valve"),
            advance=self._make_step(),
        )

    def _make_stage(self) -> Any:
        """The emulator of the rig's kind of stage; that of a stage that nobody drives is idle."""
        device, limits = self.config.stage, self.config.limits
        kind = "grbl" if device.kind == MANUAL else device.kind
        return stage_module(kind, "rigs.virtual.emulators.motion").emulator(
            device,
            (limits.length_min_mm, limits.length_max_mm),
            self.plant.length_mm - self.sensor_error.label_mm,
            self._set_motion,
            lambda data: self._send("stage", data),
        )

    def _ram_step(self, ram: RamLoad) -> Advance:
        """One tick of the ram; its proximity switches reach the board."""

        def step(state: Slots, params: Slots, dt_s: float, fill_s: float, vent_s: float) -> None:
            ram.ram.step(state, params, dt_s, fill_s, vent_s)
            self.board.prox_bits = ram.ram.prox_bits

        return step

    def _make_step(self) -> Advance | None:
        """With a bench supply the solenoids need its voltage; without, they always have it."""
        if isinstance(self.plant, RamLoad):
            return self._ram_step(self.plant)
        if "supply" not in self.extras.devices:
            return None
        return Solenoids(self.plant.constants, self.extras.solenoid_volts).advance

    def _lift_n(self) -> float:
        """What is taken off the balance: the muscle's pull; a dead weight on the pan adds.

        A muscle that a load hangs on is not joined to the balance.
        """
        if self.plant.load != "isometric":
            return 0.0
        return self.plant.force_n if self.extras.hung_kg is None else -self.extras.pull_n()

    def _make_balance(self, rng: np.random.Generator) -> VirtualBalance:
        on = self._v.draw_calibration_errors
        cal = self.config.calibrations["force_n"]
        return VirtualBalance(
            self._lift_n,
            lambda data: self._send("balance", data),
            rng,
            self.config.balance.serial,
            self.config.conditions.gravity_m_s2,
            gain=self._force_gain(),
            zero_n=cal.u_offset if on else 0.0,
            noise_n=self._v.force_noise_n,
            offset_n=self.sensor_error.force_zero_n if self._balance_tells else 0.0,
        )

    @property
    def _balance_tells(self) -> bool:
        """Whether the effects on the force reading concern the balance, not a load cell."""
        return self.config.force_source == "balance"

    def _force_gain(self) -> float:
        gain = self._errors["force_n"][1]
        extra = self.sensor_error.force_gain if self._balance_tells else 0.0
        return (1.0 + gain) * (1.0 + extra) - 1.0

    # ---- time -----------------------------------------------------------------------

    def host_ns(self, bench_ns: int) -> int:
        """Host time of a bench time in ns since power-on."""
        return self._origin_ns + bench_ns + round(bench_ns * DRIFT)

    def bench_us(self, host_ns: int) -> int:
        """Bench time, in us since power-on, of a host time."""
        return int((host_ns - self._origin_ns) / (1.0 + DRIFT)) // 1000

    def _send(self, device: str, data: bytes, bench_ns: int | None = None) -> None:
        send = self.send.get(device)
        if send is not None:
            send(self.host_ns(self._now_ns if bench_ns is None else bench_ns), data)

    def transmit(self, device: str, data: bytes) -> None:
        """Bytes from a device go to the host, now."""
        self._send(device, data)

    @property
    def time_s(self) -> float:
        """Bench time since power-on."""
        return self._now_ns * 1e-9

    def feed(self, device: str, data: bytes) -> None:
        """Bytes from the host reach a device."""
        self.emulators[device].feed(data)

    def advance_to(self, host_ns: int) -> None:
        """Bring the bench to a host time, stopping wherever a device has something to do."""
        for name, end in list(self._device_ends.items()):
            try:
                for chunk in end.read():
                    self.feed(name, chunk.data)
            except LinkLost:  # the host closed the port
                self._device_ends.pop(name)
        target_us = self.bench_us(host_ns)
        board, *others = self.emulators.values()
        while True:
            due = [ns for device in others if (ns := device.next_ns) is not None]
            stop_us = min([target_us, *(-(-ns // 1000) for ns in due)])
            board.advance(stop_us * 1000)  # the plant moves with it
            self._now_ns = max(self._now_ns, stop_us * 1000)
            self.sensor_error.age(self.extras.temperature_c)
            for device in others:
                device.advance(self._now_ns)
            if stop_us >= target_us:
                return

    def _set_motion(self, length_mm: float, rate_mm_s: float) -> None:
        if self.plant.load != "isometric":  # the stage is not joined to the muscle
            return
        length_mm += self.sensor_error.label_mm
        if rate_mm_s == 0.0 and abs(length_mm - self.plant.length_mm) > 1e-12:
            self.plant.set_length(length_mm)
        self.plant.set_length_rate(rate_mm_s)

    def _host_now_ns(self) -> int:
        return self._clock.now_ns() if self._clock is not None else time.monotonic_ns()

    # ---- camera ---------------------------------------------------------------------

    def expose(self) -> tuple[int, int, npt.NDArray[np.uint8]]:
        """A frame that begins now: (count, host time it is stamped with, grey levels).

        It takes as long as exposure and read-out do, and its stamp is late by the camera's
        delay, as that of a real one is.
        """
        if self.extras.eye is not None:
            return self._expose_marks(self.extras.eye)
        if "length_mm" not in self.config.calibrations:
            raise PortError("camera", "this bench has none")
        late_s = self.sensor_error.camera_delay_s
        sleep = self._clock.sleep if self._clock is not None else time.sleep
        begin_ns, true_mm = self._host_now_ns(), self.plant.length_mm
        if late_s != 0.0:
            # The muscle is seen `late_s` before stamp and LED, or after them where it is negative.
            sleep(abs(late_s))
            if late_s > 0.0:
                begin_ns = self._host_now_ns()
            else:
                true_mm = self.plant.length_mm
        zero, gain = self._errors["length_mm"]
        cal = self.config.calibrations["length_mm"]
        seen_mm = self.sensor_error.length_mm(true_mm)
        apparent_mm = seen_mm + zero + gain * (seen_mm - cal.offset)
        delay_s = self._v.camera_delay_ms * 1e-3
        model = self.camera_model
        wait_s = max(delay_s, model.exposure_s + model.readout_s) + 2e-3
        sleep(wait_s)
        led: float | npt.NDArray[np.float64] = 0.0
        toggles_s = np.array(self.board.led_toggles_us, dtype=np.float64) * 1e-6
        if len(toggles_s):
            led = led_exposure(toggles_s, (begin_ns - self._origin_ns) * 1e-9 / (1 + DRIFT), model)
        gray = render(apparent_mm, self._camera_rng, model, led=led)
        self._frames += 1
        return self._frames, begin_ns + round(delay_s * 1e9), gray

    def _expose_marks(self, eye: JointEye) -> tuple[int, int, npt.NDArray[np.uint8]]:
        """The marks of a joint; the stamp is late as that of the other pictures."""
        begin_ns, gray = self._host_now_ns(), eye.picture()
        delay_s = self._v.camera_delay_ms * 1e-3
        sleep = self._clock.sleep if self._clock is not None else time.sleep
        sleep(max(delay_s, EXPOSURE_S) + 2e-3)
        self._frames += 1
        return self._frames, begin_ns + round(delay_s * 1e9), gray

    @property
    def camera_noise(self) -> float:
        """Noise of its pictures, in grey levels."""
        return self._v.frame_noise_levels if self.extras.eye else self.camera_model.noise
