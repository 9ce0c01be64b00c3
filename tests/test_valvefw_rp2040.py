"""The RP2040's board file on pins made of Python: what the PIO programs put out, to 1 us."""

from __future__ import annotations

from typing import Any

import pytest

import rp2040_pins
from rp2040_pins import StateMachine
from valvefw.board import DRIVE_SILENCE_US
from valvefw.config import defaults
from valvefw.controller import Controller
from valvefw.core import (
    ARMED,
    COUNTS,
    HEARTBEAT_LEFT,
    LOOP_LEFT,
    PROX,
    RENEWS,
    REQUEST_INLET,
    REQUEST_VENT,
    REQUESTED,
    RUNNING,
    WANT_INLET,
    WANT_VENT,
)
from valvefw.safety import Safety
from valvefw.schemes.valves import VENT_HOLD_US
from valvefw.wire import TICK_US


class Pico:
    """The board and its two coils."""

    def __init__(self, normally_open: bool = True) -> None:
        self.module, self.machine = rp2040_pins.load()
        self.module.OUTLET_NORMALLY_OPEN = normally_open  # type: ignore[attr-defined]
        self.module._SETUP[4] = normally_open  # type: ignore[attr-defined]
        self.board: Any = self.module.Pico(self.module.chip)
        self.core = self.module._core
        values = defaults()
        values.update(stuck_ms=0, rise_ms=0, leak_counts=0, jump=4095)
        self.safety = Safety(self.core, values)
        self.inlet, self.outlet = StateMachine.made
        self.normally_open = normally_open

    def run_us(self, us: float) -> None:
        self.inlet.run_us(us)
        self.outlet.run_us(us)
        timer = rp2040_pins.Registers.TIMER
        self.machine.mem32[timer] = (self.machine.mem32[timer] + round(us)) & 0xFFFFFFFF

    def tick(self, inlet_us: int, vent_us: int) -> None:
        """One interrupt with a request of an armed scheme, whose inlet may stay open."""
        s = self.core.state
        s[ARMED] = s[RUNNING] = s[RENEWS] = 1
        s[REQUESTED] = REQUEST_INLET | REQUEST_VENT
        s[HEARTBEAT_LEFT] = s[LOOP_LEFT] = 10**6
        s[WANT_INLET], s[WANT_VENT] = inlet_us, vent_us
        self.module._interrupt(None)
        assert self.safety.faults == []
        self.run_us(1000)

    @property
    def venting(self) -> bool:
        return bool(self.outlet.pin) != self.normally_open


@pytest.mark.parametrize("width_us", [5, 995, 1000, 2345, 11_020, 19_995])
def test_a_pulse_is_as_long_as_told_to_a_microsecond(width_us: int) -> None:
    pico = Pico()
    pico.run_us(100)
    left = width_us
    for _ in range(30):  # the controller tells anew every tick what is left
        pico.tick(max(0, left), 0)
        left -= 1000
    (up, one), (down, zero) = pico.inlet.edges
    assert (one, zero) == (1, 0)
    assert down - up == pytest.approx(width_us, abs=1.0)
    assert up < 103.0


def test_an_open_valve_goes_on_without_an_edge() -> None:
    pico = Pico()
    for _ in range(50):
        pico.tick(2000, 0)
    assert [level for _, level in pico.inlet.edges] == [1]


@pytest.mark.parametrize("normally_open", [True, False])
@pytest.mark.parametrize("width_us", [300, 1000, 12_345])
def test_a_vent_pulse_is_timed_at_either_kind_of_outlet(normally_open: bool, width_us: int) -> None:
    pico = Pico(normally_open)
    for _ in range(5):
        pico.tick(0, 0)
    assert not pico.venting
    before = len(pico.outlet.edges)
    left = width_us
    for _ in range(30):
        pico.tick(0, max(0, left))
        left -= 1000
    (begin, _), (end, _) = pico.outlet.edges[before:]
    assert end - begin == pytest.approx(width_us, abs=2.0)
    assert not pico.venting


