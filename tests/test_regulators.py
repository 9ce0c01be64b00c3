"""Proportional regulators: bytes, faults, analogue mapping, and runs with them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench_process import bench_process, call_pamrig
from bench_runs import quick, run_isometric
from daq.calibration import Calibration
from daq.errors import ConfigError, DeviceError, DeviceTimeout, LinkLost
from daq.store.derive import engineering
from daq.store.run import open_run
from daq.store.verify import verify
from regulator_desk import Desk, desk
from rigs.execution.runner import Runner
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.tables.regulator import OUT_ZERO, output_parameters, read_analogue
from rigs.rigfile.toml_reader import Table
from rigs.virtual.emulators.injected_fault import INJECTED_FAULTS

KINDS = ("alicat-pcd", "smc-itv")
RIGS = ("virtual-alicat", "virtual-itv", "virtual-vppm")
SERIAL = {"alicat-pcd": "400123", "smc-itv": ""}


def connected(kind: str, **how: Any) -> Desk:
    made = desk(kind, **how)
    made.line.connect(SERIAL[kind])
    return made


# ---- the bytes of the manuals -----------------------------------------------------------


def test_the_bytes_of_an_alicat() -> None:
    """Frames and lists as its makers and users print them."""
    line = desk("alicat-pcd").line
    frame = line._line("A +01.104 +00.000 LCK")
    assert frame is not None
    assert frame.fault == "damaged"  # three digits are not what this one was said to print
    line._digits = 3  # type: ignore[attr-defined]
    line._kpa = 100.0  # type: ignore[attr-defined]
    frame = line._line("A +01.104 +00.000 LCK")
    assert frame is not None
    assert (frame.fault, frame.value, frame.set_point) == ("", pytest.approx(110.4), 0.0)
    assert frame.stable
    held = line._line("A +01.104 +00.000 HLD")
    assert held is not None
    assert not held.stable


def test_what_goes_over_an_alicats_line() -> None:
    made = desk("alicat-pcd")
    sent: list[bytes] = []
    write = made.line._link.write  # type: ignore[union-attr]
    made.line._link.write = lambda data: (sent.append(data), write(data))[1]  # type: ignore
    made.line.connect("400123")
    made.line.set_kpa(123.44)
    assert sent[0] == b"@@=A\r"
    assert b"A??M*\r" in sent
    assert b"A??D*\r" in sent
    assert b"A\r" in sent
    assert sent[-1] == b"AS123.4\r"


def test_what_goes_over_an_itvs_line() -> None:
    made = desk("smc-itv")
    sent: list[bytes] = []
    write = made.line._link.write  # type: ignore[union-attr]
    made.line._link.write = lambda data: (sent.append(data), write(data))[1]  # type: ignore
    made.line.connect("")
    made.line.set_kpa(300.0)
    assert sent[0] == b"MON\r\n"
    assert sent[-2:] == [
        b"SET 341\r\n",
        b"REQ\r\n",
    ]  # 300 kPa of 900 kPa


@pytest.mark.parametrize("kind", KINDS)
@given(text=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40))
@settings(max_examples=60, deadline=None)
def test_any_line_is_a_reading_within_range_or_a_fault(kind: str, text: str) -> None:
    answer = DESKS[kind].line._line(text)
    assert answer is not None
    if not answer.fault:
        top = {"alicat-pcd": 99999.9, "smc-itv": 900.0}[kind]
        assert abs(answer.value) <= top


DESKS = {kind: desk(kind) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
@given(kpa=st.floats(0, 690))
@settings(max_examples=40, deadline=None)
def test_a_set_point_goes_there_and_back(kind: str, kpa: float) -> None:
    line = DESKS[kind].line
    assert abs(line.rounded(kpa) - kpa) <= 0.51 * line.step_kpa
    assert line.rounded(line.rounded(kpa)) == pytest.approx(line.rounded(kpa))


# ---- setting and reading ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "how"),
    [("alicat-pcd", {}), ("alicat-pcd", {"label": "PSIG"}), ("alicat-pcd", {"label": "barG"}),
     ("smc-itv", {})],
)  # fmt: skip
def test_it_is_set_and_reads_back(kind: str, how: dict[str, str]) -> None:
    made = connected(kind, **how)
    got = made.line.set_kpa(312.3)
    assert abs(got - 312.3) <= 0.51 * made.line.step_kpa
    made.loop.for_seconds(2.0)
    assert abs(made.outlet.pressure_kpa - got) < 0.1
    assert made.line.mean(5) == pytest.approx(got, abs=0.6)
    assert made.line.faults.counts == {}


def test_a_device_that_streams_is_stopped_first() -> None:
    made = desk("alicat-pcd")
    made.device.unit = "@"
    made.line.connect("400123")
    assert made.device.unit == "A"
    made.line.set_kpa(100.0)


@pytest.mark.parametrize(
    ("how", "words"),
    [({"unit": "B"}, r"no answer to A\?\?M"), ({"label": "PSIA"}, "reads in PSIA; gauge")],
)
def test_another_letter_or_unit_is_refused(how: dict[str, str], words: str) -> None:
    made = desk("alicat-pcd", **how)
    with pytest.raises((DeviceError, DeviceTimeout), match=words):
        made.line.connect("400123")


def test_another_regulator_is_refused() -> None:
    made = desk("alicat-pcd")
    with pytest.raises(DeviceError, match=r"expected 77, got 400123"):
        made.line.connect("77")


def test_nobody_at_the_line() -> None:
    for kind in KINDS:
        made = desk(kind)
        made.device.mute = True
        with pytest.raises(DeviceTimeout, match="check port"):
            made.line.connect(SERIAL[kind])


def test_a_set_point_from_the_front_panel_ends_the_test() -> None:
    made = connected("alicat-pcd")
    made.line.set_kpa(100.0)
    made.device.panel(250.0)
    with pytest.raises(DeviceError, match=r"reads back as 250\.00 kPa, 100\.00 kPa was sent"):
        made.loop.for_seconds(1.0)
    made.loop.for_seconds(1.0)  # said once: venting goes on
    assert made.line.faults.counts == {"unset": 1}


def test_held_valves_are_no_set_point() -> None:
    made = connected("alicat-pcd")
    made.device.codes = ["HLD"]  # as somebody holds them at the panel
    with pytest.raises(DeviceError, match="no good answer in 3 tries"):
        made.line.set_kpa(100.0)
    assert made.line.faults.counts["unset"] >= 3


def test_a_refused_set_point_is_an_error() -> None:
    for kind, kpa in (("alicat-pcd", 900.0), ("smc-itv", 100.0)):
        made = connected(kind)
        if kind == "smc-itv":
            made.device._answer = lambda words: "OUT OF RANGE"
        with pytest.raises(DeviceError, match="no good answer"):
            made.line.set_kpa(kpa)
        assert made.line.faults.counts["refused"] >= 3
        assert made.line.set_kpa_now is None


# ---- faults -----------------------------------------------------------------------------

SEEN = {
    "half": {"half"}, "double": {"stale"}, "late": {"no_answer", "late"}, "drop": {"no_answer"},
    "stale": {"stale"}, "garbage": {"damaged"},
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fault", sorted(SEEN))
def test_a_fault_is_counted_and_never_a_reading(kind: str, fault: str) -> None:
    made = connected(kind)
    made.line.set_kpa(420.0)
    made.loop.for_seconds(1.0)
    made.readings.clear()
    made.device.wire.arrange(fault, "", "", fault)
    made.loop.for_seconds(6.0)
    assert made.device.wire.done.count(fault) == 2
    assert SEEN[fault] & set(made.line.faults.counts), made.line.faults.counts
    assert len(made.readings) >= 10
    wanted = made.line.set_kpa_now
    assert wanted is not None
    assert np.abs(np.array(made.readings) - wanted).max() < 1.5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fault", INJECTED_FAULTS)
def test_a_fault_while_it_is_set_is_tried_again(kind: str, fault: str) -> None:
    made = connected(kind)
    made.loop.for_seconds(0.33)
    made.device.wire.arrange(fault)
    got = made.line.set_kpa(250.0)
    made.loop.for_seconds(1.0)
    assert made.outlet.wanted_kpa == pytest.approx(got)
    assert made.line.faults.total >= 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_cable_that_is_pulled_is_a_loss_once(kind: str) -> None:
    made = connected(kind)
    made.end.close()
    with pytest.raises(LinkLost):
        made.loop.for_seconds(1.0)
    made.loop.for_seconds(1.0)
    with pytest.raises(LinkLost):
        made.line.set_kpa(100.0)
    made.line.let_down()  # nothing to be done, and no error: the controller has vented
    assert made.line.faults.counts == {"unplugged": 1}


# ---- the analogue output ----------------------------------------------------------------


def analogue(limit: float = 600.0, **keys: Any) -> tuple[Calibration, float]:
    table = {"signal": "0-10 V", "range_kpa": [0.0, 600.0], "conditioner": [0.0, 10.2], **keys}
    return read_analogue(Table(table, "rig.toml", "pressure_source"), limit)


@given(
    st.sampled_from(["0-10 V", "0-5 V", "4-20 mA"]), st.floats(500, 1000), st.floats(-30, 30),
    st.floats(0.15, 0.4), st.floats(0, 500),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_the_firmware_puts_out_the_signal_of_the_set_point(
    signal: str, full: float, zero: float, scale: float, kpa: float
) -> None:
    """Counts of the transducer go in; what comes out, through conditioner and regulator, is kPa."""
    low, high = {"0-10 V": (0.0, 10.0), "0-5 V": (0.0, 5.0), "4-20 mA": (4.0, 20.0)}[signal]
    ends = [low - 0.1, high + 0.3]
    output, _ = analogue(500.0, signal=signal, range_kpa=[0.0, full], conditioner=ends)
    transducer = Calibration("pressure_kpa", "kPa", "count", zero, scale)
    values = output_parameters(output, transducer)
    setpoint_x16 = round(16 * float(transducer.raw(kpa)))
    if setpoint_x16 < 0:
        return
    out = (setpoint_x16 * values["out_scale"] >> 12) + values["out_zero_x16"] - OUT_ZERO
    given_ = ends[0] + (ends[1] - ends[0]) * out / 16 / 4095
    made = (given_ - low) / (high - low) * full
    assert made == pytest.approx(kpa, abs=0.3)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"conditioner": [0.0, 9.5]}, r"reach 0\.0 to 570\.0 kPa, and 0 to 600 kPa are needed"),
        ({"conditioner": [0.5, 10.2]}, r"reach 30\.0 to"),
        ({"signal": "4-20 mA", "conditioner": [4.0, 19.0]}, "reach"),
        ({"signal": "0-20 mA"}, "is not one of"),
        ({"range_kpa": [600.0, 0.0]}, r"expected \[low, high\]"),
        ({"conditioner": [0.0]}, "conditioner"),
    ],
)
def test_an_output_that_cannot_reach_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        analogue(**keys)
    assert "\n" not in str(caught.value)


# ---- rig files and runs -----------------------------------------------------------------


def rig_with(tmp_path: Path, name: str, *changes: tuple[str, str]) -> Path:
    text = load_rig(name).text
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return path


def run_on(config: Any, tmp_path: Path, begin: Any = None, **changes: Any) -> Any:
    plan = quick(
        config,
        **{"lengths_mm": (60.0,), "pressures_kpa": (200.0, 500.0), "order": "up-down", **changes},
    )

    def start(runner: Runner, record: Any) -> None:
        del record
        if begin is not None:
            begin(runner)

    result = run_isometric(config, plan, tmp_path / "runs", derive=False, on_start=start)
    return result, open_run(result.folder)


@pytest.mark.parametrize("name", RIGS)
def test_a_test_runs_with_it_and_its_own_reading_is_recorded(name: str, tmp_path: Path) -> None:
    result, run = run_on(load_rig(name), tmp_path)
    assert result.outcome == "clean"
    assert verify(run) == []
    points = [e for e in run.events if e["kind"] == "point"]
    assert points
    assert all(e["settled"] for e in points)
    if name == "virtual-vppm":
        assert "regulator" not in run.streams  # an analogue one says nothing over a port
        return
    own = run.samples("regulator")["reading"]
    assert own.max() == pytest.approx(500.0, abs=6.0)
    assert run.final is not None
    assert set(run.final["counters"]["pressure_source"]) == {"rows"}


@pytest.mark.parametrize("name", ["virtual-alicat", "virtual-itv"])
def test_a_vented_muscle_is_not_joined_to_a_charged_regulator(name: str, tmp_path: Path) -> None:
    """The regulator rose behind a shut inlet, and the firmware took the jump for a broken wire."""
    changes = {"pressures_kpa": (500.0,), "precondition_cycles": 2, "precondition_kpa": 500.0}
    result, run = run_on(load_rig(name), tmp_path, **changes)
    assert result.outcome == "clean", result.error
    kpa = engineering(run, "valve")[0]["pressure_kpa"]
    assert kpa.max() > 480.0
    assert np.diff(kpa).max() < 15.0  # in a millisecond; the controller's `slew` is 22


@pytest.mark.parametrize("protocol", ["step", "hysteresis", "isobaric", "isotonic"])
def test_the_other_protocols_run_with_it(protocol: str, tmp_path: Path) -> None:
    config = load_rig("virtual-alicat")
    chosen = procedure(protocol)
    plan = chosen.read(f"{protocol}-short", config)
    result = run_protocol(chosen, config, plan, tmp_path / "runs")
    assert result.outcome == "clean", result.error
    run = open_run(result.folder)
    points = [e for e in run.events if e["kind"] == "point"]
    assert points
    assert all(e["settled"] for e in points)
    assert (run.samples("regulator")["reading"] > 100.0).any()
    if protocol == "step":
        assert {e["scheme"] for e in points} == {"reg"}


@pytest.mark.parametrize("when", ["before a set-point", "at a point"])
def test_a_regulator_that_is_unplugged_ends_the_run_vented(when: str, tmp_path: Path) -> None:
    """Noticed when it is read, or first when it is written to and then while the bench vents."""

    def begin(runner: Runner) -> None:
        bench = runner.rig.bench
        assert bench is not None
        source = runner.rig.pressure_source
        inner = source.set_pressure

        def pull(pressure_kpa: float) -> Any:
            if pressure_kpa == 500.0:
                bench.unplug("pressure_source")
            return inner(pressure_kpa)

        if when == "at a point":
            runner.watch.point = lambda *_: bench.unplug("pressure_source")
        else:
            source.set_pressure = pull  # type: ignore[method-assign]

    result, run = run_on(load_rig("virtual-alicat"), tmp_path, begin)
    assert result.outcome == "faulted"
    assert "pressure_source" in str(result.error)
    (vented,) = (e for e in run.events if e["kind"] == "vented")
    assert vented["confirmed"]
    assert run.final is not None
    assert run.final["counters"]["pressure_source"]["unplugged"] == 1


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("virtual-itv", ("full_kpa = 900.0", "full_kpa = 500.0"), "above what the regulator can"),
        ("virtual-itv", ('source = "regulator"', 'source = "valve"'), "virtual.source"),
        ("virtual-itv", ("monitor_hz = 5.0", "monitor_hertz = 5.0"), "monitor_hertz"),
        ("virtual-alicat", ('unit = "A"', 'unit = "a1"'), "is not a letter"),
        ("virtual-alicat", ('static_scheme = "reg"', 'static_scheme = "pwm"'), "static_scheme"),
        ("virtual-alicat", ('unit = "A"', 'unit = "A"\ndynamics = "no.toml"'), "no.toml"),
    ],
)  # fmt: skip
def test_a_wrong_key_is_one_line(
    name: str, change: tuple[str, str], words: str, tmp_path: Path
) -> None:
    from rigs.bench.rig import open_rig

    path = rig_with(tmp_path, name, change)
    with pytest.raises(ConfigError, match=words) as caught, open_rig(load_rig(str(path))):
        pass
    assert "\n" not in str(caught.value)


@pytest.mark.campaign
@pytest.mark.realtime
@pytest.mark.parametrize("name", RIGS)
def test_a_test_over_ports_in_real_time(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with bench_process(tmp_path / "bench", name) as bench:
        words = ("isometric", "--rig", bench.rig, "--protocol", "isometric-short", "--json")
        done = call_pamrig(*words)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["outcome"] == "clean"
    (folder,) = (tmp_path / "runs").iterdir()
    run = open_run(folder)
    assert verify(run) == []
    assert ("regulator" in run.streams) == (name != "virtual-vppm")
