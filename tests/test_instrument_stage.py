"""The GRBL stage: after an injected fault it asks again, and it never believes a wrong place."""

from __future__ import annotations

from typing import Any

import pytest

from daq.errors import DeviceError, LinkLost
from instrument_desk import Desk
from rigs.devices.motion.grbl import GrblStage
from rigs.virtual.emulators.injected_fault import INJECTED_FAULTS
from rigs.virtual.emulators.motion.grbl import VirtualGrbl


def stage_of() -> tuple[Desk, GrblStage, dict[str, float]]:
    at = {"mm": 60.0, "rate": 0.0}

    def motion(length_mm: float, rate_mm_s: float) -> None:
        at.update(mm=length_mm, rate=rate_mm_s)

    def make(read: Any, send: Any) -> VirtualGrbl:
        del read
        return VirtualGrbl(motion, send, "ST-1", 60.0, 50.0, 75.0)

    desk = Desk.__new__(Desk)
    # The stage greets at power-up, so its wire must be there before it is.
    desk._end = None
    desk.plugged = False
    Desk.__init__(desk, make)
    stage = GrblStage(desk.host, desk.event_loop, 10.0)
    desk.event_loop.add(stage.poll)
    return desk, stage, at


def test_it_goes_where_it_is_sent() -> None:
    _, stage, at = stage_of()
    assert stage.connect("ST-1")["serial"] == "ST-1"
    assert stage.move(65.0) == 65.0
    assert at == {"mm": 65.0, "rate": 0.0}
    assert stage.faults.counts == {}


@pytest.mark.parametrize("fault", INJECTED_FAULTS)
@pytest.mark.parametrize("after", [1, 2, 4])
def test_a_fault_while_it_moves_does_not_leave_it_elsewhere(fault: str, after: int) -> None:
    desk, stage, at = stage_of()
    stage.connect("")
    for k in range(4):
        # The first answers of a move are a report and the "ok" that takes the command.
        desk.device.wire.arrange(*[""] * (after + 1), fault)
        target = 60.0 + (k % 2) * 5.0 + 1.0
        assert stage.move(target) == pytest.approx(target, abs=0.01)
        assert at["mm"] == pytest.approx(target)
        assert at["rate"] == 0.0


@pytest.mark.parametrize(
    "line",
    ["<Idle|MPos:60.000,0.000,0.0", "<Idle|MPos:6<Idle|MPos:60.000,0.000,0.000|FS:0,0>",
     "<Idle|MPos:60,000,0,000,0,000|FS:0,0>", "<Idle|MPos:60.00,0.000,0.000|FS:0,0>",
     "<Idle|WPos:60.000,0.000,0.000|FS:0,0>"],
)  # fmt: skip
def test_a_report_that_is_not_whole_is_none(line: str) -> None:
    _, stage, _ = stage_of()
    stage.connect("")
    assert stage.on_line(line, 0)
    assert stage.faults.total == 1


def test_a_restart_in_mid_run_is_an_error_because_the_position_is_lost() -> None:
    desk, stage, _ = stage_of()
    stage.connect("")
    desk.device.restart()
    desk.event_loop.for_seconds(0.1)
    with pytest.raises(DeviceError, match=r"it restarted \(Grbl 1.1h"):
        stage.move(65.0)
    assert stage.faults.counts["restarted"] == 1


def test_an_alarm_in_mid_move_ends_it_by_name() -> None:
    desk, stage, _ = stage_of()
    stage.connect("")

    def hit() -> None:
        if desk.clock.now_ns() > 1.5e9 and not stage._stopped:
            desk.device._halt()
            desk.device._send_line("ALARM:1")

    desk.event_loop.add(hit)
    desk.event_loop.for_seconds(1.0 - desk.clock.now_ns() * 1e-9)
    with pytest.raises(DeviceError, match="ALARM:1"):
        stage.move(50.0)


def test_a_target_beyond_its_limits_is_refused() -> None:
    _, stage, _ = stage_of()
    stage.connect("")
    with pytest.raises(DeviceError, match="error:15"):
        stage.move(90.0)


def test_decimal_commas_are_an_error_not_a_position() -> None:
    desk, stage, _ = stage_of()
    stage.connect("")
    desk.device.comma = True
    with pytest.raises(DeviceError):
        stage.move(61.0)
    assert stage.faults.counts["comma"] >= 1


def test_inches_are_an_error_not_a_position() -> None:
    """Somebody sent $13=1: reports come in inches, with four decimals."""
    desk, stage, at = stage_of()
    stage.connect("")
    desk.device.inches = True
    with pytest.raises(DeviceError, match=r"reports inches: send \$13=0"):
        stage.move(61.0)
    assert at["mm"] == 60.0
    assert stage.faults.counts["unit"] >= 1


def test_plugged_in_again_it_is_found_where_it_stands() -> None:
    desk, stage, at = stage_of()
    stage.connect("ST-1")
    stage.move(62.0)
    desk.unplug()
    with pytest.raises(LinkLost):
        stage.move(61.0)
    desk.replug()
    again = GrblStage(desk.reopen(), desk.event_loop, 10.0)
    desk.event_loop.add(again.poll)
    assert again.connect("ST-1")["serial"] == "ST-1"
    assert again.status() == ("Idle", 62.0)
    assert again.move(61.0) == 61.0
    assert at["mm"] == 61.0


def test_unplugged() -> None:
    desk, stage, _ = stage_of()
    stage.connect("")
    desk.unplug()
    with pytest.raises(LinkLost):
        stage.move(61.0)
    assert stage.faults.counts["unplugged"] == 1
