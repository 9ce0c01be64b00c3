"""The fault campaign at its small size, what it found, and that its judges can say no."""

from __future__ import annotations

import copy
import errno
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.run_table import reduce_run
from daq.link.framer import CobsFramer
from daq.store.run import open_run
from faults.campaign import run_campaign
from faults.judge import Verdict, judge
from faults.kinds import Fault, has_checksum
from faults.page import wilson_upper, write_page
from faults.places import empty_s
from faults.trial import Truth, run_trial
from faults.values import check_step
from protocol_runs import run_short
from rigs.execution.resume import remaining
from rigs.rigfile.form import load_form
from rigs.rigfile.modbus_form import ModbusForm
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad
from rigs.steps.steps import EndTrial, Trial
from rigs.virtual.emulators.modbus import VirtualModbus
from rigs.virtual.emulators.text import VirtualText
from valvefw.wire import TELEMETRY

SMALL = range(14)


def findings(result: dict[str, Any]) -> list[str]:
    """All that the judges say of a run."""
    names = ("untold", "late", "unreadable", "wrong", "stuck")
    return [text for name in names for text in result[name]] + [t for t in [result["crashed"]] if t]


def test_a_sample_of_the_campaign_finds_nothing(tmp_path: Path) -> None:
    results = run_campaign(SMALL, tmp_path)
    assert {r["number"]: findings(r) for r in results if findings(r)} == {}
    assert sum(any(f["hits"] for f in r["faults"]) for r in results) > len(results) / 2
    assert run_campaign(SMALL, tmp_path) == results  # nothing is run twice
    write_page(results, tmp_path / "faults.md")
    assert f"{len(SMALL)} runs" in (tmp_path / "faults.md").read_text()


@pytest.mark.campaign
def test_two_hundred_runs_find_nothing(tmp_path: Path) -> None:
    results = run_campaign(range(10_000, 10_200), tmp_path, 2)
    assert {r["number"]: findings(r) for r in results if findings(r)} == {}


def test_wilson_bound() -> None:
    # 0 of 5000: z^2 / (n + z^2) with z = 1.6449; and no bound is below what was seen.
    assert wilson_upper(0, 5000) == pytest.approx(1.6449**2 / (5000 + 1.6449**2))
    assert wilson_upper(3, 10) > 0.3


# ---- the judges can say no -----------------------------------------------------------


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    """A short run in which nothing went wrong."""
    truth = run_trial("step", 0, tmp_path_factory.mktemp("judged"), [])
    assert truth.outcome == "clean"
    assert judge(truth).sound
    return truth


def test_a_fault_without_a_trace_is_untold(sound: Truth) -> None:
    truth = copy.copy(sound)
    for layer, device in (
        ("wire", "valve"),
        ("instrument", "balance"),
        ("camera", ""),
        ("disk", ""),
    ):
        truth.faults = [Fault(layer, "any", device, hits=1, must_tell=1)]
        assert judge(truth).untold == [truth.faults[0].name]
    truth.outcome, truth.error = "faulted", "run.json cannot be written: no space left on device"
    assert judge(truth).untold == []


def test_a_vent_that_comes_late_is_late(sound: Truth) -> None:
    truth = copy.copy(sound)
    half = len(truth.beats) // 2
    armed_us = truth.beats[half][0]
    truth.beats = truth.beats[: half + 1]  # and none after it
    truth.vents = [(0, True), (armed_us - 1, False), (armed_us + 400_000, True)]
    assert "no heartbeat" in judge(truth).late[0]
    truth.vents[-1] = (armed_us + 340_000, True)
    assert not any("no heartbeat" in late for late in judge(truth).late)
    truth = copy.copy(sound)
    truth.end_kpa = 50.0
    assert judge(truth).late == ["50 kPa in the muscle 3 s after the end"]
    truth = copy.copy(sound)
    truth.trip_kpa = float(truth.kpa.max()) - 10.0
    assert any("over-pressure" in late for late in judge(truth).late)


def test_a_row_that_is_gone_or_other_is_unreadable(sound: Truth) -> None:
    truth = copy.deepcopy(sound)
    truth.taken["valve"]["counts"][100] += 1
    assert {"valve.counts reads otherwise (arrow)", "valve.counts reads otherwise (pamrig)"} == set(
        judge(truth).unreadable
    )
    truth = copy.deepcopy(sound)
    truth.first_row["valve"] += 10_000
    assert any("rows of valve are gone" in found for found in judge(truth).unreadable)
    truth = copy.deepcopy(sound)
    truth.events.append((10_000, "point"))
    truth.frames.append((3, 1, 50.0))
    found = judge(truth).unreadable
    assert any("1 events are gone" in text for text in found)
    assert any("picture 3 is gone" in text for text in found)


