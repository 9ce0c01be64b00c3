"""Calibrations remember when they are due: doctor, the start of a run, its record and report."""

from __future__ import annotations

import json
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest

from analysis.reporting.conditions import instruments
from analysis.reporting.report import report_json, write_report
from analysis.run_table import reduce_run
from bench_process import call_pamrig
from daq.calibration import Calibration
from daq.errors import ConfigError
from daq.store.run import open_run
from protocol_runs import run_short
from rigs.bench.doctor import examine
from rigs.bench.due import SOON_DAYS, due_calibrations
from rigs.execution.runner import Watch
from rigs.rigfile.config import RigConfig, load_rig

TODAY = datetime.now(UTC).date()


def rig_due(folder: Path, days_left: int) -> RigConfig:
    """The default rig; its pressure calibration is due in so many days."""
    made = TODAY - timedelta(days=365 - days_left)
    text = load_rig("virtual").text.replace(
        'id = "P-2026-01"\ndate = "2026-01-12"',
        f'id = "P-7"\ndate = "{made.isoformat()}"\nvalid_days = 365',
    )
    path = folder / "rig.toml"
    path.write_text(text)
    return load_rig(str(path))


@pytest.mark.parametrize(
    ("days_left", "words"),
    [(-3, "was due on"), (0, "was due on"), (SOON_DAYS, "14 days left"), (SOON_DAYS + 1, "")],
)
def test_the_doctor_warns_when_one_is_past_or_due_soon(
    days_left: int, words: str, tmp_path: Path
) -> None:
    config = rig_due(tmp_path, days_left)
    found = [f for f in examine(config.source, tmp_path) if f.what == "calibration of valve"]
    assert [f.status for f in found] == (["warn"] if words else [])
    assert all(words in f.detail and "P-7" in f.detail for f in found)


def test_doctor_prints_it_as_json(tmp_path: Path) -> None:
    config = rig_due(tmp_path, -3)
    done = call_pamrig("doctor", "--rig", config.source, "--runs", tmp_path, "--json")
    (finding,) = [f for f in json.loads(done.stdout) if f["what"] == "calibration of valve"]
    assert finding["status"] == "warn"
    assert "(3 days ago)" in finding["detail"]


def test_a_run_says_so_at_its_start_in_its_record_and_in_its_report(tmp_path: Path) -> None:
    said: list[str] = []
    result, run, _ = run_short(
        "isometric", tmp_path / "runs", config=rig_due(tmp_path, 5), pressures_kpa=(200.0,),
        how={"watch": Watch(log=said.append)},
    )  # fmt: skip
    assert result.outcome == "clean"
    assert any("WARNING" in line and "5 days left" in line for line in said)
    (entry,) = run.manifest["calibrations_due"]
    assert (entry["device"], entry["id"], entry["days_left"]) == ("valve", "P-7", 5)
    reduction = reduce_run(run)
    assert "is due on" in dict(instruments(run, reduction))["valve"]
    report = report_json(run, reduction)
    assert report["calibrations_due"] == [entry]
    (pressure,) = [c for c in report["calibrations"] if c["quantity"] == "pressure_kpa"]
    assert pressure["valid_days"] == 365
    page = write_report(run, tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"due on {entry['due']}" in page


def test_without_a_due_date_nothing_is_said(tmp_path: Path) -> None:
    result, run, _ = run_short("isometric", tmp_path, pressures_kpa=(200.0,))
    assert result.outcome == "clean"
    assert "calibrations_due" not in open_run(result.folder).manifest
    assert all("valid_days" not in c for c in run.manifest["calibrations"].values())


def test_every_calibration_of_a_rig_is_looked_at_once(tmp_path: Path) -> None:
    """Those of instruments as well; a laser that reads the length is one calibration, not two."""
    text = load_rig("virtual-laser").text.replace(
        'date = "2026-01-12"', 'date = "2020-01-01"\nvalid_days = 30'
    )
    (tmp_path / "rig.toml").write_text(text)
    late = due_calibrations(load_rig(str(tmp_path / "rig.toml")), date(2026, 1, 1))
    assert [one.device for one in late] == ["valve", "balance", "laser"]
    assert all(one.due == date(2020, 1, 31) for one in late)


def test_calibrate_writes_the_days_and_a_rig_reads_them(tmp_path: Path) -> None:
    out = tmp_path / "force.toml"
    done = call_pamrig(
        "calibrate", "force", "--out", out, "--valid-days", "200", "--records", tmp_path / "c",
        "--rig", "virtual-instruments", "--masses-kg", "0,1,2", "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["valid_days"] == 200
    text = load_rig("virtual").text
    begin, end = text.index("[calibrations.force_n]"), text.index("[calibrations.length_mm]")
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f'{text[:begin]}[calibrations.force_n]\ncalibration = "force.toml"\n\n{text[end:]}'.replace(
            "BAL-0001", "BAL-0004"
        )
    )
    calibration = load_rig(str(rig)).calibrations["force_n"]
    assert calibration.valid_days == 200
    assert calibration.due == TODAY + timedelta(days=200)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"valid_days": 30, "date": "12.1.2026"}, "YYYY-MM-DD"),
        ({"valid_days": 30}, "YYYY-MM-DD"),
        ({"valid_days": -1, "date": "2026-01-12"}, "whole number"),
        ({"valid_days": 1.5, "date": "2026-01-12"}, "whole number"),
    ],
)
def test_a_due_date_that_cannot_be_known_is_refused(given: dict[str, object], words: str) -> None:
    plain = {"quantity": "force_n", "unit": "N", "raw_unit": "g", "offset": 0, "scale": 1}
    with pytest.raises(ConfigError, match=words):
        Calibration.from_dict({**plain, **given})


def test_valid_days_out_of_range_is_one_line(tmp_path: Path) -> None:
    done = call_pamrig("calibrate", "force", "--out", tmp_path / "x.toml", "--valid-days", "-1")
    assert done.returncode == 2
    assert "--valid-days" in done.stderr
    assert len(done.stderr.splitlines()) == 1
