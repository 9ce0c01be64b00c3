"""The MT-SICS balance under injected faults: each counted, none of them a wrong weight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.errors import LinkLost
from instrument_desk import Desk
from rigs.devices.instruments.arrivals import Arrivals
from rigs.devices.instruments.balance import Balance
from rigs.virtual.emulators.balance import VirtualBalance

G = 9.80665


class Scales(Desk):
    """The pull grows steadily; the balance is tared at the start."""

    def truth(self, now_ns: int) -> float:
        """Grams that the balance should show."""
        return -100.0 - now_ns * 1e-9 * 2.0


def scales() -> tuple[Scales, Balance]:
    def make(read: Any, send: Any) -> VirtualBalance:
        rng = np.random.default_rng(1)
        pull = lambda: -read() * G / 1000  # noqa: E731
        return VirtualBalance(pull, send, rng, "BAL-1", G, noise_n=0.0)

    desk = Scales(make)
    desk.device._tare_g = 0.0
    balance = Balance(desk.host, desk.event_loop)
    desk.event_loop.add(balance.poll)
    desk.watch(balance, "grams")
    balance.connect("BAL-1")
    desk.event_loop.for_seconds(1.0)
    return desk, balance


def test_readings_are_right_and_nothing_is_counted() -> None:
    desk, balance = scales()
    desk.event_loop.for_seconds(5.0)
    assert len(desk.rows) == pytest.approx(59, abs=3)
    assert balance.faults.counts == {}
    assert desk.worst() < 0.001


@pytest.mark.parametrize(
    ("fault", "kinds"),
    [("half", {"damaged"}), ("double", {"stale"}), ("stale", {"stale"}), ("late", {"stale"}),
     ("garbage", {"damaged"})],
)  # fmt: skip
def test_an_injected_fault(fault: str, kinds: set[str]) -> None:
    desk, balance = scales()
    for _ in range(5):
        desk.device.wire.arrange(fault)
        desk.event_loop.for_seconds(2.0)
    assert balance.faults.total >= 5
    assert set(balance.faults.counts) <= kinds
    assert desk.worst() < 0.001
    assert set(balance.counters()) > kinds


def bunched_scales(rate_hz: float, bunch_ms: int) -> tuple[Scales, Balance]:
    """A balance of that rate behind an adapter that delivers only now and then."""
    desk, first = scales()
    desk.event_loop.remove(first.poll)
    desk.rows.clear()
    desk.device.period_ns = round(1e9 / rate_hz)
    desk.device.wire.bunch_ns = bunch_ms * 1_000_000
    balance = Balance(desk.reopen(), desk.event_loop)
    desk.event_loop.add(balance.poll)
    desk.watch(balance, "grams")
    balance.connect("BAL-1")
    return desk, balance


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize(
    ("rate_hz", "bunch_ms"), [(10, 16), (23, 16), (92, 16), (10, 50), (23, 50), (60, 50), (92, 50)]
)
def test_readings_that_an_adapter_delivers_together_stay(
    rate_hz: int, bunch_ms: int, moving: bool
) -> None:
    """At rest two readings say the same: before, both were dropped as one that was repeated."""
    desk, balance = bunched_scales(rate_hz, bunch_ms)
    if not moving:
        desk.device._force_n = lambda: 1.0
    desk.event_loop.for_seconds(2.0 + 40.0 / rate_hz)  # until the stream is known
    faults, rows = balance.faults.total, balance.rows
    desk.event_loop.for_seconds(20.0)
    assert balance.faults.total == faults
    assert balance.rows - rows == pytest.approx(20 * rate_hz, abs=5)
    if moving:  # 2 g/s: a reading is as late as its bunch, and never early
        late_s = [(desk.truth(t) - v) / -2.0 for t, v in desk.rows[-200:]]
        assert min(late_s) > -1e-3
        assert max(late_s) < bunch_ms * 1e-3 + 2e-3
    stated_ms = balance.counters().get("bunch_ms", 0)
    assert stated_ms <= 1.2 * bunch_ms + 2
    if rate_hz != 10:  # at 10 Hz the adapter is in step with the readings, or nearly so
        assert stated_ms >= 0.5 * bunch_ms


@pytest.mark.parametrize("known_before", [False, True])
def test_readings_of_one_long_hold_up_tell_no_period(known_before: bool) -> None:
    """Found by fuzzing: a hundred readings in one delivery ended in a division by zero."""
    arrivals, now_ns = Arrivals(), 0

    def comes(at_ns: int, together: bool = False) -> None:
        arrivals.heard(at_ns, together)
        arrivals.add(at_ns)

    if known_before:
        for _ in range(100):
            now_ns += 10_000_000
            comes(now_ns)
    now_ns += 1_000_000_000
    for _ in range(100):
        comes(now_ns, together=True)
    assert not arrivals.learned
    for _ in range(200):
        now_ns += 10_000_000
        comes(now_ns)
    assert arrivals.possible(now_ns + 10_000_000)
    assert not arrivals.possible(now_ns + 5_000_000)


def test_a_doubled_reading_is_found_after_lost_ones_and_pauses() -> None:
    desk, balance = scales()
    desk.event_loop.for_seconds(8.0)
    for fault in ("drop", "double", "late", "double", "drop", "drop", "stale"):
        before = balance.faults.total
        desk.device.wire.arrange(fault)
        desk.event_loop.for_seconds(3.0)
        assert fault == "drop" or balance.faults.total > before, fault
    assert desk.worst() < 0.001
    assert "bunch_ms" not in balance.counters()


@pytest.mark.parametrize(
    "line",
    ["S S   -123.45 g", "S S    -123.4566 g", "S S     -12.345 kg", "S S    -123,456 g",
     "S S S S    -123.456 g", "S S    -123.456", "S S    --23.456 g"],
)  # fmt: skip
def test_a_line_that_is_not_as_the_standard_has_it_is_no_reading(line: str) -> None:
    desk, balance = scales()
    rows = balance.rows
    balance.on_line(line, 0)
    balance._release()
    assert balance.rows <= rows + 1  # one was held already
    assert balance.faults.total == 1
    desk.event_loop.for_seconds(0.1)


@pytest.mark.parametrize(
    ("change", "kind"),
    [({"unit": "oz"}, "unit"), ({"comma": True}, "comma"), ({"flag": "overload"}, "overload"),
     ({"flag": "underload"}, "underload")],
)  # fmt: skip
def test_keypad_and_flags(change: dict[str, object], kind: str) -> None:
    desk, balance = scales()
    for key, value in change.items():
        setattr(desk.device, key, value)
    rows = balance.rows
    desk.event_loop.for_seconds(2.0)
    assert balance.rows <= rows + 1
    assert balance.faults.counts[kind] >= 18
    assert desk.worst() < 0.001


def test_unplugged_it_says_so_once_and_the_bench_goes_on() -> None:
    desk, balance = scales()
    desk.unplug()
    with pytest.raises(LinkLost):
        desk.event_loop.for_seconds(1.0)
    desk.event_loop.for_seconds(1.0)
    assert balance.faults.counts["unplugged"] == 1
    desk.replug()
    again = Balance(desk.reopen(), desk.event_loop)
    desk.event_loop.add(again.poll)
    assert again.connect("BAL-1")["serial"] == "BAL-1"
    desk.event_loop.for_seconds(1.0)
    assert again.rows >= 8