def test_a_muscle_that_is_filled_blindly_is_late(sound: Truth) -> None:
    truth = copy.copy(sound)
    at = int(np.argmax(truth.kpa > 10.0))  # from here it is filled to 200 kPa
    truth.faults = [Fault("sensor", "low", begun_us=int(truth.us[at]), hits=1)]
    truth.kpa = np.where(np.arange(len(truth.kpa)) > at, truth.kpa + 200.0, truth.kpa)
    assert any("read nothing" in found for found in judge(truth).late)


def test_air_is_late_only_once_it_could_have_gone(sound: Truth) -> None:
    """By the laws of the rig's own chamber, from when it was no longer sealed in."""
    truth = copy.copy(sound)
    truth.end_kpa = 50.0
    end_us = int(truth.us[-1])
    for since_us, late in ((end_us - 20_000, 0), (end_us - 500_000, 1)):
        truth.sealed_us = since_us
        assert len(judge(truth).late) == late
    truth = copy.copy(sound)
    last_us = truth.vents[-1][0]
    truth.kpa = np.where((truth.us > last_us) & (truth.us < last_us + 400_000), 120.0, truth.kpa)
    assert any("still 20 kPa 0.4" in found for found in judge(truth).late)


def test_the_deadline_for_emptying_is_the_vessels() -> None:
    """Choked, pressures fall by e in V / (C rho_0 R T_0), 2.055 s on the stand; and no deadline is
    beyond those of the safety contract for a muscle.
    """
    time_s = 256.1e-6 / (1.25e-9 * 1.185 * 287.05 * 293.15)
    choked_s = time_s * np.log((700 + 101.325) / (300 + 101.325))
    took_s = (empty_s("flow", 700.0) - empty_s("flow", 300.0)) / 1.15
    assert took_s == pytest.approx(choked_s, rel=2e-3)
    assert empty_s("isometric", 700.0) < 1.5
    assert empty_s("step", 550.0) < 0.3


def test_a_test_that_does_not_begin_is_stuck() -> None:
    verdict = judge(Truth("step", 0, [], outcome="refused", error="the reason"))
    assert verdict.stuck == ["did not begin: the reason"]


def test_what_one_fault_told_does_not_speak_for_another(sound: Truth) -> None:
    """The stage ended the run; of the balance nothing is said."""
    truth = copy.copy(sound)
    truth.outcome, truth.error = "faulted", "stage on stage: no answer"
    early = truth.done_us - 5_000_000
    truth.faults = [
        Fault("wire", "lost", device, hits=1, must_tell=1, first_us=early)
        for device in ("stage", "balance")
    ]
    assert judge(truth).untold == ["wire: lost (balance)"]


def test_a_sample_that_is_off_is_wrong(sound: Truth) -> None:
    truth = copy.deepcopy(sound)
    counts = truth.taken["valve"]["counts"]
    counts[np.argmax(counts > 400)] ^= 64  # 16 kPa
    assert any("kPa off" in found for found in judge(truth).wrong)
    truth = copy.deepcopy(sound)
    truth.taken["valve"]["device_us"][1500] += 7  # a tick is a whole millisecond
    assert judge(truth).wrong == ["1 samples bear times at which none was taken"]


def test_a_sensor_that_stood_still_longer_than_planned_is_not_wrong(sound: Truth) -> None:
    """The program hung, and with it whoever mends the sensor; before and after it counts."""
    truth = copy.deepcopy(sound)
    counts, us = truth.taken["valve"]["counts"], truth.taken["valve"]["device_us"]
    at = int(np.argmax(counts > 400))
    counts[at] ^= 64
    begun, moment = int(us[at]) - 200_000, int(us[at]) - truth.start0_us
    fault = Fault("sensor", "frozen", hits=1, begun_us=begun, end_s=(begun + 100_000) * 1e-6)
    truth.faults = [fault]
    for ended, found in ((moment + 5000, 0), (-1, 0), (moment - 5000, 1)):
        fault.ended_us = ended
        assert sum("kPa off" in text for text in judge(truth).wrong) == found


