"""The thesis's schemes against its flow charts and listings (5.7, 5.9, Appendix D-3).

Errors here are in 10-bit counts, as in the thesis; one of them is four counts of the board.
"""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigs.virtual.board.as_printed import (
    LOOP_US,
    BothDutyAsPrinted,
    InletDutyAsPrinted,
    RamAsPrinted,
    RamOvercomeAsPrinted,
    SlidingAsPrinted,
    TwoPositionAsPrinted,
    adc_as_printed,
    install_as_printed,
    int16,
    print_us,
)
from test_valvefw_pwm import Held
from test_valvefw_safety import thesis
from valvefw.config import defaults
from valvefw.schemes.bothduty import BothDuty
from valvefw.schemes.gas import Gas
from valvefw.schemes.inletduty import InletDuty
from valvefw.schemes.ram import Ram
from valvefw.schemes.scheme import Scheme
from valvefw.schemes.sliding import Sliding
from valvefw.schemes.twoposition import TwoPosition
from valvefw.schemes.valves import Valves

SP = 600  # 10-bit


class Desk:
    """A scheme with a reading one may set; pulses run down as the controller does it."""

    def __init__(self, scheme: Scheme, **changes: int) -> None:
        self.scheme = scheme
        self.valves = Valves()
        scheme.start({**defaults(), **changes})

    def tick(self, error: int, setpoint: int = SP) -> tuple[int, int]:
        v = self.valves
        v.inlet_us = max(0, v.inlet_us - 1000)
        v.vent_us = max(0, v.vent_us - 1000)
        self.scheme.step((setpoint - error) << 2, setpoint << 6, 1000, v)
        return v.inlet_us, v.vent_us

    def state(self, error: int) -> str:
        inlet_us, vent_us = self.tick(error)
        assert not (inlet_us and vent_us)
        return "fill" if inlet_us else "vent" if vent_us else "hold"

    def train(self, error: int, ms: int = 2000) -> list[tuple[int, str, int]]:
        """(start in ms, valve, length in us) of every pulse at a standing error."""
        out, before = [], (0, 0)
        for k in range(ms):
            now = self.tick(error)
            for which, name in ((0, "inlet"), (1, "outlet")):
                if now[which] > max(0, before[which] - 1000):
                    out.append((k, name, now[which]))
            before = now
        return out


@pytest.mark.parametrize(
    ("error", "state"),
    [(600, "fill"), (6, "fill"), (5, "hold"), (0, "hold"), (-5, "hold"), (-6, "vent")],
)
def test_two_position_switches_at_the_edges_of_the_gap(error: int, state: str) -> None:
    assert Desk(TwoPosition()).state(error) == state
    assert Desk(TwoPosition(), two_dead=700).state(error) == "hold"


@pytest.mark.parametrize(
    ("error", "on"),
    [(3, 0), (7, 1), (70, 10), (350, 50), (600, 85), (699, 99)],
)
def test_inlet_pulse_is_a_hundred_seven_hundredths_of_the_error_in_a_period_of_101(
    error: int, on: int
) -> None:
    pulses = Desk(InletDuty()).train(error, 1000)
    assert [p[2] for p in pulses] == [on * 1000] * (10 if on else 0)
    assert all(b[0] - a[0] == 101 for a, b in itertools.pairwise(pulses))


@pytest.mark.parametrize("scheme", [InletDuty, BothDuty])
@pytest.mark.parametrize("error", [2, 1, 0, -1, -2])
def test_nothing_moves_in_the_dead_zone_of_2(scheme: type[InletDuty], error: int) -> None:
    assert Desk(scheme()).train(error) == []


@pytest.mark.parametrize("error", [700, 900])
def test_the_pulse_saturates_at_the_whole_period_and_one_unit_off(error: int) -> None:
    desk = Desk(BothDuty())
    inlet = [min(1000, desk.tick(error, 1000)[0]) for _ in range(306)]
    assert inlet[:102] == [1000] * 101 + [0]
    assert inlet == inlet[:102] * 3
    desk = Desk(BothDuty())
    vent = [min(1000, desk.tick(-error, 20)[1]) for _ in range(306)]
    assert vent == inlet


def test_inlet_only_vents_from_reading_to_reading() -> None:
    desk = Desk(InletDuty())
    assert [desk.state(-3) for _ in range(50)] == ["vent"] * 50
    assert desk.state(-2) == "hold"
    assert desk.state(400) == "fill"
    assert desk.tick(-600) == (56000, 0)  # not before the pass is over


@pytest.mark.parametrize("error", [7, 70, 350, 699])
def test_the_outlet_of_the_hybrid_follows_the_same_rule(error: int) -> None:
    up, down = Desk(BothDuty()).train(error), Desk(BothDuty()).train(-error)
    assert [(t, us) for t, _, us in up] == [(t, us) for t, _, us in down]
    assert {name for _, name, _ in up} == {"inlet"}
    assert {name for _, name, _ in down} == {"outlet"}


