"""Runs as a collection, calibrations, and what is derived from a record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from daq.calibration import Calibration
from daq.clock import VirtualClock
from daq.errors import ConfigError, RecordError
from daq.link.clockfit import ClockFit
from daq.record.writer import RecordWriter
from daq.store.derive import derive
from daq.store.run import Run, open_run
from daq.store.store import find_run, list_runs, show
from daq.store.verify import verify
from daq_records import FORCE, MANIFEST, PRESSURE, begin, fill, valve_batch


def finished(root: Path, **summary: Any) -> Run:
    writer, clock = begin(root)
    fill(writer, clock)
    writer.finalize("clean", **summary)
    return open_run(writer.folder)


def clock_fit() -> dict[str, Any]:
    """Device time 5 s ahead at the run's start at 9 s, same rate."""
    fit = ClockFit()
    for k in range(20):
        now_ns = 9_000_000_000 + k * 500_000_000
        fit.add(now_ns, now_ns, 5_000_000 + k * 500_000)
    return fit.final().as_dict()


# -- derived samples ---------------------------------------------------------


def test_samples_in_engineering_units_follow_the_calibrations(tmp_path: Path) -> None:
    run = finished(tmp_path, clock_fit={"valve": clock_fit()})
    folder = derive(run)
    table = pd.read_parquet(folder / "samples.parquet")
    raw = valve_batch(0, 600)
    assert list(table.columns) == [
        "time_s",
        "seq",
        "boot",
        "pressure_kpa",
        "flags",
        "inlet_cmd",
        "outlet_cmd",
        "setpoint_kpa",
    ]
    np.testing.assert_allclose(table["time_s"], np.arange(600) * 1e-3, atol=2e-6)
    np.testing.assert_allclose(table["pressure_kpa"], -100 + 0.25 * raw["counts"])
    np.testing.assert_allclose(table["setpoint_kpa"], -100 + 0.25 * raw["setpoint_x16"] / 16)
    np.testing.assert_allclose(table["inlet_cmd"], raw["inlet_u5"] / 200)
    balance = pd.read_parquet(folder / "balance.parquet")
    np.testing.assert_allclose(balance["force_n"], (100.25 + np.arange(12)) * 9.81e-3)
    assert balance["stable"].tolist() == [0, 1] * 6


