"""Zero, span and linearity: the fit's uncertainty is honest, and the file does what it says."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis.reduction.points import reduce_isometric
from analysis.regression.calibration_line import Reference, fit_line
from bench_runs import quick, run_isometric
from cli.main import app
from daq.calibration import Calibration
from daq.errors import ConfigError
from daq.interrupt import StopFlag, Stopped
from daq.store.run import Run, open_run
from rigs.calibration.force import calibrate_force
from rigs.calibration.pressure import calibrate_pressure, reference_name
from rigs.calibration.run import Calibrated, middle, up_and_down
from rigs.rigfile.calibration_file import load_calibration, write_calibration
from rigs.rigfile.config import RigConfig, load_rig

RAW = np.array([0.0, 400.0, 800.0, 1600.0, 2400.0, 1600.0, 800.0, 400.0, 0.0])
WEIGHTS = Reference("set W-3, class M1", u_gain=1e-4)


# ---- the fit --------------------------------------------------------------------------


def test_a_straight_sensor_gives_its_offset_and_scale() -> None:
    fit = fit_line(RAW, np.full(9, 0.1), -0.5 + 0.25 * RAW, Reference("exact"))
    assert (fit.offset, fit.scale) == pytest.approx((-0.5, 0.25))
    assert fit.linearity < 1e-9


def test_the_stated_uncertainty_covers_what_reference_and_noise_do() -> None:
    """1,500 calibrations drawn: 68 % and 95 % of errors within 1 and 2 u, at each of 3 values."""
    rng = np.random.default_rng(5)
    known = Reference("gauge", u_each=0.1, u_offset=0.15, u_gain=1e-3)
    values = np.array([20.0, 300.0, 580.0])
    z = []
    for _ in range(1500):
        zero, gain = rng.normal(0, known.u_offset), rng.normal(0, known.u_gain)
        noise = rng.normal(0, 0.3, 9)
        true = -0.5 + 0.25 * RAW
        said = true * (1 + gain) + zero + rng.normal(0, known.u_each, 9)
        fit = fit_line(RAW + noise, np.full(9, 0.3), said, known)
        at = fit.offset + fit.scale * (values + 0.5) / 0.25
        z.append((at - values) / np.hypot(fit.u_offset, fit.u_gain * (values - fit.offset)))
    one, two = (np.mean(np.abs(z) < k, axis=0) for k in (1.0, 2.0))
    assert (one > 0.66).all()
    assert (one < 0.85).all(), "overstated"
    assert (two > 0.95).all()


def test_a_bent_sensor_shows_in_linearity_and_in_the_uncertainty() -> None:
    bent = 0.25 * RAW + 2.0 * (RAW / 2400 - (RAW / 2400) ** 2)
    straight = fit_line(RAW, np.full(9, 0.1), 0.25 * RAW, Reference("exact"))
    fit = fit_line(RAW, np.full(9, 0.1), bent, Reference("exact"))
    assert 0.2 < fit.linearity < 0.5
    assert fit.u_offset > straight.u_offset + fit.linearity / 2


def test_readings_of_both_signs_are_covered_at_both_ends() -> None:
    raw = np.array([-1000.0, -500.0, 0.0, 2000.0, 4000.0])
    rng = np.random.default_rng(1)
    for _ in range(50):
        fit = fit_line(raw, np.full(5, 1.0), 0.01 * raw + rng.normal(0, 0.02, 5), WEIGHTS)
        assert fit.u_offset > 0
        assert np.isfinite(fit.u_gain)


@pytest.mark.parametrize(
    ("raw", "words"),
    [([1.0, 2.0], "at least 3"), ([5.0, 5.0, 5.0], "all points are equal"),
     ([1.0, np.nan, 3.0], "no reading")],
)  # fmt: skip
def test_points_that_make_no_line_are_refused(raw: list[float], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        fit_line(raw, [0.1] * len(raw), [1.0, 2.0, 3.0][: len(raw)], Reference("exact"))


def test_up_and_down_visits_every_value_from_both_sides() -> None:
    assert up_and_down([100, 0, 400]) == [0, 100, 400, 100, 0]


def test_the_middle_of_clipped_counts_is_not_pulled_by_the_clipping() -> None:
    rng = np.random.default_rng(2)
    true = 1.3
    counts = np.maximum(0, np.round(rng.normal(true, 2.0, 50_000)))
    assert abs(counts.mean() - true) > 0.2
    assert middle(counts) == pytest.approx(true, abs=0.05)


# ---- on the bench ---------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_pressure_by_the_transmitter_finds_the_sensors_own_errors(
    tmp_path: Path, seed: int
) -> None:
    config = load_rig("virtual-instruments", seed)
    from rigs.virtual.bench import VirtualBench

    bench = VirtualBench(config)  # draws the same errors as the one that is calibrated
    zero, gain = bench._errors["pressure_kpa"]
    done = calibrate_pressure(config, [0.0, 150.0, 300.0, 450.0, 600.0], tmp_path, seconds=1.0)
    c = done.file.calibration
    for kpa in (50.0, 300.0, 600.0):
        counts = (kpa * (1 + gain) + zero) * 4095 / 1000
        assert abs(float(c.apply(counts)) - kpa) < 3 * float(c.u(kpa))
    assert float(c.u(600.0)) < 0.4  # 0.1 kPa and 0.03 % of the transmitter, and the noise
    assert done.file.instrument == "VB-0004"
    assert "PT-0004" in done.file.reference
    record = open_run(done.folder)
    assert record.outcome == "clean"
    assert sum(e["kind"] == "calibration_point" for e in record.events) == len(done.points)
    assert any(e["kind"] == "vented" and e["confirmed"] for e in record.events)


def test_pressure_by_a_gauge_that_the_operator_reads(tmp_path: Path) -> None:
    gauge = Reference("gauge G-12", u_each=0.2, u_offset=0.1, u_gain=5e-4)
    config = load_rig("virtual")
    done = calibrate_pressure(config, [0, 200, 400, 600], tmp_path, reference=gauge, seconds=1.0)
    assert done.file.reference == "gauge G-12"
    assert done.file.calibration.u_gain > 5e-4


@pytest.mark.parametrize("source", ["balance", "load_cell"])
def test_force_by_dead_weights(tmp_path: Path, source: str) -> None:
    config = dataclasses.replace(load_rig("virtual-instruments", 3), force_source=source)
    done = calibrate_force(config, [0, 1, 2, 5, 8], tmp_path, weights=WEIGHTS)
    c = done.file.calibration
    nominal = -9.80665e-3 if source == "balance" else 9.80665
    assert c.raw_unit == ("g" if source == "balance" else "kg")
    assert c.scale == pytest.approx(nominal, rel=0.01)
    assert c.domain == pytest.approx((0.0, 8 * 9.80665))
    # The sensor's own gain error is found within what the calibration says it leaves open.
    true_gain = abs(nominal / c.scale) - 1
    limit = 3 * np.hypot(c.u_gain, 3e-3 if source == "load_cell" else 2e-4)
    assert abs(true_gain) < limit
    assert len(done.points) == 9
    if source == "balance":  # each tare leaves 0.05 N (1 sd): a test begins with one
        assert 0.015 < c.u_offset < 0.12
        assert abs(c.offset) < 3 * c.u_offset


def test_a_stop_ends_a_calibration_and_its_record_says_so(tmp_path: Path) -> None:
    stop = StopFlag()
    stop.set("Ctrl-C")
    with pytest.raises(Stopped):
        calibrate_pressure(load_rig("virtual-instruments"), [0, 200, 400], tmp_path, stop=stop)
    (folder,) = tmp_path.iterdir()
    assert open_run(folder).outcome == "stopped"


@pytest.mark.parametrize(
    ("pressures", "words"),
    [([0, 700, 800], "700 kPa is outside 0 to 650"), ([100, 100, 200], "at least 3")],
)
def test_pressures_that_cannot_be_made_are_refused(
    tmp_path: Path, pressures: list[float], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        calibrate_pressure(load_rig("virtual-instruments"), pressures, tmp_path)


def test_without_a_reference_there_is_no_calibration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="pressure_transmitter"):
        calibrate_pressure(load_rig("virtual"), [0, 200, 400], tmp_path)


@pytest.mark.parametrize(
    ("command", "option", "value"),
    [
        ("pressure", "--u-each", "-1"),
        ("pressure", "--u-zero", "nan"),
        ("pressure", "--u-gain", "inf"),
        ("force", "--u-each", "-0.1"),
        ("force", "--u-gain", "10"),
    ],
)
def test_an_uncertainty_that_is_none_is_refused_before_anything_is_loaded(
    tmp_path: Path, command: str, option: str, value: str
) -> None:
    """It told itself, if at all, after the last weight: an hour of work for a typing slip."""
    words = ["calibrate", command, "--out", str(tmp_path / "new.toml"), option, value]
    words += ["--gauge", "G-12"] if command == "pressure" else []
    words += ["--records", str(tmp_path / "records")]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, ConfigError), done.output
    assert str(done.exception).startswith(f"{option}: ")
    assert list(tmp_path.iterdir()) == []


def test_a_rig_without_a_force_sensor_is_refused(tmp_path: Path) -> None:
    """`calibrate force --rig virtual-joint` waited for readings for ever."""
    with pytest.raises(ConfigError, match="has no balance and no load cell to calibrate"):
        calibrate_force(load_rig("virtual-joint"), [0, 1, 2], tmp_path, weights=WEIGHTS)


def test_weights_beyond_the_limit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"30 kg is outside 0 to 20.39 kg .*limits.force_n = 200 N"
    ):
        calibrate_force(load_rig("virtual"), [0, 10, 30], tmp_path, weights=WEIGHTS)


# ---- the file -------------------------------------------------------------------------


def named(folder: Path, file: str, rig: str = "virtual-instruments") -> str:
    """A rig file whose pressure calibration is a file beside it."""
    text = load_rig(rig).text
    at = text.index("[calibrations.pressure_kpa]")
    end = text.index("\n[", at)
    table = f'[calibrations.pressure_kpa]\ncalibration = "{file}"\n'
    path = folder / "mine.toml"
    path.write_text(text[:at] + table + text[end:])
    return str(path)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    """The pressure sensor, calibrated to 300 kPa."""
    folder = tmp_path_factory.mktemp("calibrated")
    config = load_rig("virtual-instruments")
    return calibrate_pressure(config, [0, 100, 200, 300], folder, seconds=0.5)


@pytest.fixture(scope="module")
def used(calibrated: Calibrated, tmp_path_factory: pytest.TempPathFactory) -> tuple[RigConfig, Run]:
    """A rig with this calibration, and a run on it at 200 and at 500 kPa."""
    folder = tmp_path_factory.mktemp("used")
    write_calibration(folder / "p.toml", calibrated.file, calibrated.points)
    config = load_rig(named(folder, "p.toml"))
    plan = quick(config, lengths_mm=(60.0,), pressures_kpa=(200.0, 500.0))
    return config, open_run(run_isometric(config, plan, folder / "runs", derive=False).folder)


def test_a_rig_file_names_it_and_a_run_freezes_it(
    calibrated: Calibrated, used: tuple[RigConfig, Run]
) -> None:
    done, (config, run) = calibrated, used
    assert config.calibrations["pressure_kpa"] == done.file.calibration.__class__(
        **{**vars(done.file.calibration), "u_offset": config.calibrations["pressure_kpa"].u_offset,
           "u_gain": config.calibrations["pressure_kpa"].u_gain}
    )  # fmt: skip
    assert config.calibrations["pressure_kpa"].u_offset == pytest.approx(
        done.file.calibration.u_offset, rel=1e-5
    )
    frozen = run.calibration("pressure_kpa")
    assert frozen == config.calibrations["pressure_kpa"]
    assert frozen.id.startswith("P-VB-0004-")


def test_a_measurement_outside_its_domain_says_so(used: tuple[RigConfig, Run]) -> None:
    notes = reduce_isometric(used[1]).notes
    assert any("pressure_kpa: 2 points outside the calibrated" in note for note in notes), notes


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("quantity = \"pressure_kpa\"", "quantity = \"force_n\""), "calibrates force_n, not"),
        (("raw_unit = \"count\"", "raw_unit = \"volt\""), "raw_unit"),
        (("instrument = \"VB-0004\"", "instrument = \"VB-0009\""), "is of instrument VB-0009"),
        (("linearity", "linearitie"), "linearitie: unknown key"),
        (("u_gain = ", "u_gain = -"), "u_gain"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_belong_here_is_refused(
    calibrated: Calibrated, tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    write_calibration(tmp_path / "p.toml", calibrated.file, calibrated.points)
    text = (tmp_path / "p.toml").read_text()
    assert change[0] in text
    (tmp_path / "p.toml").write_text(text.replace(*change))
    with pytest.raises(ConfigError, match=words):
        load_rig(named(tmp_path, "p.toml"))


def test_a_file_is_not_overwritten_unasked(calibrated: Calibrated, tmp_path: Path) -> None:
    path, file = tmp_path / "p.toml", calibrated.file
    write_calibration(path, file, calibrated.points)
    with pytest.raises(ConfigError, match="exists already"):
        write_calibration(path, file, calibrated.points)
    back = load_calibration(str(path), "rig", "pressure_kpa", file.calibration.raw_unit)
    assert back.reference == file.reference


def test_a_sensor_without_serial_number_leaves_the_key_open(
    calibrated: Calibrated, tmp_path: Path
) -> None:
    path, file = tmp_path / "p.toml", dataclasses.replace(calibrated.file, instrument="")
    write_calibration(path, file, calibrated.points)
    assert "instrument" not in tomllib.loads(path.read_text())
    assert "# instrument = " in path.read_text()
    back = load_calibration(str(path), "rig", "pressure_kpa", serial="VB-0004")
    assert back.instrument == ""


@pytest.mark.parametrize(
    ("serial", "certificate", "date", "name"),
    [
        ("PT-1", "P-7", "2026-01-12", "pressure_transmitter PT-1 (P-7 2026-01-12)"),
        ("PT-1", "as the manufacturer states", "",
         "pressure_transmitter PT-1 (as the manufacturer states)"),
        ("", "", "", "pressure_transmitter"),
    ],
)  # fmt: skip
def test_a_transmitter_as_reference_is_named_without_stray_blanks(
    serial: str, certificate: str, date: str, name: str
) -> None:
    line = Calibration("pressure_kpa", "kPa", "kPa", 0.0, 1.0, id=certificate, date=date)
    assert reference_name(serial, line) == name