@pytest.mark.parametrize(
    ("error", "rise", "state"),
    [
        (100, 0, "fill"),
        (100, 9, "fill"),  # 45 counts per 100 ms
        (100, 10, "vent"),  # 50: on the boundary
        (100, -50, "fill"),
        (6, 0, "fill"),
        (5, 0, "hold"),
        (-5, 0, "hold"),
        (0, 10, "vent"),
        (-6, 0, "vent"),
        (-100, -50, "vent"),
    ],
)
def test_sliding_mode_fills_below_the_boundary_of_50_and_vents_above(
    error: int, rise: int, state: str
) -> None:
    desk = Desk(Sliding(), slide_ms=20)
    desk.tick(error + rise)
    for _ in range(19):
        desk.tick(error)
    assert desk.state(error) == state


def test_the_first_pass_of_sliding_mode_has_no_rate() -> None:
    assert Desk(Sliding()).state(600) == "fill"


def test_the_ram_stops_at_a_switch_and_can_leave_it() -> None:
    desk = Desk(Ram())
    v = desk.valves
    assert [desk.state(e) for e in (600, 6, 5, -5, -6)] == ["fill", "fill", "hold", "hold", "vent"]
    for switch in (1, 2, 3):
        v.prox = switch
        assert desk.state(600) == desk.state(-600) == "hold"
        v.prox = 0
        assert desk.state(600) == "fill"
    v.prox = 1
    desk.tick(600)
    assert desk.tick(-300, 200)[1] > 0  # told to go back while on switch A
    v.prox = 0
    desk.tick(-300, 200)
    v.prox = 1
    assert desk.tick(-300, 200) == (0, 0)
    v.prox = 3  # on A when told to go, then B comes
    desk.tick(0, 201)
    v.prox = 1
    desk.tick(300, 600)
    v.prox = 3
    assert desk.tick(300, 600) == (0, 0)


@pytest.mark.parametrize("scheme", [TwoPosition, InletDuty, BothDuty, Sliding])
@given(errors=st.lists(st.integers(-423, 600), min_size=1, max_size=60))
def test_no_scheme_of_the_thesis_opens_both_valves(scheme: type[Scheme], errors: list[int]) -> None:
    desk = Desk(scheme(), duty_unit_us=40, slide_ms=3)
    for error in errors:
        desk.state(error)


# As printed.


def test_the_printed_reading_jumps_back_at_every_fourth_count() -> None:
    assert [adc_as_printed(n) for n in range(9)] == [0, 2, 4, 6, 4, 6, 8, 10, 8]
    assert int16(40000) == -25536


def printed_train(scheme: Scheme, error: int, ms: int = 400) -> list[tuple[int, str, int]]:
    return Desk(scheme).train(error, ms)


def test_a_printed_scheme_acts_after_the_prints_between_its_reading_and_its_port() -> None:
    """4800 baud: "", "", "300", " 600", " 300" with their line ends are 21 characters, 43.75 ms."""
    assert print_us() * 2 + sum(print_us(w) for w in ("300", " 600", " 300")) == 43_748
    for twin, error in ((TwoPositionAsPrinted, 300), (InletDutyAsPrinted, 300)):
        assert printed_train(twin(), error)[0][0] == 44
    assert printed_train(SlidingAsPrinted(), 0, 1000) == []
    first = printed_train(SlidingAsPrinted(), 300, 1000)[0][0]
    assert first > 200  # nine lines more, before its ports


def test_a_printed_valve_acts_on_a_reading_that_is_a_print_old() -> None:
    """The reading changes while its difference is printed: the port still follows the old one."""
    desk = Desk(TwoPositionAsPrinted())
    for _ in range(12):
        assert desk.state(300) == "hold"
    passed = 12
    while desk.state(-300) == "hold":
        passed += 1
    assert passed == 44
    held = 1
    while desk.state(-300) == "fill":
        held += 1
    assert 31 <= held <= 38


def test_the_printed_burst_depends_on_its_print_and_not_on_the_error() -> None:
    def burst(scheme: Scheme, error: int) -> int:
        return printed_train(scheme, error)[0][2]

    intended = [Desk(InletDuty()).tick(e)[0] for e in (100, 200, 300)]
    printed = [burst(InletDutyAsPrinted(), e) for e in (100, 200, 300)]
    assert intended == [14000, 28000, 42000]
    assert len(set(printed)) == 1
    assert 10_870 < printed[0] < 15_000  # one smallest opening of the thesis's valve
    assert burst(InletDutyAsPrinted(baud=9600), 300) < 10_870  # a faster line: it never opens


def test_the_printed_product_overflows_beyond_an_error_of_327() -> None:
    # -36 is one character longer than 46: all that is left of a gain.
    small, large = (printed_train(InletDutyAsPrinted(), e)[0][2] for e in (300, 400))
    assert large - small == print_us("on", -36) - print_us("on", 42)
    assert InletDuty.on_units(Desk(InletDuty()).scheme, 400) == 57  # type: ignore[arg-type]


def test_the_printed_hybrid_reads_once_and_never_again() -> None:
    desk = Desk(BothDutyAsPrinted())
    assert len(desk.train(300, 300)) == 1
    assert [desk.tick(e) for e in (600, -300, 300)] == [(0, 0)] * 3
    assert desk.scheme.passes == 1  # type: ignore[attr-defined]


