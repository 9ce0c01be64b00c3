"""What a user does wrong, or a machine does to him: one clear line, status 2, bench vented."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench_process import (
    LIMIT_S,
    BenchProcess,
    bench_process,
    call_pamrig,
    gave_up,
    pamrig,
    run_pamrig,
    worst_late_ms,
)
from daq.store.run import open_run
from rigs.rigfile.config import load_rig


def rig_with(tmp_path: Path, *changes: tuple[str, str], base: str = "virtual") -> Path:
    """A rig file with parts of its text replaced."""
    text = load_rig(base).text
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return path


def refused(*words: str | Path, expect: tuple[str, ...]) -> str:
    """The command ends with status 2 and one line that says all of ``expect``."""
    done = call_pamrig(*words)
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert done.stderr.count("\n") == 1, done.stderr
    for word in expect:
        assert word in done.stderr, (word, done.stderr)
    return done.stderr


REAL = [('\nport = "virtual"', '\nport = "/dev/nowhere"')] * 3 + [
    ('source = "virtual"', 'source = "uvc:97"')
]


@pytest.mark.parametrize(
    ("changes", "expect"),
    [
        ([("pressure_kpa = 650 ", "presure_kpa = 650 ")], ("limits.pressure_kpa", "missing")),
        ([("[stage]", "[stagge]")], ("rig.toml: stage", "is 'stagge' meant")),
        ([("[stage]", "[table]")], ("rig.toml: stage", "add a table [stage]")),
        ([("[limits]", "[limits]\nmood = 3")], ("limits.mood", "unknown key")),
        ([('serial = "VB-0001"', 'serail = "VB-0001"')], ("valve.serail", "did you mean 'serial'")),
        ([("baud = 115200", 'baud = "fast"')], ("valve.baud", "whole number", "'fast'")),
        ([("trip_kpa = 690 ", "trip_kpa = 1990 ")], ("trip_kpa", "sensor's range")),
        ([("scale = 0.11", "scale = 0")], ("calibrations.length_mm.scale",)),
        ([('unit = "kPa"', 'unit = "bar"')], ("calibrations.pressure_kpa.unit", "kPa")),
        ([('\nport = "virtual"', '\nport = "/dev/ttyUSB9"')], ("valve.port", "mixes")),
        (REAL, ("valve.port", "/dev/nowhere", "no such port")),
        ([('firmware = "0.2" ', 'firmware = "7.3" ')], ("valve.firmware", "7.3", "install")),
        ([("supply_kpa = 700", "supply_bar = 7")], ("supply_bar", "rig.toml")),
        ([("supply_kpa = 700", "supply_kpa = -3")], ("supply_kpa",)),
        (
            [("[virtual.sensors]", "[effects.gremlins]\nsize = 1\n[virtual.sensors]")],
            ("gremlins", "rig.toml"),
        ),
    ],
)
def test_bad_rig_files(
    tmp_path: Path, changes: list[tuple[str, str]], expect: tuple[str, ...]
) -> None:
    rig = rig_with(tmp_path, *changes)
    refused("isometric", "--rig", rig, "--out", tmp_path / "runs", expect=expect)
    assert not list(tmp_path.glob("runs/*"))


@pytest.mark.parametrize(
    ("change", "expect"),
    [
        (("600]", "660]"), ("pressures_kpa[7]", "660", "650")),
        (("[55.0,", "[12.0,"), ("lengths_mm[0]", "51")),
        (('order = "up-down"', 'order = "sideways"'), ("order", "sideways", "up-down, random")),
        (("repeats = 2", "repeats = 0"), ("repeats", "1")),
        (("repeats = 2", "repeat = 2"), ("repeat", "did you mean 'repeats'")),
        (("window_s = 0.5", "window_s = [1]"), ("settle.window_s", "number")),
        (("[measure]", "[measure"), ("not valid TOML",)),
        (('protocol = "isometric"', 'protocol = "isotonic"'), ("protocol", "isotonic")),
    ],
)
def test_bad_protocols(tmp_path: Path, change: tuple[str, str], expect: tuple[str, ...]) -> None:
    from rigs.rigfile.toml_reader import find_config

    text, _ = find_config("isometric", "protocols")
    assert change[0] in text
    path = tmp_path / "protocol.toml"
    path.write_text(text.replace(*change, 1))
    refused("isometric", "--protocol", path, "--out", tmp_path / "runs", expect=expect)


def test_unknown_names_list_what_there_is() -> None:
    refused("isometric", "--rig", "moon", expect=("moon", "virtual-thesis"))
    refused("isometric", "--protocol", "moon", expect=("moon", "isometric-short"))
    refused("report", "moon", "--runs", "nowhere", expect=("moon", "nowhere"))
    refused("import", "thesis", "z99", expect=("z99",))
    refused("import", "points", "nothing.csv", expect=("nothing.csv",))
    refused("length", "uvc:97", expect=("camera 97", "plugged in"))
    refused("read", "--seconds", "nan", expect=("--seconds", "nan"))


@pytest.mark.realtime
def test_ports_as_they_go_wrong(tmp_path: Path) -> None:
    """One bench in real time; each client meets another trouble with it."""
    with bench_process(tmp_path / "bench") as bench:
        out = tmp_path / "runs"
        text = bench.rig.read_text()

        def client(name: str, old: str, new: str) -> Path:
            assert old in text
            path = tmp_path / f"{name}.toml"
            path.write_text(text.replace(old, new, 1))
            return path

        wrong = client("serial", '"VB-0001"', '"VB-7777"')
        refused(
            "isometric", "--rig", wrong, "--out", out, expect=("valve.serial", "VB-7777", "VB-0001")
        )
        wrong = client("balance", '"BAL-0001"', '"BAL-7"')
        refused(
            "isometric",
            "--rig",
            wrong,
            "--out",
            out,
            expect=("balance.serial", "BAL-7", "BAL-0001"),
        )
        wrong = client("swapped", f"{bench.folder}/balance", f"{bench.folder}/stage-gone")
        refused("isometric", "--rig", wrong, "--out", out, expect=("balance.port", "no such port"))
        wrong = client("camera", "tcp://127.0.0.1:", "tcp://127.0.0.1:1")
        refused("isometric", "--rig", wrong, "--out", out, expect=("camera", "camera.source"))
        assert not list(out.glob("*")), "nothing was recorded of runs that never began"
        wrong = client("region", "[camera]\n", "[camera]\nregion = [5000, 0, 90, 90]\n")
        done = run_pamrig("isometric", "--rig", wrong, "--out", tmp_path / "unseen")
        assert done.returncode == 2, done.stderr
        assert "no length can be measured" in done.stdout
        assert "outside the frame of 640 x 480" in done.stdout

        busy = pamrig(
            "isometric", "--rig", bench.rig, "--protocol", "isometric-short", "--out", out
        )
        wait_until_armed(bench, busy)
        refused("isometric", "--rig", bench.rig, "--out", out, expect=("valve.port", "in use"))
        busy.send_signal(signal.SIGINT)
        said, told = busy.communicate(timeout=LIMIT_S)
        assert busy.returncode == 130, (said, told)
        assert "stopped" in said
        truth = bench.truth()[-1]
        assert not truth["armed"]
        assert truth["pressure_kpa"] < 20
        (folder,) = out.iterdir()
        assert open_run(folder).outcome == "stopped"

        cut = pamrig("isometric", "--rig", bench.rig, "--protocol", "isometric-short", "--out", out)
        wait_until_armed(bench, cut)
        time.sleep(2)
        bench.process.kill()
        said, told = cut.communicate(timeout=LIMIT_S)
        assert cut.returncode == 2, (said, told)
        assert "because: " in said
        assert "Traceback" not in told
        print(said)
        last = max(out.iterdir(), key=lambda p: p.name)
        assert open_run(last).outcome == "faulted"


def wait_until_armed(bench: BenchProcess, client: subprocess.Popen[str]) -> None:
    end = time.monotonic() + LIMIT_S
    while not any(line["armed"] for line in bench.lately()):
        if client.poll() is not None:
            said, told = client.communicate()
            raise gave_up(said + told, [worst_late_ms(bench.stop())])
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_full_disk_ends_the_run_in_good_order(tmp_path: Path) -> None:
    """No file may grow past 6 MB: some two minutes on the record fails; the run faults, vents."""
    size = 6_000_000

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    client = pamrig("isometric", "--out", tmp_path, preexec_fn=limit)
    said, told = client.communicate(timeout=LIMIT_S)
    assert client.returncode == 2, (said, told)
    assert "Traceback" not in told
    (folder,) = [p for p in tmp_path.iterdir() if p.is_dir()]
    assert str(folder) in said + told
    run = open_run(folder)
    assert run.outcome in ("faulted", "aborted")
    assert len(run.samples("valve")["seq"]) > 50_000, "what came before the fault is readable"


def test_too_little_room_is_told_before_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import shutil

    from daq.errors import RecordError
    from daq.record.disk import check_disk

    monkeypatch.setattr(
        shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 10**6)
    )
    with pytest.raises(RecordError, match=r"1 MB free.*--out"):
        check_disk(tmp_path, points=100)


@pytest.mark.skipif(os.name == "nt", reason="modes of folders")
def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    refused("isometric", "--out", blocked / "runs", expect=("file",))


def test_help_is_light() -> None:
    """None of the heavy packages may be loaded by the command line's front."""
    code = (
        "import sys, cli.main;"
        "heavy=('rerun','cv2','pyarrow','pandas','numba','matplotlib','scipy','numpy');"
        "bad=[m for m in heavy if m in sys.modules];"
        "print(bad); sys.exit(bool(bad))"
    )

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
