"""What may be imported, and what is refused with a message that a person can act on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.formats.importer import import_points, import_thesis
from analysis.models.points import run_points
from analysis.reduction.points import reduce_isometric
from analysis.regression.force_lines import per_length
from daq.clock import VirtualClock
from daq.errors import PamrigError
from daq.store.run import open_run
from daq.store.verify import verify

GOOD = "pressure_kpa,length_mm,force_n\n200,60,5.5\n400,60,16.25\n600,60,27\n"


def imported(tmp_path: Path, text: str, name: str = "points.csv") -> pd.DataFrame:
    path = tmp_path / name
    path.write_text(text)
    return reduce_isometric(open_run(import_points(path, tmp_path / "runs", VirtualClock()))).table


def refused(tmp_path: Path, text: str | bytes, name: str = "points.csv") -> str:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(PamrigError) as error:
        import_points(path, tmp_path / "runs", VirtualClock())
    assert not (tmp_path / "runs").exists(), "a refused file must leave no run behind"
    assert error.value.remedy
    return str(error.value)


def test_a_plain_csv_becomes_a_sound_run(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(GOOD)
    run = open_run(import_points(path, tmp_path / "runs", VirtualClock()))
    assert run.outcome == "clean"
    assert verify(run) == []
    assert len(run.manifest["source"]["files"][0]["sha256"]) == 64
    table = reduce_isometric(run).table
    assert list(table["force_n"]) == [5.5, 16.25, 27.0]
    assert table["u_force_n"].isna().all()
    assert table["temperature_c"].isna().all()
    (line,) = per_length(table)
    assert line.gradient_n_per_kpa == pytest.approx(0.05375)


def test_all_the_columns_of_the_exchange_form_arrive(tmp_path: Path) -> None:
    table = imported(
        tmp_path,
        "trial,slot,replicate,mounting,order,direction,pressure_kpa,length_mm,temperature_c,force_n,"
        "u_force_n,remark\n"
        "a,L60,2,m1,2,down,200,60,21,5.5,0.05,x\na,L60,1,m1,1,up,200,60,21.5,5.4,,y\n",
    )
    assert list(table["order"]) == [1, 2]
    assert list(table["direction"]) == ["up", "down"]
    assert list(table["repeat"]) == [1, 2]
    assert list(table["trial"]) == ["a", "a"]
    assert np.isnan(table["u_force_n"][0])
    assert table["u_force_n"][1] == 0.05


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_an_exchange_folder_takes_the_held_length_from_its_trials(
    tmp_path: Path, suffix: str
) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    (folder / "trials.csv").write_text("trial,slot,held_length_mm,temperature_c\n1,L60,60,22\n")
    samples = pd.DataFrame(
        {"trial": ["1", "1"], "pressure_kpa": [200, 400], "force_n": [5.5, 16.2]}
    )
    if suffix == "csv":
        samples.to_csv(folder / "samples.csv", index=False)
    else:
        samples.to_parquet(folder / "samples.parquet")
    table = reduce_isometric(
        open_run(import_points(folder, tmp_path / "runs", VirtualClock()))
    ).table
    assert list(table["length_mm"]) == [60.0, 60.0]
    assert list(table["temperature_c"]) == [22.0, 22.0]
    assert list(table["slot"]) == ["L60", "L60"]


H = "pressure_kpa,length_mm,force_n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["points.csv", "empty"]),
        (f"{H}\n", ["points.csv", "no rows"]),
        (
            "pressure_bar,length_mm,force_n\n2,60,5\n",
            ["column pressure_bar", "another unit", "pressure_kpa", "1 bar = 100 kPa"],
        ),
        (
            "pressure_kpa,length_cm,force_n\n200,6,5\n",
            ["column length_cm", "length_mm", "1 cm = 10 mm"],
        ),
        ("pressure_kpa,length_mm,force_kg\n200,60,5\n", ["column force_kg", "force_n", "9.80665"]),
        (f"{H},temperature_k\n200,60,5,294\n", ["column temperature_k", "temperature_c", "273.15"]),
        ("Pressure [psi],length_mm,force_n\n20,60,5\n", ["column Pressure [psi]", "6.89476"]),
        ("pressure,length_mm,force_n\n200,60,5\n", ["column pressure", "no unit", "pressure_kpa"]),
        (
            "pressure_kpa,lenght_mm,force_n\n200,60,5\n",
            ["column length_mm", "missing", "lenght_mm"],
        ),
        ("pressure_kpa,length_mm\n200,60\n", ["column force_n", "missing"]),
        (f"{H}\n200000,60,5\n", ["row 2 column pressure_kpa", "200000", "0 to 1000 kpa", "unit"]),
        (f"{H}\n200,0.06,5\n", ["row 2 column length_mm", "0.06", "unit"]),
        (f"{H}\n200,60,5\n300,60,55000\n", ["row 3 column force_n", "55000"]),
        (f"{H},slack\n200,60,5,maybe\n", ["row 2 column slack", "true or false", "'maybe'"]),
        (f"{H}\n-200,60,5\n", ["row 2 column pressure_kpa", "-200"]),
        (f"{H}\n200,60,five\n", ["row 2 column force_n", "expected a number", "'five'"]),
        (f"{H}\n200,60,inf\n", ["row 2 column force_n", "finite"]),
        (f"{H}\n200,60,5\n200,60,5\n", ["row 3", "same as row 2", "repeat"]),
        (f"{H}\n200,60\n", ["row 2", "2 cells", "3"]),
        (f"{H}\n200,60,5,5\n", ["row 2", "4 cells", "decimal"]),
        ("pressure_kpa;length_mm;force_n\n200;60;5\n", ["row 1", "commas"]),
        (f"{H},force_n\n200,60,5,5\n", ["column force_n", "occurs twice"]),
        (f"time_s,{H}\n0.1,200,60,5\n", ["column time_s", "time series", "settled"]),
        (f"{H},direction\n200,60,5,left\n", ["row 2 column direction", "'left'", "up, down"]),
        (f"{H},order\n200,60,5,first\n", ["row 2 column order", "whole number"]),
        (f"{H},u_force_n\n200,60,5,-1\n", ["row 2 column u_force_n", "negative"]),
        (f"{H}\n300,60,\n200,60,\n", ["none of its 2 rows"]),
        (f"{H}\n1_000,60,5\n", ["row 2 column pressure_kpa", "'1_000'"]),
        (b"pressure_kpa,length_mm,force_n\n200,60,\xff\xfe\n", ["UTF-8"]),
    ],
)
def test_a_bad_csv_is_refused_with_file_row_column_and_remedy(
    tmp_path: Path, text: str | bytes, said: list[str]
) -> None:
    message = refused(tmp_path, text)
    assert "points.csv" in message
    for words in said:
        assert words in message


def test_rows_that_are_no_point_are_left_out_and_said(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(GOOD + "500,60,\n")
    run = open_run(import_points(path, tmp_path / "runs", VirtualClock()))
    reduction = reduce_isometric(run)
    assert len(reduction.table) == 3
    assert any("row 5" in note for note in reduction.notes)


def test_values_somewhat_outside_the_sensor_are_noted_not_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"{H}\n1200,60,70\n")
    reduction = reduce_isometric(open_run(import_points(path, tmp_path / "runs", VirtualClock())))
    assert any("pressure_kpa: 1 values outside" in note for note in reduction.notes)


def test_the_advised_column_repeat_is_kept_beside_the_replicate_of_the_trial(
    tmp_path: Path,
) -> None:
    """The refusal of equal rows advises `repeat`; the dataset format has a `replicate` as well."""
    folder = tmp_path / "set"
    folder.mkdir()
    (folder / "trials.csv").write_text("trial,replicate\na,1\n")
    (folder / "samples.csv").write_text(f"trial,{H}\na,200,60,5\na,200,60,5\n")
    with pytest.raises(PamrigError, match="named repeat"):
        import_points(folder, tmp_path / "runs", VirtualClock())
    (folder / "samples.csv").write_text(f"trial,repeat,{H}\na,1,200,60,5\na,2,200,60,5\n")
    run = open_run(import_points(folder, tmp_path / "runs", VirtualClock()))
    assert list(reduce_isometric(run).table["repeat"]) == [1, 2]


def test_slack_points_are_listed_and_are_no_measurement(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"{H},slack\n200,60,5,false\n200,50,0,true\n300,60,8,\n300,50,0,1\n")
    run = open_run(import_points(path, tmp_path / "runs", VirtualClock()))
    reduction = reduce_isometric(run)
    assert list(reduction.table["force_n"]) == [5.0, 8.0]
    assert [row["order"] for row in reduction.excluded] == [2, 4]
    assert all("slack" in row["reason"] for row in reduction.excluded)
    assert any("2 points are slack" in note for note in reduction.notes)
    assert list(run_points(run).force_n) == [5.0, 8.0]


def test_a_large_industrial_muscle_is_imported(tmp_path: Path) -> None:
    table = imported(tmp_path, f"{H}\n600,300,1460.1\n600,296,5900\n")
    assert list(table["force_n"]) == [1460.1, 5900.0]


@pytest.mark.parametrize(
    ("trials", "samples", "said"),
    [
        ("trial\na\n", f"trial,{H}\nb,200,60,5\n", ["samples.csv row 2 column trial", "'b'"]),
        ("trial\na\na\n", f"trial,{H}\na,200,60,5\n", ["trials.csv row 3", "occurs twice"]),
        ("trial,held_length_cm\na,6\n", f"trial,{H}\na,200,60,5\n", ["column held_length_cm"]),
        (None, f"trial,{H}\na,200,60,5\n", ["no trials.csv"]),
        ("trial\na\n", None, ["no samples.csv"]),
    ],
)
def test_a_bad_exchange_folder_is_refused(
    tmp_path: Path, trials: str | None, samples: str | None, said: list[str]
) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    for name, text in (("trials.csv", trials), ("samples.csv", samples)):
        if text is not None:
            (folder / name).write_text(text)
    with pytest.raises(PamrigError) as error:
        import_points(folder, tmp_path / "runs", VirtualClock())
    for words in said:
        assert words in str(error.value)


def test_a_parquet_of_the_wrong_type_is_refused_like_a_csv(tmp_path: Path) -> None:
    path = tmp_path / "points.parquet"
    pd.DataFrame({"pressure_kpa": [True], "length_mm": [60.0], "force_n": [5.0]}).to_parquet(path)
    with pytest.raises(PamrigError, match="row 1 column pressure_kpa: expected a number"):
        import_points(path, tmp_path / "runs", VirtualClock())
    path.write_bytes(b"PAR1 is not enough")
    with pytest.raises(PamrigError, match=r"points\.parquet: is not a Parquet file"):
        import_points(path, tmp_path / "runs", VirtualClock())


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PamrigError, match=r"nowhere\.csv"):
        import_points(tmp_path / "nowhere.csv", tmp_path, VirtualClock())


def test_only_the_measured_column_of_c01_is_taken_by_default(tmp_path: Path) -> None:
    run = open_run(import_thesis("c01", tmp_path, VirtualClock()))
    table = reduce_isometric(run).table
    assert len(table) == 14 * 16
    assert set(table["temperature_c"]) == {21.0}
    assert table["length_mm"].min() == 51.45
    assert any("formula" in note for note in run.manifest["notes"])
    assert table["u_pressure_kpa"][0] == pytest.approx(5 / 3**0.5)


def test_warm_columns_come_only_when_asked_for_and_are_labelled(tmp_path: Path) -> None:
    run = open_run(import_thesis("c01", tmp_path, VirtualClock(), include_formula=True))
    assert len(reduce_isometric(run).table) == 7 * 14 * 16
    assert any("formula, not measured" in label for label in run.manifest["labels"])


def test_c02_is_labelled_as_no_independent_evidence(tmp_path: Path) -> None:
    run = open_run(import_thesis("C-2", tmp_path, VirtualClock()))
    assert run.manifest["labels"] == ["C-1 plus noise"]
    assert any("no independent test" in note for note in reduce_isometric(run).notes)


def test_hysteresis_table_keeps_its_directions_and_cycles_apart(tmp_path: Path) -> None:
    table = reduce_isometric(open_run(import_thesis("c04", tmp_path, VirtualClock()))).table
    assert set(table["direction"]) == {"up", "down"}
    assert table["slot"].nunique() == table["trial"].nunique() == 8


def test_an_unknown_thesis_table_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(PamrigError, match="c01, c02, c03, c04"):
        import_thesis("d06", tmp_path, VirtualClock())