def test_times_of_a_step_are_judged_by_the_true_pressure(sound: Truth) -> None:
    run = open_run(sound.folder)
    points = {e["order"]: e for e in run.events if e["kind"] == "point"}
    for row in reduce_run(run).table.to_dict("records"):
        known = [name for name in ("rise_s", "settle_s") if np.isfinite(row[name])]
        for off_s, found in ((0.0, 0), (0.01, len(known)), (-0.01, len(known))):
            verdict = Verdict()
            times = {name: row[name] + off_s for name in known}
            point = points[row["order"]]
            point["t_ns"] += 400_000_000  # the program hung before it wrote what it had measured
            check_step(sound, {**row, **times}, point, verdict)
            assert len(verdict.wrong) == found


def test_nobody_is_asked_to_tell_what_comes_after_the_record(sound: Truth) -> None:
    truth = copy.copy(sound)
    for begun, found in ((truth.closed_us - 500_000, 1), (truth.closed_us, 0)):
        truth.faults = [
            Fault("wire", "unplugged", "valve", hits=1, must_tell=1, begun_us=begun, first_us=begun)
        ]
        assert len(judge(truth).untold) == found


def test_a_flipped_digit_must_be_told_only_where_the_line_can_show_it() -> None:
    for form, shows in (("air-velocity", True), ("load-cell-stream", False)):
        device = VirtualText(load_form(form), lambda: 0.0, lambda data: None, "1")
        assert has_checksum(device) == shows
    assert has_checksum(VirtualModbus(ModbusForm("p", "kPa", 1, 0), float, lambda data: None))


# ---- what the campaign found; each was red ---------------------------------------------


def test_steps_after_the_last_trial_take_answers_when_a_test_is_gone_on_with() -> None:
    """`pamrig continue` broke off with a traceback where a load was still to be taken down."""

    def method() -> Steps:
        yield Trial(1, "M1", 1, 1, "m1", "isotonic", ())
        yield EndTrial(1)
        answer = yield HangLoad(0.0)
        assert answer == 0.0 or answer is None

    steps = remaining(method(), [1])
    assert isinstance(steps.send(None), HangLoad)
    with pytest.raises(StopIteration):
        steps.send(0.0)