def test_without_calls_both_coils_let_go_after_20_ms() -> None:
    pico = Pico()
    pico.tick(1_000_000, 0)
    assert pico.inlet.pin == 1
    assert not pico.venting
    pico.run_us(DRIVE_SILENCE_US - 1000 - 10)
    assert pico.inlet.pin == 1
    pico.run_us(30)
    assert pico.inlet.pin == 0
    assert pico.venting  # by its spring


def test_venting_is_no_current_at_a_normally_open_outlet() -> None:
    pico = Pico()
    pico.tick(0, 0)
    pico.tick(0, VENT_HOLD_US)
    assert (pico.inlet.pin, pico.outlet.pin) == (0, 0)


def test_reset_leaves_the_coils_without_current() -> None:
    pico = Pico()
    pico.run_us(5000)
    assert pico.inlet.edges == pico.outlet.edges == []


def test_the_controller_runs_on_it_vented_and_feeds_the_watchdog() -> None:
    pico = Pico()
    controller = Controller(pico.board, pico.core)
    for _ in range(200):
        pico.module._interrupt(None)
        while controller.loop():
            pass
        pico.run_us(TICK_US)
    assert pico.inlet.edges == []
    assert pico.venting
    assert len(pico.board._watchdog.told) == 200
    assert pico.core.state[COUNTS] == 0x123
    assert pico.core.state[PROX] == 0
    assert pico.board.serial == "e6610102"
    assert pico.board.reset_cause == "watchdog"
    assert any(b"boot id=" in sent for sent in pico.board._uart.told)


def test_a_loop_that_hangs_does_not_feed_the_watchdog_and_is_vented() -> None:
    pico = Pico()
    controller = Controller(pico.board, pico.core)
    controller.values["stuck_ms"] = 0
    pico.module._interrupt(None)
    pico.run_us(TICK_US)
    controller.safety.arm(controller.values)
    controller.choose("open")
    for _ in range(40):
        pico.module._interrupt(None)
        pico.run_us(TICK_US)
    assert not pico.venting
    assert controller.safety.armed
    for _ in range(11):
        pico.module._interrupt(None)
        pico.run_us(TICK_US)
    assert pico.venting
    assert [cause for cause, _ in controller.safety.faults] == ["loop_stalled"]
    assert pico.board._watchdog is None


def test_an_interrupt_that_stops_starves_the_watchdog() -> None:
    pico = Pico()
    controller = Controller(pico.board, pico.core)
    pico.module._interrupt(None)
    for _ in range(500):
        controller.loop()
    assert len(pico.board._watchdog.told) == 1


def test_run_starts_a_hard_timer_of_1_khz_and_stops_it_when_interrupted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module, machine = rp2040_pins.load()
    pico: Any = module
    fake: Any = machine
    timers: list[Any] = []

    class Timer(rp2040_pins.Fake):
        PERIODIC = 1

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            timers.append(self)

    def idle() -> None:
        raise KeyboardInterrupt

    fake.Timer, fake.idle = Timer, idle
    fake.freq = lambda *hz: 125_000_000
    with pytest.raises(KeyboardInterrupt):
        pico.run(pico.chip)
    (timer,) = timers
    assert timer.options["freq"] == 1000
    assert timer.options["hard"]
    assert timer.told == ["off"]
    assert [sm.fifo[-1] for sm in StateMachine.made] == [0, 0]


def test_an_older_micropython_is_refused_at_boot(monkeypatch: pytest.MonkeyPatch) -> None:
    module: Any = rp2040_pins.load()[0]
    module.MICROPYTHON = (99, 0)
    with pytest.raises(RuntimeError, match=r"needs MicroPython 99\.0"):
        module.run(module.chip)


def test_what_the_uart_cannot_hold_is_dropped_whole() -> None:
    pico = Pico()
    frame = bytes(100)
    for _ in range(100):
        pico.board.tx(frame, 100)
    kept = len(pico.board._uart.told)
    assert kept == (pico.module.TX_BYTES - 64) // 100
    assert all(len(sent) == 100 for sent in pico.board._uart.told)
    pico.run_us(100_000)  # 115200 baud: 1152 bytes
    for _ in range(100):
        pico.board.tx(frame, 100)
    assert len(pico.board._uart.told) - kept == pytest.approx(11.5, abs=1)
