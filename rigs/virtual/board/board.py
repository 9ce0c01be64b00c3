"""The valve controller's board over the simulated bench: real firmware, virtual hardware.

One millisecond at a time the plant advances under the valve times of the last ``drive`` and the
firmware ticks once. Bytes go through two in-memory pipes; who sits at the far end (a
pseudo-terminal, a link on the virtual clock) is not known here.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from plant.physics.layout import PRESSURE_LAG, PRESSURE_READ
from rigs.virtual.board.fast_capture import FastCapture
from rigs.virtual.board.pressure_sensor import ADC_TOP
from rigs.virtual.board.pressure_sensor import PressureSensor as PressureSensor
from rigs.virtual.board.timing import LoopTiming
from valvefw.board import DRIVE_SILENCE_US, I2C_NOBODY
from valvefw.controller import Controller
from valvefw.deskboard import BufferedBoard
from valvefw.schemes.valves import VENT_HOLD_US
from valvefw.wire import TICK_US

TICK_S = TICK_US * 1e-6
NOISE_BLOCK = 4096
BOOT_US = 50_000
WATCHDOG_US = 200_000
UART_BYTES = 1024
PRESSURE_SLOT = 1
REGULATOR_SLOT = 6

MEASURED = LoopTiming()
Advance = Callable[[npt.NDArray[np.float64], npt.NDArray[np.float64], float, float, float], object]


class SimulatedPlant(Protocol):
    """What the board needs of the plant: its two arrays (``plant.physics.layout``)."""

    state: npt.NDArray[np.float64]
    params: npt.NDArray[np.float64]


class InputPins(Protocol):
    """What is connected to the further inputs; times are of the bench, us (``Board``)."""

    def bridge_start(self, pulses: int, now_us: int) -> None: ...  # noqa: D102
    def bridge(self, now_us: int) -> int: ...  # noqa: D102
    def i2c_begin(self, register: int, word: int, now_us: int) -> None: ...  # noqa: D102
    def i2c_done(self) -> int: ...  # noqa: D102
    def encoder_start(self, on: int) -> None: ...  # noqa: D102
    def encoder(self) -> int: ...  # noqa: D102
    def analogue(self, which: int) -> int: ...  # noqa: D102


class SimBoard(BufferedBoard):
    """A board whose valves, sensor and regulator act on a simulated plant.

    Args:
        plant: the bench, one control tick per call of ``advance``.
        rng: source of the ADC noise and of boot ids.
        sensor: the pressure sensor with its errors.
        regulator_zero_kpa, regulator_gain: errors of the regulator, where there is one; its input
            has the nominal scale of the pressure reading.
        outlet_normally_open: True vents without power; False traps the air then.
        start_ticks_us: device time at power-on, to test its wrap-around.
        truth_every: ticks between two entries of the true pressure's log; 0 keeps none.
        sink: called as ``sink(bench_us, data)`` for what the firmware sends, at the virtual time
            of sending; without it ``take_timed`` collects.
        advance: the plant's stepping function, by default ``plant.simulator.bench.advance``.
        timing: how long requests keep the firmware's loop from its scheme.

    ``bench_us`` counts from power-on of the bench and never jumps back; device time
    (``ticks_us``) restarts with each reset and wraps.
    """

    def __init__(  # noqa: PLR0913 - a board has that many named properties
        self,
        plant: SimulatedPlant,
        rng: np.random.Generator,
        *,
        sensor: PressureSensor | None = None,
        name: str = "sim",
        serial: str = "SIM-0001",
        outlet_normally_open: bool = True,
        has_regulator: bool = False,
        regulator_zero_kpa: float = 0.0,
        regulator_gain: float = 0.0,
        start_ticks_us: int = 0,
        truth_every: int = 10,
        sink: Callable[[int, bytes], None] | None = None,
        advance: Advance | None = None,
        timing: LoopTiming = MEASURED,
    ) -> None:
        if advance is None:
            from plant.simulator.bench import advance as plant_advance

            advance = plant_advance
        super().__init__()
        self.plant = plant
        self.sensor = sensor or PressureSensor()
        self.name = name
        self.serial = serial
        self.outlet_normally_open = outlet_normally_open
        self.has_regulator = has_regulator
        self.output_joined = True
        """False where the regulator is not on this controller's output."""
        self.reset_cause = "power"
        self.sink = sink
        self.timing = timing
        self._loop_busy_us = 0
        self.bench_us = 0
        self.led_on = False
        self.led_toggles_us = array("q")
        """Bench times at which the sync LED changed, the first of them to lit."""
        self.prox_bits = 0
        self.vent_commanded_us = 0
        """Bench time of the last change from anything else to steady venting."""
        self.sensor_override: int | None = None
        """Counts the converter returns whatever the pressure: a broken wire, a stuck sensor.
        Below 0 it returns nothing at all."""
        self.inlet_jammed = False
        """The inlet does not shut any more, whatever its solenoid does."""
        self.outlet_jammed = False
        """The outlet does not shut any more."""
        self.regulator_input: Callable[[float, int], None] | None = None
        """Takes the counts of the analogue output, and the time in ns, where an emulated regulator
        is connected."""
        self.inputs: InputPins | None = None
        """What is connected to the further inputs."""
        self.truth_us = array("q")
        self.truth_kpa = array("d")
        self._truth_every = truth_every
        self._truth_left = truth_every
        self._advance = advance
        self._rng = rng
        self._regulator_zero_kpa = regulator_zero_kpa
        self._regulator_gain = regulator_gain
        self._noise: list[float] = []
        self._noise_at = NOISE_BLOCK
        self._fast: FastCapture | None = None
        self._timed: list[tuple[int, bytes]] = []
        self._inlet_us = 0
        self._vent_us = 0
        self._venting = False
        self._driven_us = 0
        self._fed_us = 0
        self._device_us = start_ticks_us & 0xFFFFFFFF
        self._counts = 0
        self._halted = False
        self._boot_at_us: int | None = None
        self._sample()
        self.controller = Controller(self)
        self._tick()

    # What the firmware calls.

    def ticks_us(self) -> int:
        """Device time at the present tick."""
        return self._device_us

    def adc(self) -> int:
        """Reading at the present tick."""
        return self._counts

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """Valve times from now."""
        self._inlet_us = inlet_us
        self._vent_us = vent_us
        if vent_us >= VENT_HOLD_US and not inlet_us:
            if not self._venting:
                self._venting = True
                self.vent_commanded_us = self.bench_us
        else:
            self._venting = False

    def regulator(self, counts_x16: int) -> None:
        """Set-point of the regulator."""
        if self.regulator_input is not None:
            self.regulator_input(counts_x16 / 16, self.bench_us * 1000)
            return
        if not self.output_joined:
            return
        sensor = self.sensor
        kpa = counts_x16 / 16 / sensor.counts_per_kpa + sensor.low_kpa if counts_x16 else 0.0
        kpa = kpa * (1.0 + self._regulator_gain) + (self._regulator_zero_kpa if kpa else 0.0)
        self.plant.state[REGULATOR_SLOT] = max(0.0, kpa) * 1e3

    def led(self, on: int) -> None:
        """Sync LED."""
        if bool(on) != self.led_on:
            self.led_on = bool(on)
            self.led_toggles_us.append(self.bench_us)

    def prox(self) -> int:
        """Proximity inputs."""
        return self.prox_bits

    def tx(self, data: bytes | bytearray, n: int) -> None:
        """Bytes to the host."""
        sent = bytes(data[:n])
        if self.sink is not None:
            self.sink(self.bench_us, sent)
        else:
            self._timed.append((self.bench_us, sent))

    def bridge_start(self, pulses: int) -> None:
        """Clock a bridge converter."""
        if self.inputs is not None:
            self.inputs.bridge_start(pulses, self.bench_us)

    def bridge(self) -> int:
        """Its next conversion."""
        return -1 if self.inputs is None else self.inputs.bridge(self.bench_us)

    def i2c_begin(self, register: int, word: int) -> None:
        """To or from the ADS1115."""
        if self.inputs is not None:
            self.inputs.i2c_begin(register, word, self.bench_us)

    def i2c_done(self) -> int:
        """The word that was read."""
        return I2C_NOBODY if self.inputs is None else self.inputs.i2c_done()

    def encoder_start(self, on: int) -> None:
        """Count from 0 on."""
        if self.inputs is not None:
            self.inputs.encoder_start(on)

    def encoder(self) -> int:
        """The count."""
        return -1 if self.inputs is None else self.inputs.encoder()

    def analogue(self, which: int) -> int:
        """Second or third analogue input."""
        return -1 if self.inputs is None else self.inputs.analogue(which)

    def capture(self, source: int) -> bool:
        """Fast samples from the present tick on."""
        self._fast = FastCapture(self, source, self._rng)
        return True

    def captured(self) -> bytes:
        """The last block, once complete."""
        return self._fast.block if self._fast is not None else b""

    def feed(self, data: bytes) -> None:
        """Bytes from the host arrive; what the UART's buffer cannot hold is lost."""
        super().feed(data[: max(0, UART_BYTES - len(self._received))])

    def tidy(self) -> None:
        """Collecting garbage takes the chip this long."""
        self._loop_busy_us += self.timing.collect_us

    def wdt_feed(self) -> None:
        """Nothing to do: while the firmware ticks it also feeds."""

    def random16(self) -> int:
        """Boot id."""
        return int(self._rng.integers(1, 65536))

    # What the bench calls.

    @property
    def pressure_kpa(self) -> float:
        """True gauge pressure in the muscle."""
        return float(self.plant.state[PRESSURE_SLOT]) * 1e-3

    @property
    def pressure_slot(self) -> int:
        """Where in the plant's state the transducer reads: behind its lag, where it has one."""
        return PRESSURE_READ if self.plant.params[PRESSURE_LAG] > 0.0 else PRESSURE_SLOT

    @property
    def next_ns(self) -> int | None:
        """Nothing: the firmware ticks each millisecond, wherever :meth:`advance` stops."""
        return None

    def advance(self, to_ns: int) -> None:
        """Let time pass, in whole ticks."""
        self.run_until_us(to_ns // 1000)

    def take_timed(self) -> list[tuple[int, bytes]]:
        """What the firmware sent since the last call, with bench times."""
        sent = self._timed
        self._timed = []
        return sent

    def run_until_us(self, until_us: int) -> None:
        """Advance by whole ticks up to and including bench time ``until_us``."""
        while self.bench_us + TICK_US <= until_us:
            if self._halted:
                self._step_halted()
            else:
                self._run(until_us)

    def _run(self, until_us: int) -> None:
        """The inner loop: as few attribute look-ups and objects as can be."""
        advance = self._advance
        state = self.plant.state
        params = self.plant.params
        read = state.item
        tick = self._tick
        per_pa = self._counts_per_pa
        seen = self.pressure_slot
        now_us = self.bench_us
        noise, at = self._noise, self._noise_at
        every, left = self._truth_every, self._truth_left
        while now_us + TICK_US <= until_us:
            inlet_us = TICK_US if self.inlet_jammed else self._inlet_us
            vent_us = TICK_US if self.outlet_jammed else self._vent_us
            if self._fast is None or self._fast.block:
                advance(
                    state,
                    params,
                    TICK_S,
                    TICK_S if inlet_us >= TICK_US else inlet_us * 1e-6,
                    TICK_S if vent_us >= TICK_US else vent_us * 1e-6,
                )
            else:
                self._fast.tick(advance, inlet_us, vent_us)
            now_us += TICK_US
            self.bench_us = now_us
            self._device_us = (self._device_us + TICK_US) & 0xFFFFFFFF
            if at >= NOISE_BLOCK:
                self._draw_noise()
                noise, at = self._noise, 0
            counts = int(read(seen) * per_pa + noise[at])
            at += 1
            if counts < 0:
                counts = 0
            elif counts > ADC_TOP:
                counts = ADC_TOP
            if self.sensor_override is not None:
                counts = self.sensor_override
            self._counts = counts
            left -= 1
            if not left:
                left = every
                self.truth_us.append(now_us)
                self.truth_kpa.append(read(PRESSURE_SLOT) * 1e-3)
            tick()
            if self._halted:
                break
        else:
            self._driven_us = self._fed_us = now_us
        self._noise_at, self._truth_left = at, left

    def _tick(self) -> None:
        """A step of the safety core, then the loop unless it is still busy with a request."""
        controller = self.controller
        controller.step()
        if self._loop_busy_us >= TICK_US:
            self._loop_busy_us -= TICK_US
            return
        while work := controller.loop():
            self._loop_busy_us += self.timing.busy_us(work)
            if self._loop_busy_us >= TICK_US:
                return

    def _step_halted(self) -> None:
        """One tick without firmware: pulses run out, then the board lets go, then it resets."""
        silent = self._boot_at_us is not None or self.bench_us - self._driven_us >= DRIVE_SILENCE_US
        if silent:
            self._let_go()
        self._advance(
            self.plant.state,
            self.plant.params,
            TICK_S,
            TICK_S if self.inlet_jammed else min(self._inlet_us, TICK_US) * 1e-6,
            TICK_S if self.outlet_jammed else min(self._vent_us, TICK_US) * 1e-6,
        )
        self._inlet_us = max(0, self._inlet_us - TICK_US)
        self._vent_us = max(0, self._vent_us - TICK_US)
        self.bench_us += TICK_US
        self._device_us = (self._device_us + TICK_US) & 0xFFFFFFFF
        self._sample()
        if self._truth_every:
            self._truth_left -= 1
            if not self._truth_left:
                self._truth_left = self._truth_every
                self.truth_us.append(self.bench_us)
                self.truth_kpa.append(self.pressure_kpa)
        if self._boot_at_us is None:
            if self.bench_us - self._fed_us >= WATCHDOG_US:
                self.reset("watchdog")
        elif self.bench_us >= self._boot_at_us:
            self._boot()

    def _let_go(self) -> None:
        """Unpowered outputs: the inlet is shut, the outlet goes where its spring sends it."""
        self._inlet_us = 0
        if self.outlet_normally_open:
            self._vent_us = VENT_HOLD_US
            if not self._venting:
                self._venting = True
                self.vent_commanded_us = self.bench_us
        else:
            self._vent_us = 0
            self._venting = False

    def _boot(self) -> None:
        self._boot_at_us = None
        self._halted = False
        self._fast = None
        self._device_us = 0
        self._received = b""
        self.controller = Controller(self)
        self._loop_busy_us = 0
        self._tick()

    def reset(self, cause: str = "reset", boot_us: int = BOOT_US) -> None:
        """Reset the chip now; the firmware runs again after ``boot_us``."""
        self.reset_cause = cause
        self._halted = True
        self._boot_at_us = self.bench_us + boot_us
        self._received = b""
        self.led(0)
        self.regulator(0)
        self._let_go()

    def freeze(self) -> None:
        """Hang the firmware: no tick any more, until the watchdog resets the chip or ``thaw``."""
        if not self._halted:
            self._halted = True
            self._driven_us = self._fed_us = self.bench_us

    def thaw(self) -> None:
        """The firmware goes on where it hung, unless it has been reset."""
        if self._boot_at_us is None:
            self._halted = False

    def forget_truth(self) -> None:
        """Keep no log of the true pressure from now on."""
        self._truth_every = 0

    def mean_kpa(self, first_us: int, last_us: int) -> float:
        """Mean true pressure over the log's entries in ``first_us``..``last_us`` (bench time)."""
        a = bisect_left(self.truth_us, first_us)
        b = bisect_right(self.truth_us, last_us)
        if a == b:
            raise ValueError(f"no entry of the pressure log lies in {first_us}..{last_us} us")
        return sum(self.truth_kpa[a:b]) / (b - a)

    @property
    def _counts_per_pa(self) -> float:
        return self.sensor.counts_per_kpa * (1.0 + self.sensor.gain) * 1e-3

    def _draw_noise(self) -> None:
        sensor = self.sensor
        # Half a count so that int() rounds; the errors that do not depend on pressure ride along.
        offset = sensor.nominal_counts(sensor.zero_kpa) + 0.5
        scale = sensor.noise_kpa * sensor.counts_per_kpa
        noise = self._rng.standard_normal(NOISE_BLOCK) * scale + offset
        self._noise = noise.tolist()

    def _sample(self) -> None:
        if self._noise_at >= NOISE_BLOCK:
            self._draw_noise()
            self._noise_at = 0
        value = float(self.plant.state[self.pressure_slot]) * self._counts_per_pa
        counts = int(value + self._noise[self._noise_at])
        self._noise_at += 1
        counts = min(max(counts, 0), ADC_TOP)
        self._counts = counts if self.sensor_override is None else self.sensor_override
