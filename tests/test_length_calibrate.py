"""`pamrig calibrate length`: instruments of length against gauge blocks and the stage."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis.regression.calibration_line import Reference
from bench_runs import quick, run_isometric
from cli.main import app
from daq.errors import ConfigError, PamrigError
from daq.interrupt import StopFlag, Stopped
from daq.store.run import open_run
from rigs.bench.due import due_calibrations
from rigs.calibration.length import calibrate_length
from rigs.calibration.run import Calibrated
from rigs.execution.runner import Watch
from rigs.rigfile.calibration_file import write_calibration
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench

BLOCKS = Reference("set G-7, class 1", u_each=0.001, u_offset=0.005, u_gain=1e-5)
LENGTHS = [52.0, 57.0, 62.0, 67.0, 72.0]
EXACT = Reference("exact")


def reading_at(config: RigConfig, name: str, length_mm: float) -> float:
    """What the instrument of a bench with these errors reads, without noise."""
    bench = VirtualBench(config)
    bench.plant.set_length(length_mm)
    device: Any = bench.extras.devices.get(name)
    if device is not None:
        return float(np.mean([device._read() for _ in range(400)]))
    return float(bench.extras.inputs._truth[name]())  # type: ignore[union-attr]


def error_of(done: Calibrated, config: RigConfig, name: str, length_mm: float) -> float:
    """(length by the calibration - length) / u."""
    c = done.file.calibration
    found = float(c.apply(reading_at(config, name, length_mm)))
    return (found - length_mm) / float(c.u(length_mm))


def laser_to(folder: Path, high: float) -> RigConfig:
    """The bench with a laser that reads up to so many mm; a length of 52 mm reads 43."""
    path = folder / "rig.toml"
    path.write_text(load_rig("virtual-laser").text.replace("high = 45.0", f"high = {high}"))
    return load_rig(str(path))


def test_lengths_at_the_end_of_the_range_are_left_out(tmp_path: Path) -> None:
    """The stage is begun with where the laser can read it."""
    said: list[str] = []
    done = calibrate_length(
        laser_to(tmp_path, 43.0), LENGTHS, tmp_path, blocks=EXACT, by_stage=True, seconds=0.5,
        watch=Watch(log=said.append),
    )  # fmt: skip
    assert min(reference for _, reference, _ in done.points) == pytest.approx(57.0, abs=0.1)
    assert len(done.points) == 7
    assert len(said) == 2
    assert all("52 mm: left out, " in line for line in said)
    with pytest.raises(PamrigError, match="points within its range: 1, needed: 3"):
        calibrate_length(
            laser_to(tmp_path, 34.0), [52.0, 57.0, 60.0, 62.0], tmp_path, blocks=EXACT,
            by_stage=True, seconds=0.5,
        )  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("by_stage", [False, True])
def test_a_lasers_own_errors_are_found(tmp_path: Path, seed: int, by_stage: bool) -> None:
    config = load_rig("virtual-laser", seed)
    known = Reference("stage", u_each=0.003, u_offset=0.005) if by_stage else BLOCKS
    done = calibrate_length(config, LENGTHS, tmp_path, blocks=known, by_stage=by_stage)
    c = done.file.calibration
    assert (c.quantity, c.unit, c.raw_unit) == ("length_mm", "mm", "mm")
    assert c.scale < 0.0  # it looks from beyond the muscle's end
    assert c.domain == pytest.approx((52.0, 72.0), abs=0.01)
    assert len(done.points) == 9
    for length in (53.0, 62.0, 71.0):
        assert abs(error_of(done, config, "laser", length)) < 3.0
    # Better than what the rig file states of the instrument as it was bought.
    assert float(c.u(62.0)) < 0.5 * float(config.calibrations["length_mm"].u(62.0))
    record = open_run(done.folder)
    assert record.outcome == "clean"
    assert record.manifest["parameters"]["by"] == ("stage" if by_stage else "blocks")
    assert sum(e["kind"] == "calibration_point" for e in record.events) == 9
    kept = [e for e in record.events if e["kind"] == "calibration_readings"]
    assert np.mean(kept[0]["readings"]) == pytest.approx(done.points[0][0])
    assert not [e for e in record.events if e["kind"] == "armed"]


def test_counts_of_an_encoder_on_the_controller(tmp_path: Path) -> None:
    config = load_rig("virtual-channels", 4)
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    lengths = list(np.linspace(low + 1.0, high - 1.0, 4))
    done = calibrate_length(config, lengths, tmp_path, blocks=BLOCKS, by_stage=True, seconds=1.0)
    c = done.file.calibration
    assert c.raw_unit == "count"
    stated = config.calibrations["length_mm"]
    assert c.scale == pytest.approx(
        stated.scale, rel=3.0 * float(np.hypot(c.u_gain, stated.u_gain))
    )


def test_a_rig_file_names_the_file_and_the_doctor_its_due_date(tmp_path: Path) -> None:
    config = load_rig("virtual-laser")
    done = calibrate_length(config, LENGTHS, tmp_path / "records", blocks=BLOCKS, seconds=1.0)
    old = dataclasses.replace(done.file.calibration, date="2020-01-02", valid_days=365)
    file = dataclasses.replace(done.file, calibration=old)
    write_calibration(tmp_path / "length.toml", file, done.points)
    text = config.text
    begin, end = text.index("zero_mm = 95.0"), text.index("[calibrations.pressure_kpa]")
    path = tmp_path / "bench.toml"
    path.write_text(text[:begin] + 'calibration = "length.toml"\n\n' + text[end:])
    mine = load_rig(str(path))
    assert mine.calibrations["length_mm"].offset == pytest.approx(old.offset)
    (due,) = due_calibrations(mine)
    assert (due.device, due.calibration.id) == ("laser", old.id)
    plan = quick(mine, lengths_mm=(60.0,), pressures_kpa=(200.0,))
    run = open_run(run_isometric(mine, plan, tmp_path / "runs", derive=False).folder)
    assert run.calibration("length_mm").id == old.id
    wrong = path.read_text().replace('serial = "LAS-0007"', 'serial = "LAS-0008"', 1)
    path.write_text(wrong)
    with pytest.raises(ConfigError, match="of instrument LAS-0007"):
        load_rig(str(path))


def test_an_instrument_that_looks_past_the_block_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rigs.virtual.extras import Extras

    monkeypatch.setattr(Extras, "_length", lambda self, name: lambda: 62.0)
    with pytest.raises(PamrigError, match=r"change by .* mm over lengths"):
        calibrate_length(load_rig("virtual-laser"), LENGTHS, tmp_path, blocks=EXACT, seconds=0.5)
    (folder,) = tmp_path.iterdir()
    assert open_run(folder).outcome != "clean"


@pytest.mark.parametrize(
    ("rig", "lengths", "how", "words"),
    [
        ("virtual-laser", [52.0, 60.0], {}, "at least 3"),
        ("virtual-laser", [52.0, 60.0, 80.0], {}, "80 mm is outside"),
        ("virtual", LENGTHS, {}, "calibrate camera"),
        ("virtual-laser", LENGTHS, {"instrument": "balance"}, "is no instrument"),
        ("virtual-instruments", LENGTHS, {"instrument": "thermometer"}, "reads no length"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_before_the_bench_is_opened(
    rig: str, lengths: list[float], how: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=words):
        calibrate_length(load_rig(rig), lengths, tmp_path, blocks=EXACT, **how)
    assert list(tmp_path.iterdir()) == []


def test_a_stop_ends_it_and_its_record_says_so(tmp_path: Path) -> None:
    stop = StopFlag()
    stop.set("Ctrl-C")
    with pytest.raises(Stopped):
        calibrate_length(load_rig("virtual-laser"), LENGTHS, tmp_path, blocks=EXACT, stop=stop)
    (folder,) = tmp_path.iterdir()
    assert open_run(folder).outcome == "stopped"


def test_the_command_writes_the_file(tmp_path: Path) -> None:
    out = tmp_path / "length.toml"
    words = ["calibrate", "length", "--out", str(out), "--lengths-mm", "55,60,65,70"]
    words += ["--blocks", "set G-7", "--u-zero", "0.005", "--valid-days", "365", "--json"]
    words += ["--records", str(tmp_path / "records")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    about = json.loads(done.stdout)
    assert about["quantity"] == "length_mm"
    assert about["valid_days"] == 365
    assert 'reference = "set G-7"' in out.read_text()
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, ConfigError)
    assert "exists already" in str(again.exception)


@pytest.mark.campaign
def test_thirty_lasers_lie_where_they_are_stated_to(tmp_path: Path) -> None:
    """Blocks with errors of their own: seat common to all, and of each."""
    z = []
    for seed in range(1, 31):
        config = load_rig("virtual-laser", seed)
        done = calibrate_length(config, LENGTHS, tmp_path / str(seed), blocks=BLOCKS)
        z += [error_of(done, config, "laser", mm) for mm in (53.0, 62.0, 71.0)]
    size = np.abs(z)
    print(f"{len(z)}: within 2 u {np.mean(size <= 2):.3f}, rms {np.sqrt(np.mean(size**2)):.2f}")
    assert np.mean(size <= 2.0) > 0.9