def test_a_record_whose_last_words_are_lost_is_not_called_clean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk failed after the last step: final.json said faulted, the command line clean."""
    real = os.fsync
    failed: list[int] = []

    def fsync(fd: int) -> None:
        if not failed and os.readlink(f"/proc/self/fd/{fd}").endswith("events.jsonl"):
            failed.append(fd)
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    result, run, _ = run_short("step", tmp_path)
    assert failed
    assert open_run(run.folder).outcome == "faulted"
    assert result.outcome == "faulted"
    assert "disk reports a fault" in str(result.error)


def losing(share: float) -> Callable[[Any], None]:
    """A hook that loses so many frames of telemetry, and nothing else, on their way."""
    rng = random.Random(1)

    def lose(runner: Any) -> None:
        bench = runner.rig.bench
        send = bench._send

        def lossy(device: str, data: bytes, bench_ns: int | None = None) -> None:
            payloads = CobsFramer().feed(b"\0" + data) if device == "valve" else []
            if not any(p[:1] == bytes([TELEMETRY]) for p in payloads) or rng.random() > share:
                send(device, data, bench_ns)

        bench._send = lossy

    return lose


@pytest.mark.parametrize("protocol", ["step", "ram"])
def test_times_of_a_response_do_not_slip_where_samples_are_lost(
    tmp_path: Path, protocol: str
) -> None:
    """Samples were counted as they stood in the record: each lost frame made all times 10 ms early.

    What hangs on the lost ones is left out (step) or has their time for its uncertainty (ram).
    """
    _, whole, _ = run_short(protocol, tmp_path / "whole")
    result, lossy, _ = run_short(protocol, tmp_path / "lossy", begin=losing(0.05))
    assert result.outcome == "clean"
    assert lossy.final["counters"]["valve"]["missing"] > 200
    tables = [reduce_run(run).table for run in (whole, lossy)]
    known = 0
    for name in ("rise_s", "settle_s", "reach_s"):
        if name in tables[0]:
            off = (tables[0][name] - tables[1][name]).abs()
            off = off[:1] if protocol == "ram" else off  # where it goes from there is another way
            u = tables[1][f"u_{name}"][off.index] if name == "reach_s" else off * 0.0
            known += int(off.notna().sum())
            assert (off.dropna() <= 0.002 + 2 * u[off.notna()]).all(), (name, off, u)
    assert known >= (1 if protocol == "ram" else 2)
    assert any("samples are missing" in note for note in reduce_run(lossy).notes)


def test_a_step_in_which_the_program_stood_still_is_judged_to_its_end(tmp_path: Path) -> None:
    """The controller vents meanwhile; the samples that had come by then would call it settled."""

    def hang(runner: Any) -> None:
        event_loop, steps = runner.rig.event_loop, []
        wait = event_loop.for_seconds

        def for_seconds(seconds: float) -> None:
            steps.append(seconds >= 1.0)
            if sum(steps) < 3:
                return wait(seconds)
            wait(0.6 * seconds)
            return runner.rig.clock.sleep(1.2)

        event_loop.for_seconds = for_seconds

    result, run, _ = run_short("step", tmp_path, begin=hang)
    assert result.outcome == "faulted"
    last = reduce_run(run).table.iloc[-1]
    assert last["scheme"] == "burst"  # which is quiet in 60 ms, where the other never is
    assert not last["settled"]
    assert np.isnan(last["settle_s"])


def test_a_try_with_lost_samples_is_made_again(tmp_path: Path) -> None:
    """Whether a valve opened was told from whatever samples had come, older ones among them."""
    result, run, _ = run_short("switching-voltage", tmp_path, begin=losing(0.01))
    assert result.outcome == "clean"
    assert any(e["kind"] == "lost" for e in run.events)
    seq = run.samples("valve")["seq"]
    tries = [e["valve_seq"] for e in run.events if e["kind"] == "try"]
    whole = [((seq >= a) & (seq < b)).sum() == b - a for a, b in tries]
    assert np.mean(whole) > 0.8  # what is lost in the frame after the last is not yet known
    table = reduce_run(run).table
    assert (table["u_on_v"] > 0).all()
    assert (table["u_off_v"] > 0).all()


@pytest.mark.parametrize("protocol", ["switching-time", "switching-voltage", "flow", "ram", "step"])
def test_a_valve_test_does_not_fill_what_it_cannot_feel(tmp_path: Path, protocol: str) -> None:
    """The sensor's wire breaks in the vented vessel: it was filled to the supply's 650 kPa, since
    these tests had switched off the controller's question whether anything rises; and where an
    inlet fills a muscle in 50 ms (step) it was asked after 60.
    """
    benches: list[Any] = []

    def cut(runner: Any) -> None:
        benches.append(runner.rig.bench)
        runner.rig.bench.board.sensor_override = 0
        runner.rig.bench.board._truth_every = runner.rig.bench.board._truth_left = 1

    result, _, _ = run_short(protocol, tmp_path, begin=cut)
    assert result.outcome == "faulted"
    assert "sensor_no_rise" in str(result.error)
    assert max(benches[0].board.truth_kpa) < 250.0


def test_a_reading_that_lost_its_head_is_counted(tmp_path: Path) -> None:
    """It was kept as an answer for whoever might ask, and no counter showed that one was lost."""

    def behead(runner: Any) -> None:
        bench = runner.rig.bench
        send, left = bench._send, [3]

        def cut(device: str, data: bytes, bench_ns: int | None = None) -> None:
            if device == "balance" and data.startswith(b"S ") and left[0]:
                left[0] -= 1
                data = data[4:]
            send(device, data, bench_ns)

        bench._send = cut

    result, run, _ = run_short("step", tmp_path, begin=behead)
    assert result.outcome == "clean"
    assert run.final["counters"]["balance"]["damaged"] == 3


def test_a_restart_in_the_closing_vent_is_told(tmp_path: Path) -> None:
    """Nobody looked for one any more: the run was clean, its record had it as mere chatter."""
    told: list[str] = []

    def restart(runner: Any) -> None:
        safe, runner.watch.log = runner._safe, told.append

        def closing() -> None:
            runner.rig.bench.board.reset("brownout")
            safe()

        runner._safe = closing

    _, run, _ = run_short("switching-time", tmp_path, begin=restart)
    assert [e for e in run.events if e["kind"] == "fault" and "reboot" in e["text"]]
    assert any("restarted" in line for line in told)


def in_the_closing_vent(act: Callable[[Any], None]) -> Callable[[Any], None]:
    """A hook that does something to the bench when the last step is done."""

    def begin(runner: Any) -> None:
        safe = runner._safe

        def closing() -> None:
            act(runner.rig.bench)
            safe()

        runner._safe = closing

    return begin


def on_the_way(bench: Any, device: str, change: Callable[[bytes], bytes]) -> None:
    """From now on what a device sends comes changed; nothing comes where nothing is left."""
    send = bench._send

    def changed(name: str, data: bytes, bench_ns: int | None = None) -> None:
        data = change(data) if name == device else data
        if data:
            send(name, data, bench_ns)

    bench._send = changed


def test_half_a_line_at_the_very_end_is_counted(tmp_path: Path) -> None:
    """The record was closed while the line had no end yet: no counter showed it."""
    halves = in_the_closing_vent(lambda b: on_the_way(b, "balance", lambda d: d[: len(d) // 2]))
    result, run, _ = run_short("switching-time", tmp_path, begin=halves)
    assert result.outcome == "clean"
    assert run.final["counters"]["balance"]["half"] == 1
    assert "half" not in run.final["counters"]["flow"]


def test_a_line_that_is_on_its_way_at_the_very_end_is_not_half(tmp_path: Path) -> None:
    """Of a real instrument's line some bytes may have come when a test is done."""

    def in_two(runner: Any) -> None:
        bench, rest = runner.rig.bench, list[tuple[int, bytes]]()
        send, clock = bench._send, bench.clock

        def begin(name: str, data: bytes, bench_ns: int | None = None) -> None:
            if name == "balance":
                rest.append((clock.now_ns() + 80_000_000, data[9:]))
                data = data[:9]
            send(name, data, bench_ns)

        def go_on() -> None:
            while rest and rest[0][0] <= clock.now_ns():
                send("balance", rest.pop(0)[1])

        bench._send = begin
        runner.rig.event_loop.add(go_on)

    _, run, _ = run_short("step", tmp_path, begin=in_two)
    when = {e["kind"]: e["t_ns"] for e in run.events}
    assert when["clockfit"] > when["vented"]  # something was on its way
    counters = run.final["counters"]["balance"]
    assert counters["lines"] > 40
    assert "half" not in counters


