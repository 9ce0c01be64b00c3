"""Records after the test: index, export, remarks and exclusions, continuation, plans, locks."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat
from typer.testing import CliRunner

from analysis.formats.export import export_run, with_unit
from analysis.reporting.derived import derive_all
from analysis.reporting.report import report_json
from analysis.run_table import reduce_run
from cli.data.runs import point_numbers
from cli.main import app
from cli.protocols.plan import load_plan, progress, run_tests
from cli.protocols.request import tell_run
from cli.protocols.resume import continue_run
from daq.errors import ConfigError, PamrigError, PortError, RecordError
from daq.interrupt import StopFlag
from daq.record.runname import run_name
from daq.store.annotations import ANNOTATIONS, annotate, read_annotations
from daq.store.index import index_path, rebuild_index, update_index
from daq.store.run import Run, open_run
from daq.store.store import find_run, list_runs
from daq.store.verify import verify
from rigs.bench.locks import rig_lock
from rigs.bench.rig import open_rig
from rigs.bench.vent import vent_beside
from rigs.execution.control import RunControl, control_file
from rigs.execution.resume import whole_trials
from rigs.execution.session import run_protocol
from rigs.protocols.isometric import load_isometric
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig

SMALL = """
protocol = "isometric"
lengths_mm = [57.0, 65.0]
pressures_kpa = [150, 300]
order = "random"
repeats = 3
slack_length_mm = 52.0
[precondition]
cycles = 0
[settle]
window_s = 0.3
timeout_s = 5.0
[measure]
seconds = 0.2
frames = 0
zero_s = 0.2
"""


def protocol_file(folder: Path, text: str = SMALL) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "small.toml"
    path.write_text(text)
    return path


def small_run(folder: Path, *, derive: bool = False, **how: Any) -> Run:
    config = load_rig("virtual", 1)
    plan = load_isometric(str(protocol_file(folder)), config.limits)
    kind = procedure("isometric")
    result = run_protocol(kind, config, plan, folder / "runs", **how)
    return derive_all(result.folder) if derive else open_run(result.folder)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return small_run(tmp_path_factory.mktemp("desk"), derive=True, specimen="muscle-7")


def copy_of(run: Run, folder: Path) -> Run:
    import shutil

    target = folder / "runs" / run.run_id
    shutil.copytree(run.folder, target)
    return open_run(target)


# ---- index ---------------------------------------------------------------------------


def test_a_list_is_the_same_with_and_without_an_index(measured: Run, tmp_path: Path) -> None:
    run = copy_of(measured, tmp_path)
    root = run.folder.parent
    plain = list_runs(root)
    assert rebuild_index(root) == plain
    assert list_runs(root) == plain
    assert plain[0].specimen == "muscle-7"


def test_an_index_never_tells_what_is_no_longer_so(measured: Run, tmp_path: Path) -> None:
    run = copy_of(measured, tmp_path)
    root = run.folder.parent
    rebuild_index(root)
    annotate(run.folder, "exclude", [3], "bubble in the tube")
    assert list_runs(root)[0].excluded == 1
    (run.folder / "final.json").unlink()
    assert list_runs(root)[0].outcome == "interrupted"
    run.folder.rename(root / "20990101T000000Z_isometric_other_aaaaaa")
    assert [info.run_id for info in list_runs(root)] == ["20990101T000000Z_isometric_other_aaaaaa"]


@pytest.mark.parametrize("damage", ["garbage", "torn", "layout", "gone"])
def test_a_damaged_index_costs_time_and_nothing_else(
    measured: Run, tmp_path: Path, damage: str
) -> None:
    run = copy_of(measured, tmp_path)
    root = run.folder.parent
    before = rebuild_index(root)
    path = index_path(root)
    if damage == "garbage":
        path.write_bytes(b"not a data base" * 100)
    elif damage == "torn":
        path.write_bytes(path.read_bytes()[:3000])
    elif damage == "layout":
        with sqlite3.connect(path) as db:
            db.execute("PRAGMA user_version = 99")
        db.close()
    else:
        path.unlink()
    assert list_runs(root) == before
    assert find_run(root, "last").run_id == run.run_id
    if damage in ("garbage", "layout"):
        with pytest.raises(RecordError, match="pamrig runs index"):
            update_index(root)
    assert rebuild_index(root) == before
    assert update_index(root) == before


def test_no_folder_to_index_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no such folder"):
        rebuild_index(tmp_path / "nowhere")


# ---- export --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_what_is_exported_reads_back_as_it_was(measured: Run, tmp_path: Path, kind: str) -> None:
    written = export_run(measured, kind, tmp_path)
    table = reduce_run(measured).table
    about = json.loads((tmp_path / "README.json").read_text())
    assert about["run_id"] == measured.run_id
    assert about["tables"]["table"]["rows"] == len(table)
    if kind == "mat":
        read = loadmat(tmp_path / f"{measured.run_id}.mat", simplify_cells=True)
        assert np.allclose(read["table"]["force_n"], table["force_n"])
        assert list(read["table"]["slot"]) == list(table["slot"])
        assert read["samples"]["pressure_kpa"].shape == read["samples"]["time_s"].shape
        return
    reader = pd.read_csv if kind == "csv" else pd.read_parquet
    back = reader(tmp_path / f"table.{kind}")
    assert np.allclose(back["force_n"], table["force_n"])
    samples = reader(tmp_path / f"samples.{kind}")
    assert {"time_s", "pressure_kpa", "setpoint_kpa", "inlet_cmd"} <= set(samples)
    assert len(written) >= 3


def test_units_end_the_names() -> None:
    assert with_unit("reading", "m/s") == "reading_m_s"
    assert with_unit("pressure_kpa", "kPa") == "pressure_kpa"
    assert with_unit("inlet_cmd", "share of 1 ms") == "inlet_cmd"
    assert with_unit("grams", "g") == "grams_g"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("export", "last", "--to", "xlsx"), "--to: 'xlsx' is not one of csv, parquet, mat"),
        (("find", "--protocol", "isomtric"), "--protocol: 'isomtric' is not one of blocked-force"),
        (("find", "--outcome", "good"), "--outcome: 'good' is not one of aborted, clean"),
        (("annotate", "last"), "a remark needs a reason"),
        (("exclude", "last", "--points", "1"), "an exclusion needs a reason"),
        (("include", "last", "--points", "2", "--reason", "x"), "point 2 is not excluded"),
    ],
)
def test_a_word_that_is_none_is_refused_and_nothing_changes(
    measured: Run, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    run = copy_of(measured, tmp_path)
    before = sorted(tmp_path.rglob("*"))
    done = CliRunner().invoke(app, ["runs", *words, "--runs", str(run.folder.parent)])
    assert isinstance(done.exception, PamrigError), done.output
    assert said in str(done.exception)
    assert sorted(tmp_path.rglob("*")) == before


def test_an_unknown_format_is_refused(measured: Run, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="csv, parquet, mat"):
        export_run(measured, "xlsx", tmp_path)


# ---- remarks and exclusions ----------------------------------------------------------


def test_an_excluded_point_leaves_the_table_and_its_reason_stays(
    measured: Run, tmp_path: Path
) -> None:
    run = copy_of(measured, tmp_path)
    every = reduce_run(run).table
    annotate(run.folder, "exclude", [2, 5], "hose was kinked", who="A. Tester")
    annotate(run.folder, "note", [], "new hose from here on")
    reduction = reduce_run(run)
    assert set(every["order"]) - set(reduction.table["order"]) == {2, 5}
    assert [p["reason"] for p in reduction.excluded] == ["hose was kinked"] * 2
    page = (derive_all(run.folder).folder / "derived" / "report.html").read_text(encoding="utf-8")
    assert "hose was kinked" in page
    assert "new hose from here on" in page
    data = report_json(open_run(run.folder))
    assert len(data["points"]) == len(every) - 2
    assert data["annotations"][0]["who"] == "A. Tester"
    assert verify(open_run(run.folder)) == []
    annotate(run.folder, "include", [5], "it was the other one")
    assert set(every["order"]) - set(reduce_run(run).table["order"]) == {2}
    assert len(read_annotations(run.folder)) == 3


def test_nothing_is_excluded_without_a_reason(measured: Run, tmp_path: Path) -> None:
    run = copy_of(measured, tmp_path)
    for reason in ("", "   "):
        with pytest.raises(RecordError, match="reason"):
            annotate(run.folder, "exclude", [1], reason)
    with pytest.raises(RecordError, match="points"):
        annotate(run.folder, "exclude", [], "because")
    assert not (run.folder / ANNOTATIONS).exists()


@pytest.mark.parametrize("at", [5, 40, -3])
def test_a_damaged_exclusion_never_comes_undone_in_silence(
    measured: Run, tmp_path: Path, at: int
) -> None:
    run = copy_of(measured, tmp_path)
    annotate(run.folder, "exclude", [1], "first")
    annotate(run.folder, "exclude", [2], "second")
    path = run.folder / ANNOTATIONS
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(RecordError, match=r"annotations\.jsonl line"):
        reduce_run(open_run(run.folder))
    assert any(p.file == ANNOTATIONS for p in verify(open_run(run.folder)))


@pytest.mark.parametrize(
    ("text", "numbers"), [("3", [3]), ("3,7-9", [3, 7, 8, 9]), (" 4 , 4-5", [4, 5]), ("", [])]
)
def test_points_are_named_by_numbers_and_ranges(text: str, numbers: list[int]) -> None:
    assert point_numbers(text) == numbers


@pytest.mark.parametrize("text", ["a", "3-", "9-7", "1.5", "-2"])
def test_what_is_no_number_of_a_point_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="3,7-9"):
        point_numbers(text)


# ---- continuation --------------------------------------------------------------------


class Killed(BaseException):
    """The process is gone: nothing is finalised."""


def broken_off(folder: Path, how: str, rounds: int, before: Run | None = None) -> Run:
    """A run (or a continuation) that ends after so many rounds of the bench, one way or other."""
    stop = StopFlag()
    made: list[Path] = []

    def start(runner: Any, record: Any) -> None:
        made.append(record.folder)
        left = [rounds]

        def look() -> None:
            left[0] -= 1
            if left[0] > 0:
                return
            if how == "stop":
                stop.set("test")
            elif how == "kill" and left[0] == 0:
                record.abandon()
                raise Killed
            elif how == "pause" and left[0] == 0:
                runner.steering._control.request("pause")
            elif how == "pause" and left[0] == -20:
                runner.steering._control.request("resume")

        runner.rig.event_loop.add(look)

    try:
        if before is None:
            return small_run(folder, stop=stop, on_start=start)
        result = continue_run(before, stop=stop, on_start=start)
        return open_run(result.folder)
    except Killed:
        return open_run(made[-1])


def begun(root: Path) -> list[Path]:
    """Runs with a first event."""
    return [p.parent for p in root.glob("*/events.jsonl") if b'"kind"' in p.read_bytes()]


def killed(folder: Path, after_s: float, before: Run | None = None) -> Run:
    """A run (or a continuation) in a program of its own that SIGKILL ends, if it is not over."""
    root = folder / "runs"
    there = set(root.glob("*/")) if root.exists() else set()
    small = str(protocol_file(folder))
    start = ["isometric", "--protocol", small, "--seed", "1", "--out", str(root)]
    if before is not None:
        start = ["continue", before.run_id, "--runs", str(root)]
    program = subprocess.Popen(
        [sys.executable, "-m", "cli.main", *start],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    end = time.monotonic() + 900.0  # a busy machine is not what is tested
    while not (new := [folder for folder in begun(root) if folder not in there]):
        assert program.poll() is None, program.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
    with contextlib.suppress(subprocess.TimeoutExpired):
        program.wait(after_s)
    program.kill()
    program.communicate()
    return open_run(new[0])


def whole_test(folder: Path, seed: int, really: bool = False) -> tuple[Run, dict[str, int]]:
    """A test broken off again and again at random, and gone on with until it ends.

    Returns:
        the last run, and how often the test was stopped, killed and paused.
    """
    rng = np.random.default_rng(seed)
    run: Run | None = None
    for _ in range(40):
        how = str(rng.choice(["stop", "kill", "pause"]))
        rounds = int(rng.integers(5, 1500))
        if how == "kill" and really:
            run = killed(folder, float(rng.uniform(0.0, 1.0)), run)
        else:
            run = broken_off(folder, how, rounds, run)
        if run.outcome == "clean":
            break
    assert run is not None
    assert run.outcome == "clean", "it never came to its end"
    parts = [open_run(info.folder) for info in list_runs(folder / "runs")]
    broken = {
        "stopped": sum(part.outcome == "stopped" for part in parts),
        "killed": sum(part.outcome == "interrupted" for part in parts),
        "paused": sum(event["kind"] == "paused" for part in parts for event in part.events),
    }
    return run, broken


def check_whole(run: Run) -> None:
    """Every trial and every point of the small test once, in the table of the last run."""
    table = reduce_run(run).table
    assert sorted(table["order"]) == list(range(1, 13))
    assert table.groupby("trial").size().to_dict() == dict.fromkeys(range(1, 7), 2)
    cells = table.groupby(["set_length_mm", "set_pressure_kpa"]).size()
    assert (cells == 3).all()
    assert whole_trials(run) == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("seed", range(3))
def test_no_trial_is_lost_or_doubled_however_often_a_test_is_broken_off(
    tmp_path: Path, seed: int
) -> None:
    run, _ = whole_test(tmp_path, seed)
    check_whole(run)


@pytest.mark.campaign
def test_a_hundred_breaks_lose_and_double_no_trial(tmp_path: Path) -> None:
    """Random moments; a kill is SIGKILL to a program of its own."""
    total = {"stopped": 0, "killed": 0, "paused": 0}
    tests = 0
    while sum(total.values()) < 100 or min(total.values()) < 25:
        run, broken = whole_test(tmp_path / f"{tests}", 1000 + tests, really=True)
        check_whole(run)
        total = {how: n + broken[how] for how, n in total.items()}
        tests += 1
        print(f"{tests} tests: {total}", flush=True)


def test_a_continuation_says_what_it_continues_and_keeps_both_records(tmp_path: Path) -> None:
    first = broken_off(tmp_path, "stop", 700)
    assert first.outcome == "stopped"
    done = whole_trials(first)
    assert 0 < len(done) < 6
    second = derive_all(continue_run(first).folder)
    assert second.manifest["continues"]["run_id"] == first.run_id
    assert second.manifest["continues"]["trials"] == done
    assert {e["trial"] for e in second.events if e["kind"] == "point"} == set(range(1, 7)) - set(
        done
    )
    note = report_json(second)["notes"][0]
    assert first.run_id in note
    assert f"{len(done)} complete trials" in note
    assert verify(first) == verify(second) == []
    with pytest.raises(ConfigError, match=f"continued by {second.run_id}"):
        continue_run(first)
    with pytest.raises(ConfigError, match="ran to its end"):
        continue_run(second)
    annotate(second.folder, "exclude", [1], "first point of the first run")
    assert 1 not in set(reduce_run(second).table["order"])


@pytest.mark.parametrize("how", ["stop", "kill"])
def test_a_continuation_broken_off_before_its_first_trial_is_gone_on_with(
    tmp_path: Path, how: str
) -> None:
    """Whichever of the two a technician names: it is one test, and goes on where it stands."""
    first = broken_off(tmp_path, "stop", 700)
    done = whole_trials(first)
    second = broken_off(tmp_path, how, 3, first)
    assert not [e for e in second.events if e["kind"] == "trial"]
    assert whole_trials(second) == done
    third = open_run(continue_run(first).folder)
    assert third.manifest["continues"]["run_id"] == second.run_id
    assert third.outcome == "clean"
    assert sorted(reduce_run(third).table["order"]) == list(range(1, 13))
    with pytest.raises(ConfigError, match=f"continued by {third.run_id}, which ran to its end"):
        continue_run(first)


def test_the_last_of_several_runs_within_a_second_is_the_last_one(tmp_path: Path) -> None:
    wall_ns = 1_800_000_000_000_000_000
    begun = [(wall_ns + 300_000_000, "flow"), (wall_ns + 301_000_000, "isometric"),
             (wall_ns + 999_000_000, "flow"), (wall_ns + 1_000_000_000, "ram")]  # fmt: skip
    names = [run_name(at, protocol, "a-specimen") for at, protocol in begun]
    for name in sorted(names):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text("{}")
    assert [info.run_id for info in list_runs(tmp_path)] == names
    assert [info.run_id for info in rebuild_index(tmp_path)] == names
    assert find_run(tmp_path, "last").run_id == names[-1]


def test_a_protocol_that_was_changed_meanwhile_is_not_gone_on_with(tmp_path: Path) -> None:
    first = broken_off(tmp_path, "stop", 700)
    protocol_file(tmp_path, SMALL.replace("repeats = 3", "repeats = 4"))
    with pytest.raises(ConfigError, match=r"small\.toml: repeats: was 3 in run"):
        continue_run(first)


# ---- asked from outside ----


def test_a_control_file_that_a_killed_run_left_behind_is_cleared(
    measured: Run, tmp_path: Path
) -> None:
    run = copy_of(measured, tmp_path)
    left, living = control_file(run.folder), tmp_path / "runs" / "other.control"
    left.write_text("pause\n")
    control = RunControl()
    control.listen(living)
    assert not left.exists(), "a test that begins beside it clears it away"
    left.write_text("pause\n")
    with pytest.raises(RecordError, match="is not running"):
        tell_run(run.run_id, run.folder.parent, "pause")
    assert not left.exists()
    with living.open("a") as file:
        file.write("mark here\nsk")
    RunControl().listen(tmp_path / "runs" / "third.control")
    control.look()
    assert (control.take(), control.take()) == (("mark", "here"), None)
    with living.open("a") as file:
        file.write("ip\n")
    control.look()
    assert control.take() == ("skip", "")
    control.close()
    assert not living.exists()


# ---- plans ---------------------------------------------------------------------------

PLAN = """
name = "two tests"
rig = "virtual"
[[test]]
protocol = "isometric"
file = "small.toml"
specimen = "a"
[[test]]
protocol = "isometric"
file = "small.toml"
specimen = "b"
rest_s = 3600
"""


def plan_file(folder: Path, text: str = PLAN) -> Path:
    protocol_file(folder)
    path = folder / "weekend.toml"
    path.write_text(text)
    return path


def test_a_plan_stopped_in_mid_test_goes_on_there(tmp_path: Path) -> None:
    plan = load_plan(plan_file(tmp_path))
    assert len(plan.items) == 2
    stop = StopFlag()

    def start(runner: Any, record: Any) -> None:
        left = [700]

        def look() -> None:
            left[0] -= 1
            if left[0] == 0:
                stop.set("test")

        runner.rig.event_loop.add(look)

    (first,) = run_tests(plan, stop, on_start=start)
    assert first.outcome == "stopped"
    assert progress(plan).done == {}
    second, third = run_tests(load_plan(plan.path), StopFlag())
    assert open_run(second.folder).manifest["continues"]["run_id"] == first.folder.name
    assert (second.outcome, third.outcome) == ("clean", "clean")
    assert [i.specimen for i in list_runs(plan.out)] == ["a", "a", "b"]
    assert len(reduce_run(open_run(second.folder)).table) == 12
    assert run_tests(plan, StopFlag()) == [], "nothing is left"


def test_a_plan_changed_after_it_was_begun_is_not_gone_on_with(tmp_path: Path) -> None:
    plan = load_plan(plan_file(tmp_path))
    run_tests(dataclasses.replace(plan, items=plan.items[:1]), StopFlag())
    plan.path.write_text(PLAN + "# longer\n")
    with pytest.raises(ConfigError, match="was changed since it was started"):
        progress(load_plan(plan.path))


GOOD = '[[test]]\nprotocol = "isometric"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "at least one"),
        ('[[test]]\nprotocol = "dance"\n', "test[0].protocol"),
        ('[[test]]\nprotocol = "isometric"\nfiel = "x"\n', "did you mean 'file'"),
        ('[[test]]\nprotocol = "isometric"\nfile = "gone.toml"\n', "gone.toml"),
        ('[[test]]\nprotocol = "flow"\nrig = "virtual"\n', "has no [flow]"),
        (f'{GOOD}[[test]]\nprotocol = "flow"\nrig = "virtual"\n', "weekend.toml: test[1]: "),
        (f'{GOOD}[[test]]\nprotocol = "flow"\nrig = "moon"\n', "weekend.toml: test[1]: moon"),
        ('on_fault = "cry"\n[[test]]\nprotocol = "isometric"\n', "on_fault"),
    ],
)
def test_every_test_of_a_plan_is_checked_before_any_is_begun(
    tmp_path: Path, text: str, said: str
) -> None:
    with pytest.raises(PamrigError) as error:
        load_plan(plan_file(tmp_path, text))
    assert said in str(error.value)
    assert not (tmp_path / "runs").exists()


# ---- locks ---------------------------------------------------------------------------


def rig_on_ports(folder: Path, name: str, ports: dict[str, str]) -> Path:
    text = load_rig("virtual").text
    for device in ("valve", "balance", "stage"):
        head, _, tail = text.partition(f"[{device}]")
        tail = tail.replace('port = "virtual"', f'port = "{ports[device]}"', 1)
        text = f"{head}[{device}]{tail}"
    text = text.replace('source = "virtual"', 'source = "uvc:7"')
    path = folder / f"{name}.toml"
    path.write_text(text)
    return path


def test_a_rig_in_use_is_refused_and_another_one_is_not(tmp_path: Path) -> None:
    def rig(name: str, *, camera: str) -> Any:
        ports = {}
        for device in ("valve", "balance", "stage"):
            ports[device] = str(tmp_path / f"{name}-{device}")
            Path(ports[device]).touch()
        path = rig_on_ports(tmp_path, name, ports)
        path.write_text(path.read_text().replace("uvc:7", camera))
        return load_rig(str(path))

    one, two = rig("one", camera="uvc:1"), rig("two", camera="uvc:2")
    shared = rig("three", camera="uvc:1")
    locks = tmp_path / "locks"
    with rig_lock(one, locks), rig_lock(two, locks):
        with pytest.raises(PortError) as error, rig_lock(one, locks):
            pass
        assert "one.toml: valve.port" in str(error.value)
        assert f"process {os.getpid()}" in str(error.value)
        with (
            pytest.raises(PortError, match=r"three\.toml: camera\.source"),
            rig_lock(shared, locks),
        ):
            pass
    with rig_lock(one, locks):
        pass


def test_a_lock_goes_with_its_process_however_that_ends(tmp_path: Path) -> None:
    for device in ("valve", "balance", "stage"):
        (tmp_path / device).touch()
    ports = {d: str(tmp_path / d) for d in ("valve", "balance", "stage")}
    path = rig_on_ports(tmp_path, "bench", ports)
    code = (
        "import sys, os\nfrom pathlib import Path\nfrom rigs.rigfile.config import load_rig\n"
        "from rigs.bench.locks import rig_lock\n"
        f"with rig_lock(load_rig({str(path)!r}), Path({str(tmp_path / 'locks')!r})):\n"
        "    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    config = load_rig(str(path))
    with (
        pytest.raises(PortError, match=f"process {other.pid}"),
        rig_lock(config, tmp_path / "locks"),
    ):
        pass
    other.kill()
    other.communicate()
    with rig_lock(config, tmp_path / "locks"):
        pass


def test_a_wrong_port_is_still_named_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PAMRIG_LOCKS", str(tmp_path / "locks"))
    ports = {d: str(tmp_path / f"no-{d}") for d in ("valve", "balance", "stage")}
    config = load_rig(str(rig_on_ports(tmp_path, "bench", ports)))
    with pytest.raises(PortError, match=r"valve\.port = .*no-valve"), open_rig(config):
        pass


def test_a_program_that_takes_no_request_is_named_by_vent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A console or calibration holds the rig: it is not ended behind its user's back."""
    monkeypatch.setenv("PAMRIG_LOCKS", str(tmp_path / "locks"))
    monkeypatch.setattr("rigs.bench.vent.TAKEN_S", 0.5)
    path = rig_on_ports(
        tmp_path, "bench", {d: str(tmp_path / d) for d in ("valve", "balance", "stage")}
    )
    code = (
        "import sys\nfrom rigs.rigfile.config import load_rig\n"
        "from rigs.bench.locks import rig_lock\n"
        f"with rig_lock(load_rig({str(path)!r})):\n"
        "    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        said: list[str] = []
        with pytest.raises(PortError, match=rf"process {other.pid} .*did not end"):
            vent_beside(load_rig(str(path)), said.append)
        assert "asked it to end and vent" in said[0]
        assert list((tmp_path / "locks").glob("*.vent")) == []
        other.kill()


def test_a_request_to_vent_that_was_left_behind_ends_no_test(tmp_path: Path) -> None:
    vent = tmp_path / "port.vent"
    for age_s, asked in ((1.0, ("stop", "")), (300.0, None)):
        control = RunControl()
        control.listen(tmp_path / "run.control", vent)
        vent.touch()
        os.utime(vent, (time.time() - age_s,) * 2)
        control.look()
        assert control.take() == asked
        assert not vent.exists()
        control.close()