def test_units_and_run_id_stand_in_the_file(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    run = finished(tmp_path)
    schema = pq.read_schema(derive(run) / "samples.parquet")
    assert schema.field("pressure_kpa").metadata[b"unit"] == b"kPa"
    assert schema.field("time_s").metadata[b"unit"] == b"s"
    assert schema.metadata[b"pamrig.run_id"].decode() == run.run_id


def test_a_rebuild_gives_equal_content(tmp_path: Path) -> None:
    run = finished(tmp_path)

    def contents() -> dict[str, bytes]:
        return {p.name: p.read_bytes() for p in derive(run).iterdir()}

    first = contents()
    assert contents() == first
    (run.folder / "derived" / "samples.parquet").unlink()
    assert contents() == first
    assert verify(run) == []


def test_without_a_clock_fit_samples_have_their_time_of_arrival(tmp_path: Path) -> None:
    run = finished(tmp_path)
    table = pd.read_parquet(derive(run) / "samples.parquet")
    expected = (valve_batch(0, 600)["host_ns"] - 9_000_000_000) * 1e-9
    np.testing.assert_allclose(table["time_s"], expected)


def test_an_interrupted_run_uses_the_last_clock_fit_it_wrote(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock, 2)
    writer.event("clockfit", device="valve", **clock_fit())
    writer.abandon()
    table = pd.read_parquet(derive(open_run(writer.folder)) / "samples.parquet")
    np.testing.assert_allclose(table["time_s"], np.arange(100) * 1e-3, atol=2e-6)


def test_samples_after_a_reboot_are_not_put_through_the_old_boot_s_fit(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.append("valve", valve_batch(0))
    after = {**valve_batch(50, 10), "boot": np.full(10, 8, np.uint16), "device_us": np.arange(10)}
    writer.append("valve", after)
    writer.finalize("faulted", clock_fit={"valve": clock_fit()})
    table = pd.read_parquet(derive(open_run(writer.folder)) / "samples.parquet")
    arrival = (valve_batch(50, 10)["host_ns"] - 9_000_000_000) * 1e-9
    np.testing.assert_allclose(table["time_s"][50:], arrival)
    np.testing.assert_allclose(table["time_s"][:50], np.arange(50) * 1e-3, atol=2e-6)


def test_without_a_calibration_counts_stay_counts(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path, {"protocol": "p"}, VirtualClock(), False, False)
    writer.stream("valve", {"seq": "int64", "counts": "uint16"}, {"counts": "counts"})
    writer.append("valve", {"seq": np.arange(3), "counts": np.arange(3, dtype=np.uint16)})
    writer.finalize("clean")
    run = open_run(writer.folder)
    assert pd.read_parquet(derive(run) / "samples.parquet")["counts"].tolist() == [0, 1, 2]
    with pytest.raises(RecordError, match="no calibration of pressure_kpa; there: none"):
        run.calibration("pressure_kpa")


def test_a_stream_that_is_in_units_already_passes_through(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path, {"protocol": "import"}, VirtualClock(), False, False)
    writer.stream("points", {"pressure_kpa": "float64", "force_n": "float64"})
    writer.append("points", {"pressure_kpa": np.array([1.0]), "force_n": np.array([2.0])})
    writer.finalize("clean")
    table = pd.read_parquet(derive(open_run(writer.folder)) / "points.parquet")
    assert table.to_dict("list") == {"pressure_kpa": [1.0], "force_n": [2.0]}


def test_a_stream_without_rows_gives_a_table_without_rows(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.finalize("aborted")
    table = pd.read_parquet(derive(open_run(writer.folder)) / "samples.parquet")
    assert len(table) == 0
    assert "pressure_kpa" in table.columns


def test_makers_from_above_add_files_and_a_failing_one_leaves_the_old_ones(tmp_path: Path) -> None:
    run = finished(tmp_path)

    def table(run: Run, folder: Path) -> None:
        pd.DataFrame({"pressure_kpa": [100.0], "force_n": [5.5]}).to_parquet(
            folder / "table.parquet"
        )

    def broken(run: Run, folder: Path) -> None:
        (folder / "half").write_text("x")
        raise RuntimeError("no")

    with pytest.raises(RecordError, match="runs rebuild"):
        _ = run.table
    derive(run, [table])
    assert run.table.to_dict("list") == {"pressure_kpa": [100.0], "force_n": [5.5]}
    with pytest.raises(RuntimeError):
        derive(run, [broken])
    assert run.table["force_n"].tolist() == [5.5]
    assert verify(run) == []


def test_a_table_nobody_vouches_for_is_not_read(tmp_path: Path) -> None:
    run = finished(tmp_path)
    derive(run)
    (run.folder / "derived" / "table.csv").write_text("force_n\n1\n")
    with pytest.raises(RecordError, match="not listed"):
        _ = run.table


# -- the collection ----------------------------------------------------------


def test_runs_are_listed_oldest_first_with_their_outcome(tmp_path: Path) -> None:
    assert list_runs(tmp_path / "none") == []
    run = finished(tmp_path)
    writer, _ = begin(tmp_path)
    writer.abandon()
    (tmp_path / "not a run").mkdir()
    infos = {i.run_id: i for i in list_runs(tmp_path)}
    assert set(infos) == {run.run_id, writer.run_id}
    assert infos[run.run_id].outcome == "clean"
    assert infos[run.run_id].duration_s == pytest.approx(0.6)
    assert infos[writer.run_id].outcome == "interrupted"
    assert infos[writer.run_id].duration_s is None
    assert infos[run.run_id].as_dict()["specimen"] == "muscle 7"


def test_a_run_is_found_by_path_by_name_and_by_a_part_that_is_its_own(tmp_path: Path) -> None:
    run = finished(tmp_path)
    other = finished(tmp_path)
    tag = run.run_id[-6:]
    for text in (str(run.folder), str(run.folder / "run.json"), run.run_id, tag):
        assert find_run(tmp_path, text).run_id == run.run_id
    assert find_run(tmp_path, "last").run_id == max(run.run_id, other.run_id)
    with pytest.raises(RecordError, match="2 runs match"):
        find_run(tmp_path, "isometric")
    with pytest.raises(RecordError, match="no run named"):
        find_run(tmp_path, "xyzzy")
    with pytest.raises(RecordError, match=r"there are no runs in .*choose the folder of your runs"):
        find_run(tmp_path / "other", "last")


def test_show_tells_what_a_run_holds(tmp_path: Path) -> None:
    shown = show(finished(tmp_path, gaps={"valve": 3}))
    assert shown["streams"]["valve"]["rows"] == 600
    assert shown["events"] == {"state": 12}
    assert shown["frames"] == 12
    assert shown["final"]["gaps"] == {"valve": 3}
    assert shown["calibrations"] == [PRESSURE.to_dict(), FORCE.to_dict()]
    assert shown["problems"] == []


# -- calibrations ------------------------------------------------------------


def test_a_calibration_applies_inverts_and_states_its_uncertainty() -> None:
    assert PRESSURE.apply([400, 800]).tolist() == [0.0, 100.0]
    assert PRESSURE.raw(PRESSURE.apply([123.0])).tolist() == pytest.approx([123.0])
    # 200 kPa is 300 above the offset: 0.6 from the gain, 0.5 from the offset.
    assert float(PRESSURE.u(200.0)) == pytest.approx((0.5**2 + 0.6**2) ** 0.5)
    outside = PRESSURE.outside([-5.0, -1.0, 0.0, 700.0, 701.0, 710.0]).tolist()
    assert outside == [True, False, False, False, False, True], "not within its uncertainty"
    assert FORCE.outside([1e9]).tolist() == [False]


def test_a_calibration_survives_json() -> None:
    for calibration in (PRESSURE, FORCE):
        assert Calibration.from_dict(calibration.to_dict()) == calibration


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"scale": 0}, "scale other than 0"),
        ({"scale": float("nan")}, "finite"),
        ({"u_gain": -0.1}, "negative"),
        ({"domain": [5, 5]}, "empty"),
        ({"offset": "abc"}, "not a number"),
        ({"gain": 1}, "unknown key gain"),
        ({"unit": None}, "missing key unit"),
        ({"unit": {"a": 5}}, "unit: expected text"),
        ({"quantity": ["pressure_kpa"]}, "quantity: expected text"),
    ],
)
def test_an_impossible_calibration_is_refused_with_its_reason(
    change: dict[str, Any], what: str
) -> None:
    given = {**PRESSURE.to_dict(), **change}
    given = {k: v for k, v in given.items() if v is not None}
    with pytest.raises(ConfigError, match=what):
        Calibration.from_dict(given)


def test_the_manifest_keeps_a_whole_copy_of_its_calibrations(tmp_path: Path) -> None:
    assert finished(tmp_path).manifest["calibrations"] == MANIFEST["calibrations"]