def test_the_printed_outlet_opens_only_where_its_loop_has_no_turn() -> None:
    """Then it is open while "outlet" is printed, again and again."""
    assert {us for _, _, us in printed_train(BothDutyAsPrinted(), -300)} == {LOOP_US}
    for error in (-4, -5, -400):  # -400 DIV 700 is 0; -40000 is 25536 in 16 bits
        pulses = printed_train(BothDutyAsPrinted(), error, 1000)
        assert {(name, us) for _, name, us in pulses} == {("outlet", print_us("outlet"))}
        assert len(pulses) > 40
    assert printed_train(BothDutyAsPrinted(), -1) == []


def test_printed_sliding_mode_never_brakes_a_fast_rise_and_overflows() -> None:
    desk = Desk(SlidingAsPrinted())
    for _ in range(900):
        desk.tick(300)
    while desk.scheme.difference != 100:  # type: ignore[attr-defined]
        desk.tick(100)
    for _ in range(220):  # the pass in which the error has fallen from 300 to 100
        desk.tick(100)
    assert desk.state(100) == "fill"
    # 100000 is 34464 in 16 bits, minus 31072 as an integer: a rate with the wrong sign.
    assert int16(100000 * 1) == -31072
    # From rest the error itself counts as a rate; that of the first pass may open the outlet.
    assert math.copysign(1, int16(100000 * 300)) == -1


def test_printed_two_position_is_as_slow_as_its_prints() -> None:
    desk = Desk(TwoPositionAsPrinted())
    while desk.state(600) != "fill":
        pass
    waited = 0
    while desk.state(-100) == "fill":
        waited += 1
    assert 31 <= waited <= 76  # one pass begun before, and one with the new reading


def test_the_printed_ram_never_sees_its_switch_because_it_clears_the_pins() -> None:
    """Version 7 writes 0 to p1.0 and p1.1 in each pass; such a pin reads 0."""
    desk = Desk(RamAsPrinted())
    desk.valves.prox = 3
    states = [desk.state(300) for _ in range(400)]
    assert set(states[50:]) == {"fill"}


def test_the_printed_ram_cannot_leave_a_switch_that_overcomes_the_pin() -> None:
    def states(scheme: Scheme) -> str:
        desk = Desk(scheme)
        for _ in range(100):
            desk.tick(300)
        desk.valves.prox = 1
        for _ in range(100):
            desk.tick(300)
        stopped = desk.tick(300)
        assert stopped == (0, 0)
        for _ in range(100):  # told to go back
            desk.tick(-300, 200)
        return desk.state(-300) if desk.tick(-300, 200) != (0, 0) else "hold"

    assert states(RamOvercomeAsPrinted()) == "hold"
    assert states(Ram()) != "hold"


def test_the_printed_ram_overruns_its_switch_by_a_pass() -> None:
    """The intended one shuts at the next tick; this one first finishes its prints."""

    def after_switch(scheme: Scheme) -> int:
        desk = Desk(scheme)
        for _ in range(100):
            desk.tick(300)
        desk.valves.prox = 1
        ticks = 0
        while desk.tick(300) != (0, 0):
            ticks += 1
        return ticks

    assert after_switch(Ram()) == 0
    assert 23 <= after_switch(RamOvercomeAsPrinted()) <= 100


def test_on_the_thesis_bench_neither_code_settles_but_the_orifice_is_enough() -> None:
    """One smallest fill moves a fifth of supply: also the intended code swings by 10 % or more."""
    swing = {}
    for name in ("two", "two_as_printed", "duty_in_as_printed"):
        bench = Held(thesis(), 60.0)
        install_as_printed(bench.board)
        bench.arm(name)
        t, p = bench.step(300.0, 3.0)
        tail = p[t > 1.5]
        swing[name] = (tail.max() - tail.min()) / 550 * 100
    assert swing["two"] > 10
    assert swing["two_as_printed"] > 85  # 65 if it acted before its prints


# The model behind the bursts.


@given(st.integers(0, 2200), st.integers(0, 30000))
def test_the_integer_gas_model_agrees_with_iso_6358(gauge: int, open_us: int) -> None:
    """Against a fine float integration, to 0.4 % of supply over 30 ms of the thesis's orifice."""
    gas = Gas()
    gas.load({"gas_atm": 415, "gas_supply": 2252, "gas_rate_in": 19636, "gas_rate_out": 19636})
    supply, atm, rate = 2667.0, 415.0, 19636e-9

    def factor(ratio: float) -> float:
        return 1.0 if ratio <= 0.5 else math.sqrt(max(0.0, 1.0 - (2.0 * ratio - 1.0) ** 2))

    fill = vent = gauge + atm
    for _ in range(200):
        dt = open_us / 200
        fill += dt * rate * supply * factor(min(1.0, fill / supply))
        vent -= dt * rate * vent * factor(min(1.0, atm / vent))
    p = round((gauge + atm) * 256)
    assert gas.after_fill(p, open_us) / 256 == pytest.approx(fill, abs=10)
    assert gas.after_vent(p, open_us) / 256 == pytest.approx(vent, abs=10)
