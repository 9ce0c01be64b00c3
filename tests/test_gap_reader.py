"""Data from elsewhere: what is read, and what is refused by file, row and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem
from gap.selection.candidate_fits import linear_gains
from gap_sets import settled_set

TRIALS = (
    "trial,slot,replicate,protocol,mounting,order,held_length_mm\n"
    "a,s,1,step,m,1,60\nb,s,2,step,m,2,60\n"
)
SAMPLES = "trial,time_s,pressure_kpa,force_n,inlet_cmd\n" + "".join(
    f"{name},{k / 10},{k},{'' if k % 2 else k / 2},{1 if k == 0 else ''}\n"
    for name in "ab"
    for k in range(8)
)


def folder(tmp_path: Path, trials: str = TRIALS, samples: str = SAMPLES, bench: str = "") -> Path:
    (tmp_path / "trials.csv").write_text(trials)
    (tmp_path / "samples.csv").write_text(samples)
    if bench:
        (tmp_path / "bench.toml").write_text(bench)
    return tmp_path


def test_channels_at_their_own_rates_share_rows(tmp_path: Path) -> None:
    data = read_dataset(folder(tmp_path, bench="supply_kpa = 600\n"))
    assert [trial.name for trial in data.trials] == ["a", "b"]
    assert len(data.trials[0]["pressure_kpa"]) == 8
    assert data.trials[0]["force_n"].time_s.tolist() == [0.0, 0.2, 0.4, 0.6]
    assert data.constants.supply_pa == 600e3
    assert data.slots == {"s": [0, 1]}


def test_missing_columns_are_no_error(tmp_path: Path) -> None:
    data = read_dataset(folder(tmp_path, "trial\na\nb\n", "trial,pressure_kpa\na,1\nb,2\n"))
    assert data.settled
    assert data.trials[0].slot == "a"
    assert np.isnan(data.trials[0].held_length_mm)


@pytest.mark.parametrize("trials", ["trial,order\na,\nb,\n", "trial\na\nb\n"])
def test_rows_are_no_order_where_the_file_states_none(tmp_path: Path, trials: str) -> None:
    data = read_dataset(folder(tmp_path, trials, "trial,pressure_kpa\na,1\nb,2\n"))
    assert np.isnan([trial.order for trial in data.trials]).all()
    assert any("order of the trials is not known" in note for note in data.notes)


def test_a_last_number_that_may_be_cut_short_is_noted(tmp_path: Path) -> None:
    samples = "trial,time_s,pressure_kpa\na,0,120.5\na,1,12"
    (note,) = read_dataset(folder(tmp_path, "trial\na\n", samples)).notes
    assert note == "samples.csv: row 3 has no end of line; was its last value cut short?"
    assert not read_dataset(folder(tmp_path, "trial\na\n", samples + "1.25\r\n")).notes


def test_numbered_trials_in_parquet_meet_their_rows(tmp_path: Path) -> None:
    (tmp_path / "trials.csv").write_text("trial\n1\n2\n")
    table = pd.DataFrame(
        {"trial": [1, 1, 2], "time_s": [0.0, 1.0, 0.0], "force_n": [1.0, 2.0, 3.0]}
    )
    table.to_parquet(tmp_path / "samples.parquet")
    assert [len(trial["force_n"]) for trial in read_dataset(tmp_path).trials] == [2, 1]


P = "row 5, column pressure_kpa"
T = "row 5, column time_s"


def _with(old: str, new: str) -> str:
    assert old in SAMPLES
    return SAMPLES.replace(old, new)


BAD = {
    # What is wrong: trials.csv, samples.csv, and what the message must name.
    "another unit": (TRIALS, _with("pressure_kpa", "pressure_bar"), "column pressure_bar"),
    "outside the sensor": (TRIALS, _with("a,0.3,3,", "a,0.3,300000,"), P),
    "a word for a number": (TRIALS, _with("a,0.3,3,", "a,0.3,three,"), P),
    "time runs backwards": (TRIALS, _with("a,0.3,", "a,0.05,"), T),
    "twice the same time": (TRIALS, _with("a,0.3,", "a,0.2,"), T),
    "unknown trial": (TRIALS, _with("b,0.0", "c,0.0"), "row 10, column trial"),
    "empty samples": (TRIALS, "", "samples.csv"),
    "no rows": (TRIALS, SAMPLES.splitlines()[0] + "\n", "samples.csv"),
    "a trial twice": (TRIALS + "a,s,3,step,m,3,60\n", SAMPLES, "row 4, column trial"),
    "command that is neither": (TRIALS, _with("a,0.0,0,0.0,1", "a,0.0,0,0.0,0.5"), "inlet_cmd"),
    "no trial column": (TRIALS, _with("trial,", "try,"), "column trial"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_data_is_refused_by_file_row_and_column(case: str, tmp_path: Path) -> None:
    trials, samples, where = BAD[case]
    with pytest.raises(GapError) as caught:
        read_dataset(folder(tmp_path, trials, samples))
    assert where in str(caught.value)
    assert ".csv" in str(caught.value)


TABLE = "trial,pressure_kpa,force_n,taken_s\na,100,5,2\na,200,15,{}\na,300,25,30\n"


@pytest.mark.parametrize(
    ("second", "where"), [("30", "row 4, column taken_s"), ("-1", "row 3, column taken_s")]
)
def test_when_a_settled_point_was_read_is_one_time_from_0_on(
    second: str, where: str, tmp_path: Path
) -> None:
    trials = "trial,slot,held_length_mm\na,s,60\n"
    with pytest.raises(GapError, match=where):
        read_dataset(folder(tmp_path, trials, TABLE.format(second)))


def test_a_point_without_its_time_leaves_the_table_without_time(tmp_path: Path) -> None:
    trials = "trial,slot,held_length_mm\na,s,60\n"
    whole = read_dataset(folder(tmp_path, trials, TABLE.format(7)))
    assert whole.trials[0].settled
    assert whole.trials[0].taken_s.tolist() == [2.0, 7.0, 30.0]
    part = tmp_path / "part"
    part.mkdir()
    assert not len(read_dataset(folder(part, trials, TABLE.format(""))).trials[0].taken_s)


def test_bad_bench_names_the_key(tmp_path: Path) -> None:
    with pytest.raises(GapError, match="supply_psi"):
        read_dataset(folder(tmp_path, bench="supply_psi = 80\n"))


# ---------------------------------------------------------------------------- calibrations


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ("pressure_zero = 0.3", "calibration.toml: pressure_zero: unknown key"),
        ('pressure_zero_kpa = "0.3"', "calibration.toml: pressure_zero_kpa"),
        ("pressure_zero_kpa = -0.3", "calibration.toml: pressure_zero_kpa"),
        ("force_zero_n = nan", "calibration.toml: force_zero_n"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(table: str, named: str, tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(f"{table}\n")
    with pytest.raises(GapError, match="calibration") as caught:
        read_dataset(folder(tmp_path))
    assert named in str(caught.value)


def test_what_a_sensor_may_be_off_by_in_all_trials_is_no_effect(tmp_path: Path) -> None:
    """Replicates share it, so only a stated calibration can tell it from a gap."""
    gains = []
    path = settled_set(tmp_path / "data", {"pressure_zero": {"offset_kpa": 1.0}})
    for text in ("", "pressure_zero_kpa = 1.0\n"):
        (path / "calibration.toml").write_text(text)
        data = read_dataset(path)
        problem = FitProblem.of(data, [s for s in CANDIDATES if s.id == "pressure_zero"])
        gains.append(float(linear_gains(problem, problem.base).gain.max()))
        assert problem.unnamed == problem.mountings + len(data.calibration)
    assert gains[1] < 0.2 * gains[0]