def test_heartbeats_go_on_after_two_hours(tmp_path: Path) -> None:
    """The wire counts them modulo 65536; a host that went on was silent to the controller."""

    def late(runner: Any) -> None:
        runner.rig.valve._beat_count = 65530

    result, run, _ = run_short("isometric", tmp_path, begin=late)
    assert result.outcome == "clean", result.error
    assert run.final["counters"]["valve"]["unanswered"] == 0


def test_an_answer_to_a_heartbeat_that_is_lost_is_counted(tmp_path: Path) -> None:
    """It did no harm, and left no trace: each answer was a ping of the clock fit and no more."""

    def lose(runner: Any) -> None:
        left = [3]

        def one_less(data: bytes) -> bytes:
            if b" ok hb=" in data and left[0]:
                left[0] -= 1
                return b""
            return data

        on_the_way(runner.rig.bench, "valve", one_less)

    result, run, _ = run_short("step", tmp_path / "lossy", begin=lose)
    assert result.outcome == "clean"
    assert run.final["counters"]["valve"]["unanswered"] == 3
    _, run, _ = run_short("step", tmp_path / "whole")
    assert run.final["counters"]["valve"]["unanswered"] == 0


def test_a_supply_that_cannot_be_set_back_is_told(tmp_path: Path) -> None:
    """In the closing vent nobody said that the solenoids' voltage did not read back."""
    cut = in_the_closing_vent(lambda b: on_the_way(b, "supply", lambda d: d.replace(b"E+01", b"")))
    result, run, _ = run_short("switching-time", tmp_path, begin=cut)
    assert result.outcome == "clean"
    told = [e for e in run.events if e["kind"] == "instrument" and e["device"] == "supply"]
    assert {e["fault"] for e in told} == {"unset"}
    assert run.final["counters"]["supply"]["unset"] == len(told)  # asked again while air remains


def test_a_hang_after_disarming_need_not_be_told_but_one_before_must(sound: Truth) -> None:
    truth = copy.copy(sound)
    last = max(us for us, armed in truth.beats if armed)
    for begun, found in ((last - 1_000_000, 1), (last + 400_000, 0)):
        truth.faults = [Fault("process", "hung", hits=1, must_tell=1, begun_us=begun)]
        assert len(judge(truth).untold) == found
