"""A record with known truth goes in; the truth must come out, as well as is claimed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.layouts.layouts import edge_lines, profile_lines
from analysis.reduction.columns import COLUMNS
from analysis.reduction.pictures import measure_stored
from analysis.reduction.points import reduce_isometric, write_table
from analysis.regression.force_lines import against_length, per_length
from analysis_bench import CALIBRATIONS, force_n, write_run
from daq.errors import RecordError
from daq.store.run import open_run

MEASURED = ("pressure_kpa", "length_mm", "force_n")


def test_truth_lies_within_the_expanded_uncertainty_as_often_as_stated(tmp_path: Path) -> None:
    inside, noise_inside = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = write_run(tmp_path, rng, (rng.uniform(54, 68),), (300.0, 500.0), ("up",))
        table = reduce_isometric(open_run(truth.folder)).table
        real = pd.DataFrame(truth.points)
        for name in MEASURED:
            wrong = (table[name] - real[name]).abs()
            inside += list(wrong <= 2 * table[f"u_{name}"])
            noise_inside += list(wrong <= 2 * table[f"u_{name}_noise"])
    assert 0.90 <= np.mean(inside) <= 0.99
    assert np.mean(noise_inside) < 0.7, "the calibration's share must not be an ornament"


def test_without_calibration_errors_the_noise_part_alone_covers(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    truth = write_run(tmp_path, rng, errors=False, lengths_mm=(55.0, 58.0, 61.0, 64.0, 67.0))
    table = reduce_isometric(open_run(truth.folder)).table
    real = pd.DataFrame(truth.points)
    for name in ("pressure_kpa", "force_n"):
        covered = ((table[name] - real[name]).abs() <= 2 * table[f"u_{name}_noise"]).mean()
        assert covered >= 0.83, name
    assert (table["length_mm"] - real["length_mm"]).abs().max() < 0.02


def test_parts_of_the_uncertainty_add_up(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (400.0,))
    table = reduce_isometric(open_run(truth.folder)).table
    for name in MEASURED:
        whole = np.hypot(table[f"u_{name}_noise"], table[f"u_{name}_cal"])
        assert table[f"u_{name}"].to_numpy() == pytest.approx(whole.to_numpy())
    assert table["u_pressure_kpa_cal"].to_numpy() == pytest.approx(
        np.hypot(0.3, 0.003 * table["pressure_kpa"])
    )


def test_columns_are_those_promised_and_rows_come_in_order(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0))
    table = reduce_isometric(open_run(truth.folder)).table
    assert list(table.columns) == list(COLUMNS)
    assert list(table["order"]) == [1, 2, 3, 4]
    assert list(table["direction"]) == ["up", "up", "down", "down"]
    assert set(table["n_samples"]) == {500}
    assert set(table["temperature_c"]) == {21.0}


def test_gradient_is_the_muscle_models_and_carries_the_calibrations_share(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(8))
    reduction = reduce_isometric(open_run(truth.folder))
    lines = per_length(reduction.table, calibrations=reduction.calibrations)
    assert [line.n for line in lines] == [6, 6, 6]
    for line in lines:
        model = force_n(1.0, line.set_length_mm)
        u = np.hypot(line.u_gradient_fit, line.u_gradient_cal)
        # The length is only known to its own calibration, and the gradient follows it.
        u = np.hypot(u, 0.0075 * 0.03)
        assert abs(line.gradient_n_per_kpa - model) <= 3 * u
        gains = np.hypot(0.003, 0.0002)
        assert line.u_gradient_cal == pytest.approx(gains * line.gradient_n_per_kpa, rel=0.02)
        assert np.isfinite(line.down_minus_up_n)
    assert against_length(lines) is not None


def test_a_run_without_points_gives_an_empty_table_and_says_why(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (), (), finish=None)
    reduction = reduce_isometric(open_run(truth.folder))
    assert len(reduction.table) == 0
    assert list(reduction.table.columns) == list(COLUMNS)
    assert "no settled points" in reduction.notes[0]
    assert "interrupted" in reduction.notes[0]
    assert per_length(reduction.table) == []


def test_an_interrupted_run_reduces_what_is_there(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0), finish=None)
    reduction = reduce_isometric(open_run(truth.folder))
    assert len(reduction.table) == 4
    assert any("interrupted" in note for note in reduction.notes)
    assert reduction.table["force_n"].notna().all()


def test_a_lost_frame_costs_a_length_and_is_named(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0))
    (frames,) = (truth.folder / "frames").iterdir()
    data = bytearray(frames.read_bytes())
    data[100] ^= 1
    frames.write_bytes(data)
    reduction = reduce_isometric(open_run(truth.folder))
    assert list(reduction.table["length_mm"].isna()) == [True, False, False, False]
    assert any("point 1, frame 0" in note and "CRC" in note for note in reduction.notes)


def test_a_region_the_pictures_do_not_have_costs_the_lengths_and_is_named(tmp_path: Path) -> None:
    """The whole run was refused as one that pamrig did not write."""
    truth = write_run(
        tmp_path, np.random.default_rng(1), (60.0,), (400.0,), ("up",),
        camera={"region": [5000, 0, 90, 90]},
    )  # fmt: skip
    reduction = reduce_isometric(open_run(truth.folder))
    assert reduction.table["length_mm"].isna().all()
    assert reduction.table["force_n"].notna().all()
    assert any("no length" in n and "outside the frame of 640 x 480" in n for n in reduction.notes)


@pytest.mark.parametrize("camera", [{}, {"region": [0, 0, 5, 40]}])
def test_a_picture_too_small_to_measure_is_an_untrusted_measurement(camera: dict[str, Any]) -> None:
    gray = np.zeros((40, 10), np.uint8)
    gap = measure_stored(gray, camera)
    assert not gap.trusted
    assert "at least 24 x 8" in gap.reason
    assert np.isnan(gap.pixels)
    assert edge_lines(gap) == profile_lines(gray, gap.region) == []


def test_the_live_length_and_the_remeasured_one_are_compared(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (400.0,), ("up",))
    run = open_run(truth.folder)
    run.events.append(
        {"kind": "length", "frame": 0, "pixels": 181.0, "u_pixels": 0.01, "trusted": True}
    )
    assert any("differs from the live value" in note for note in reduce_isometric(run).notes)


def test_a_wrong_zero_is_reported_and_not_corrected_away(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (400.0,), ("up",))
    reduction = reduce_isometric(open_run(truth.folder))  # its vented muscle reads 2 kPa
    assert any("zero before trial 1" in note for note in reduction.notes)
    assert reduction.table["pressure_kpa"][0] == pytest.approx(400.0, abs=4.0)


def test_readings_beyond_the_calibrated_range_are_named(tmp_path: Path) -> None:
    narrow = {k: c.to_dict() for k, c in CALIBRATIONS.items()}
    narrow["pressure_kpa"]["domain"] = [0.0, 300.0]
    rng = np.random.default_rng(1)
    truth = write_run(tmp_path, rng, (60.0,), (200.0, 400.0), ("up",), calibrations=narrow)
    notes = reduce_isometric(open_run(truth.folder)).notes
    assert "pressure_kpa: 1 points outside the calibrated 0 to 300 kPa" in notes


def test_the_same_record_gives_the_same_files_to_the_byte(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0))
    written = []
    for name in ("a", "b"):
        reduction = reduce_isometric(open_run(truth.folder))
        written.append([p.read_bytes() for p in write_table(reduction, tmp_path / name)])
    assert written[0] == written[1]
    back = pd.read_parquet(tmp_path / "a" / "table.parquet")
    pd.testing.assert_frame_equal(back, reduction.table)
    header = (tmp_path / "a" / "table.csv").read_text().splitlines()[0].split(",")
    assert header == list(COLUMNS)


@pytest.mark.parametrize("patch", [[], [1, 2, 3], "abcd", [1, 2, 3, True], None])
def test_a_patch_of_the_sync_light_that_is_no_box_is_refused(patch: Any) -> None:
    """Found by fuzzing: run.json of a record may hold anything."""
    gray = np.full((240, 640), 120, np.uint8)
    with pytest.raises(RecordError, match=r"camera\.sync\.patch"):
        measure_stored(gray, {"sync": {"patch": patch}})


def test_a_stream_without_columns_has_no_rows_ahead() -> None:
    from daq.record.ahead import AheadRows
    from daq.record.segments import StreamSchema

    assert len(AheadRows(None, StreamSchema("valve", {}, {}), 0, "")) == 0
