"""Stages of other makers: bytes as their makers print them, and never a wrong position."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench_process import BUSY
from daq.errors import ConfigError, DeviceError, LinkLost
from instrument_desk import Desk
from protocol_runs import run_short
from rigs.bench.doctor import examine
from rigs.bench.rig import open_rig
from rigs.devices.motion.stage import MotorStage
from rigs.devices.motion.tmcl import Reply, decode, encode
from rigs.devices.motion.zaber import checksum
from rigs.rigfile.config import load_rig
from rigs.rigfile.tables.stage import StageDevice, stage_module
from rigs.virtual.emulators.injected_fault import INJECTED_FAULTS
from rigs.virtual.server import open_server

KINDS = ("marlin", "zaber", "tmcl")


class OnDesk:
    """A stage of a kind with its emulator; ``at`` is where the emulated carriage truly is."""

    def __init__(self, kind: str) -> None:
        self.device = load_rig(f"virtual-{kind}").stage
        self.at = {"mm": 60.0, "rate": 0.0}
        self.sent: list[bytes] = []
        self.desk = Desk(lambda read, send: self._emulator(send))
        feed = self.desk.device.feed
        self.desk.device.feed = lambda data: (self.sent.append(data), feed(data))[1]
        self.stage = self.open()

    def _emulator(self, send: Any) -> Any:
        module = stage_module(self.device.kind, "rigs.virtual.emulators.motion")
        return module.emulator(self.device, (50.0, 75.0), 60.0, self._motion, send)

    def _motion(self, length_mm: float, rate_mm_s: float) -> None:
        self.at = {"mm": length_mm, "rate": rate_mm_s}

    def open(self) -> MotorStage:
        module = stage_module(self.device.kind, "rigs.devices.motion")
        stage: MotorStage = module.open_stage(self.desk.host, self.desk.event_loop, self.device)
        self.desk.event_loop.add(stage.poll)
        return stage

    def after(self, seconds: float, what: Any) -> None:
        """Do something once, so long from now."""
        due_ns = self.desk.clock.now_ns() + round(seconds * 1e9)
        done: list[bool] = []

        def look() -> None:
            if not done and self.desk.clock.now_ns() >= due_ns:
                done.append(True)
                what()

        self.desk.event_loop.add(look)


@pytest.fixture(params=KINDS)
def on(request: pytest.FixtureRequest) -> OnDesk:
    return OnDesk(request.param)


def test_it_goes_where_it_is_sent(on: OnDesk) -> None:
    assert on.stage.connect(on.device.serial)["serial"] == on.device.serial
    assert on.stage.move(65.0) == pytest.approx(65.0, abs=0.01)
    assert on.at["mm"] == pytest.approx(65.0, abs=0.0065)
    assert on.at["rate"] == 0.0
    assert on.stage.faults.counts == {}
    assert not on.stage.midway


def test_it_looks_on_while_it_moves(on: OnDesk) -> None:
    on.stage.connect("")
    seen: list[float] = []
    on.stage.move(65.0, speed_mm_s=2.0, meanwhile=lambda: seen.append(on.at["rate"]))
    assert sum(abs(rate) == pytest.approx(2.0, rel=1e-3) for rate in seen) > 10


def test_another_one_is_refused_by_its_number(on: OnDesk) -> None:
    with pytest.raises(DeviceError, match=r"stage\.serial: expected X-9, got "):
        on.stage.connect("X-9")


@pytest.mark.parametrize("fault", INJECTED_FAULTS)
@pytest.mark.parametrize("after", [0, 1, 2, 3, 5])
def test_a_fault_while_it_moves_does_not_leave_it_elsewhere(
    on: OnDesk, fault: str, after: int
) -> None:
    on.stage.connect("")
    for k in range(3):
        on.desk.device.wire.arrange(*[""] * after, fault)
        target = 60.0 + (k % 2) * 3.0 + 0.5
        assert on.stage.move(target) == pytest.approx(target, abs=0.013)
        assert on.at["mm"] == pytest.approx(target, abs=0.0065)
        assert on.at["rate"] == 0.0
    assert len(on.desk.device.wire.done) == 3


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    faults=st.lists(st.sampled_from(["", "", "", *INJECTED_FAULTS]), min_size=4, max_size=30),
)
def test_under_any_faults_it_arrives_or_says_that_it_did_not(kind: str, faults: list[str]) -> None:
    on = OnDesk(kind)
    on.stage.connect("")
    on.desk.device.wire.arrange(*faults)
    for target in (61.0, 60.0):
        try:
            found = on.stage.move(target)
        except DeviceError:
            return
        assert found == pytest.approx(target, abs=0.013)
        assert on.at["mm"] == pytest.approx(target, abs=0.0065)
        assert on.at["rate"] == 0.0


def test_a_restart_is_an_error_because_the_position_is_lost(on: OnDesk) -> None:
    on.stage.connect("")
    on.desk.device.restart()
    on.desk.event_loop.for_seconds(0.1)
    with pytest.raises(DeviceError, match=r"it restarted|no reference position"):
        on.stage.move(65.0)
    assert on.at["mm"] == 60.0
    assert sum(on.stage.faults.counts.values()) == 1


def test_an_obstacle_ends_the_move_by_name(on: OnDesk) -> None:
    on.stage.connect("")
    stop = "hit" if on.device.kind == "marlin" else "stall"
    on.after(0.3, lambda: getattr(on.desk.device, stop)())
    with pytest.raises(DeviceError, match=r"endstops hit:  X:6|stalled|was sent to 70.000 mm, is"):
        on.stage.move(70.0)
    assert 60.5 < on.at["mm"] < 66.0


def test_a_target_beyond_its_limits_is_not_believed(on: OnDesk) -> None:
    on.stage.connect("")
    with pytest.raises(DeviceError, match=r"BADDATA|was sent to 78\.000 mm, is at 75\.0"):
        on.stage.move(78.0)


def test_unplugged_and_plugged_in_again(on: OnDesk) -> None:
    on.stage.connect("")
    on.stage.move(62.0)
    on.desk.unplug()
    with pytest.raises(LinkLost):
        on.stage.move(61.0)
    assert on.stage.faults.counts["unplugged"] == 1
    on.desk.replug()
    on.desk.reopen()
    again = on.open()
    assert again.connect(on.device.serial)["serial"] == on.device.serial
    assert again.status()[1] == pytest.approx(62.0, abs=0.01)


def test_half_a_message_at_the_end_is_counted(on: OnDesk) -> None:
    on.stage.connect("")
    on.desk.device._now_ns = on.desk.clock.now_ns()
    half = {"marlin": b"X:60.0", "zaber": b"@01 1 0", "tmcl": b"\x02\x01\x64"}
    on.desk._send(half[on.device.kind])
    on.desk.event_loop.for_seconds(0.1)
    assert on.stage.midway
    on.stage.finish()
    assert on.stage.counters()["half"] == 1


# Bytes as the makers print them.


def test_the_bytes_of_marlin() -> None:
    on = OnDesk("marlin")
    on.stage._number = 3  # type: ignore[attr-defined]
    on.stage._send("T0")  # type: ignore[attr-defined]
    on.desk.event_loop.for_seconds(0.1)
    assert on.sent == [b"N3 T0*57\n"]  # RepRap wiki, "Checking"
    on.sent.clear()
    on.stage.connect("")
    on.sent.clear()
    on.stage.move(61.0)
    text = b"".join(on.sent).decode()
    assert [line.split("*")[0].split(" ", 1)[1] for line in text.splitlines()][:4] == [
        "M114", "G1 X61.000 F600", "M400", "M114",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "line",
    ["X:60.00 Y:0.00 Z:0.00 E:0.00 Count X:48", "X:60.00 Y:0.00 ZX:60.00 Y:0.00 Z:0.00 E:0.00",
     "X:60,00 Y:0,00 Z:0,00 E:0,00 Count X:4800 Y:0 Z:0", "X:60.0"],
)  # fmt: skip
def test_a_report_of_marlin_that_is_not_whole_is_none(line: str) -> None:
    on = OnDesk("marlin")
    on.stage.connect("")
    assert on.stage.on_line(line, 0)  # type: ignore[attr-defined]
    assert on.stage.faults.total == 1


def test_marlin_that_waits_at_each_report_is_driven_as_well() -> None:
    on = OnDesk("marlin")
    on.desk.device.waits = True
    on.stage.connect("")
    assert on.stage.move(70.0, speed_mm_s=1.0) == pytest.approx(70.0)
    assert on.stage.faults.counts == {}


def test_a_digit_changed_in_the_planned_position_is_not_believed() -> None:
    on = OnDesk("marlin")
    on.stage.connect("")
    say = on.desk.device._say
    lies = [True]

    def changed(line: str) -> None:
        say(line.replace("X:61.00", "X:67.00", 1) if lies and line.startswith("X:61") else line)

    on.desk.device._say = changed
    on.after(3.0, lies.clear)
    assert on.stage.move(61.0) == pytest.approx(61.0)
    assert on.desk.clock.now_ns() > 3.0e9


def test_the_bytes_of_zaber() -> None:
    assert checksum("@01 0 OK IDLE -- 0") == "8D"  # Zaber's own library's test
    on = OnDesk("zaber")
    on.stage.connect("")
    on.sent.clear()
    on.stage.status()
    (line,) = on.sent
    assert line.startswith(b"/01 1 06 get pos:")
    assert line.endswith(b"\n")
    assert (sum(line[1:-4]) + int(line[-3:-1], 16)) % 256 == 0


@pytest.mark.parametrize("flag", ["WR", "WH", "FS", "FD", "FZ"])
def test_a_zaber_stage_that_lost_its_place_is_refused(flag: str) -> None:
    on = OnDesk("zaber")
    on.desk.device.flags = [flag]
    with pytest.raises(DeviceError, match=rf"\(flag {flag}\)"):
        on.stage.connect("")


def test_other_devices_of_the_chain_and_alerts_are_left_alone() -> None:
    on = OnDesk("zaber")
    on.stage.connect("")
    for line in ("@02 1 05 OK IDLE -- 7", "!01 1 IDLE --", "#01 0 hello"):
        assert on.stage.on_line(  # type: ignore[attr-defined]
            f"{line}:{checksum(line)}" if line[0] == "@" else line, 0
        )
    assert on.stage.faults.counts == {}


def test_the_bytes_of_tmcl() -> None:
    # TMCM-1211 firmware manual: CALCV SUB, 27, 5000; PD-113-57 manual: reply to GAP 0, 1.
    assert encode(1, 0x2D, 1, 0x1B, 5000) == bytes.fromhex("01 2d 01 1b 00 00 13 88 e5")
    assert decode(bytes.fromhex("02 01 64 06 00 00 02 c7 36"), 1) == Reply(100, 6, 711)
    on = OnDesk("tmcl")
    on.stage.connect("")
    on.sent.clear()
    on.stage.move(60.0)
    assert bytes.fromhex("01 06 01 00 00 00 00 00 08") in on.sent  # GAP 1, motor 0
    assert bytes.fromhex("01 04 00 00 00 03 e8 00 f0") in on.sent  # MVP ABS, 256000


@given(st.binary(min_size=9, max_size=9))
def test_nine_bytes_are_a_reply_only_with_their_sum(data: bytes) -> None:
    reply = decode(data, 1)
    assert reply is None or (data[8] == sum(data[:8]) % 256 and data[1] == 1)


@given(
    command=st.sampled_from([4, 5, 6, 9, 10, 136]),
    value=st.integers(-(2**31), 2**31 - 1),
    junk=st.binary(max_size=20),
    at=st.integers(0, 8),
)
def test_replies_are_found_after_anything(command: int, value: int, junk: bytes, at: int) -> None:
    on = OnDesk("tmcl")
    head = bytes([2, 1, 100, command]) + value.to_bytes(4, "big", signed=True)
    reply = head + bytes([sum(head) % 256])
    stage: Any = on.stage
    stage._take(junk)
    stage._replies.clear()
    stage._take(reply[:at])
    for _ in range(3):
        stage._take(reply[at:] + reply[:at])
    assert Reply(100, command, value) in stage._replies


# On the bench.


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [("counts_per_mm = -20997.375", "counts_per_mm = 10", "too coarse"),
     ('kind = "zaber"', 'kind = "thorlabs"', "grbl"), ("address = 1 ", "address = 100 ", "address"),
     ('kind = "zaber"', 'kind = "grbl"', "unknown"), ("zero_mm = 80.0", "", "zero_mm")],
)  # fmt: skip
def test_a_table_that_cannot_work_is_refused(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    text = load_rig("virtual-zaber").text
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=words):
        load_rig(str(path))


def test_counts_and_lengths_are_each_others_inverse() -> None:
    stage = StageDevice("p", 9600, "", 1.0, "zaber", counts_per_mm=-20997.375, zero_mm=80.0)
    assert stage.counts(60.0) == 419948  # 20 mm from home, on a nearest microstep
    assert stage.length_mm(stage.counts(63.3)) == pytest.approx(63.3, abs=0.5 / 20997)


@pytest.mark.parametrize("kind", KINDS)
def test_isometric_end_to_end(kind: str, tmp_path: Path) -> None:
    result, run, _ = run_short(
        "isometric", tmp_path, f"virtual-{kind}", lengths_mm=(58.0, 64.0), pressures_kpa=(200.0,)
    )
    assert result.outcome == "clean"
    assert run.problems == []
    assert run.final is not None
    assert run.final["counters"]["stage"].get("damaged", 0) == 0
    assert run.manifest["devices"]["stage"]["serial"] == load_rig(f"virtual-{kind}").stage.serial


@pytest.mark.parametrize("kind", KINDS)
def test_hysteresis_end_to_end(kind: str, tmp_path: Path) -> None:
    result, run, _ = run_short("hysteresis", tmp_path, f"virtual-{kind}")
    assert result.outcome == "clean"
    assert run.problems == []


@pytest.mark.realtime
@pytest.mark.parametrize("kind", KINDS)
def test_in_real_time_over_a_port(kind: str, tmp_path: Path) -> None:
    stop = threading.Event()
    with open_server(load_rig(f"virtual-{kind}"), tmp_path / "bench") as server:

        def serve() -> None:
            while not stop.is_set():
                server.step()
                time.sleep(0.0008)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with open_rig(load_rig(str(server.rig_file))) as rig:
                assert isinstance(rig.stage, MotorStage)
                goal = rig.stage.status()[1] + 2.0
                assert rig.stage.move(goal) == pytest.approx(goal, abs=0.013)
                assert not set(rig.stage.faults.counts) - BUSY
        finally:
            stop.set()
            thread.join()


@pytest.mark.parametrize("kind", KINDS)
def test_unplugged_in_mid_run_it_ends_vented(kind: str, tmp_path: Path) -> None:
    def begin(runner: Any) -> None:
        runner.rig.bench.unplug("stage")

    result, run, bench = run_short(
        "isometric", tmp_path, f"virtual-{kind}", begin=begin, pressures_kpa=(200.0, 400.0)
    )
    assert result.outcome != "clean"
    assert run.final is not None
    assert run.final["counters"]["stage"]["unplugged"] == 1
    assert bench.plant.pressure_kpa < 10.0


def test_the_doctor_names_each(on: OnDesk, tmp_path: Path) -> None:
    found = examine(f"virtual-{on.device.kind}", tmp_path)
    assert on.device.serial in " ".join(f.detail for f in found)
