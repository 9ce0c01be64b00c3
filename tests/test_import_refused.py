"""What a mapping may not say and a file not hold: one line with file and key, nothing written."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cli.main import main
from gap.errors import GapError
from gap.mapping.mapping import read_mapping
from import_sets import imported, understood

GOOD = """[source]
files = "a.csv"
[time]
column = "t"
unit = "s"
[channels.force_n]
column = "f"
unit = "N"
[channels.pressure_kpa]
column = "p"
unit = "bar"
reference = "gauge"
"""
CSV = "t,f,p,n\n0,1,1,a\n1,2,2,a\n2,3,3,b\n"
F = 'column = "f"\nunit = "N"\n'
P = 'unit = "bar"\nreference = "gauge"\n'

MAPPINGS = {
    # What is wrong: what to replace in GOOD, by what, and what the message says.
    "no TOML": ("[source]", "[source", "cannot be read as TOML"),
    "a key twice": ('files = "a.csv"', 'files = "a.csv"\nfiles = "b.csv"', "read as TOML"),
    "a channel twice": (P, P + '[channels.force_n]\ncolumn = "p"\n', "cannot be read as TOML"),
    "an unknown table": ("[time]", "[tiem]", "tiem: unknown key (did you mean time?)"),
    "an unknown key": (F, F + 'units = "N"\n', "channels.force_n.units: unknown key (did you mean"),
    "a table misspelt": ("[source]", "[sorce]", "source: is missing (is sorce that key?)"),
    "a needed key misspelt": ('unit = "N"', 'unti = "N"', "is missing (is unti that key?)"),
    "an unknown channel": ("channels.force_n", "channels.force_kn", "channels.force_kn: unknown"),
    "no source": ('[source]\nfiles = "a.csv"', "", "source: is missing"),
    "no channel": (GOOD[GOOD.index("[channels.force"):], "[channels]\n", "no measured channel"),
    "no unit": ('unit = "N"', "", "channels.force_n.unit: is missing"),
    "an unknown unit": ('"N"', '"Newton"', "channels.force_n.unit: unknown unit 'Newton'"),
    "another dimension": ('"N"', '"bar"', "'bar' is a unit of pressure, not of force"),
    "volts without scale": ('"N"', '"V"', "channels.force_n.scale: is missing"),
    "volts without what they give": ('"N"', '"V"\nscale = 2.0', "channels.force_n.gives: is"),
    "volts of another dimension": ('"N"', '"V"\nscale = 2\ngives = "mm"', "gives: 'mm' is a unit"),
    "scale of a text": ('"N"', '"N"\nscale = "2"', "scale: expected a number, got '2'"),
    "scale nan": ('"N"', '"N"\nscale = nan', "scale: expected a number, got nan"),
    "a sign of two": ('"N"', '"N"\nsign = 2', "sign: expected 1 or -1"),
    "gauge or not": ('reference = "gauge"', "", "channels.pressure_kpa.reference: is missing"),
    "absolute of what": ('"gauge"', '"absolute"', "channels.pressure_kpa.ambient_kpa: is missing"),
    "one column twice": ('column = "p"', 'column = "f"', "is the column of force_n as well"),
    "no time base": ('column = "t"\nunit = "s"', "", "time: expected one of column, rate_hz"),
    "two time bases": ('column = "t"', 'column = "t"\nrate_hz = 5', "got 2 of them"),
    "time in bar": ('"s"', '"bar"', "time.unit: 'bar' is a unit of pressure, not of time"),
    "cycles of settled points": (
        'column = "t"\nunit = "s"', 'settled = true\n[cut]\nby = ["cycles"]', "needs times"),
    "another way to cut": (P, P + '[cut]\nby = ["hand"]\n', "cut.by: 'hand' is not one of"),
    "gaps of no length": (P, P + '[cut]\nby = ["gaps"]\n', "cut.gap_s: is missing"),
    "cycles of no size": (
        P, P + '[cut]\nby = ["cycles"]\ncycles = { channel = "force_n" }\n', "hysteresis: is mis"),
    "a key of another cut": (P, P + "[cut]\ngap_s = 1.0\n", "cut.gap_s: unknown key"),
    "a name that no file has": (P, P + '[trials]\nslot = "{bar}"\n', "{bar} is not a name"),
    "a load in volts": (P, P + '[trials]\nload_kg = { column = "n", unit = "V" }\n', "trials.load"),
    "two bits": (
        P, P + '[channels.inlet_cmd]\ncolumn = "n"\nbit = 1\nabove = 2\n', "at most one of"),
    "calibration": (P, P + "[calibration]\nforce_zero = 1.0\n", "calibration.force_zero: unknown"),
    "a file elsewhere": ('"a.csv"', '"../a.csv"', "leads out of the folder"),
    "an absolute file": ('"a.csv"', '"/etc/passwd"', "leads out of the folder"),
    "another file elsewhere": ('column = "f"', 'column = "f"\nfile = "../b.csv"', "within the dat"),
}  # fmt: skip


@pytest.mark.parametrize("case", MAPPINGS)
def test_a_bad_mapping_is_refused_with_file_and_key(case: str, tmp_path: Path) -> None:
    old, new, said = MAPPINGS[case]
    assert old in GOOD
    with pytest.raises(GapError) as caught:
        understood(tmp_path, GOOD.replace(old, new))
    message = str(caught.value)
    assert "mapping.toml" in message
    assert said in message
    assert "\n" not in message


DATA = {
    # What is wrong: the file, what it adds to GOOD, and what the message says.
    "no file": (None, "", "source.files: no file 'a.csv'"),
    "empty": ("", "", "a.csv: is empty"),
    "no rows": ("t,f,p,n\n", "", "a.csv: has no rows"),
    "no such column": (CSV.replace("f,", "g,", 1), "", "a.csv, column f: is missing (there are: t"),
    "a column twice": (CSV.replace("p,n", "f,n"), "", "a.csv, column f: appears twice"),
    "a word": (CSV.replace("1,2,2", "1,two,2"), "", "column f, row 3: 'two' is not a number"),
    "infinite": (CSV.replace("1,2,2", "1,inf,2"), "", "column f, row 3: is infinite"),
    "an empty cell": (CSV.replace("1,2,2", "1,,2"), "", 'row 3: is empty (where that means no sam'),
    "nan": (CSV.replace("1,2,2", "1,nan,2"), "", "column f, row 3: is empty"),
    "no time": (CSV.replace("1,2,2", ",2,2"), "", "column t, row 3: has no time"),
    "time backwards": (CSV.replace("2,3,3", "0.5,3,3"), "", "column t, row 4: time runs backwards"),
    "time twice": (CSV.replace("2,3,3", "1,3,3"), "", "column t, row 4: time appears twice"),
    "cut short": (CSV[:-4], "", "a.csv, row 4: has 3 cells, not 4"),
    "decimal commas": (CSV.replace("2,2", "2,5,2"), "", "row 3: has 5 cells, not 4"),
    "outside the sensor": (CSV.replace("2,3,3", "2,30000,3"), "", "column force_n: 30000 is far"),
    "a trial without samples": (
        CSV.replace("2,3,3,b", "2,,,b"),
        '[cut]\nby = ["column"]\ncolumns = ["n"]\n', "trial b has no measured sample"),
    "a fact that changes": (
        CSV.replace("a", "1").replace("b", "2"),
        '[trials]\nload_kg = { column = "n", unit = "kg" }\n', "row 4: 2 after 1 in one trial"),
    "a command of no bit": (
        CSV.replace("3,b", "3,5").replace("a", "1"),
        '[channels.inlet_cmd]\ncolumn = "n"\n', "row 4: 5 is neither 0 nor 1"),
    "a muscle that is not there": (CSV, "[muscles.X]\nbench = {}\n", "muscles.X: no such"),
    "a constant that is none": (CSV, "[bench]\nbraid_mm = 5.0\n", "braid_mm"),
    "not UTF-8": (CSV.encode("utf-16"), "", "is not utf-8 text"),
}  # fmt: skip


@pytest.mark.parametrize("case", DATA)
def test_bad_data_is_refused_with_file_and_row_and_nothing_is_written(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    content, more, said = DATA[case]
    if content is not None:
        (tmp_path / "a.csv").write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
    text = GOOD + more
    if case == "a trial without samples":
        text = text.replace('unit = "N"\n', 'unit = "N"\nempty_cells = "no sample"\n')
        text = text.replace('"gauge"\n', '"gauge"\nempty_cells = "no sample"\n')
    (tmp_path / "mapping.toml").write_text(text)
    before = sorted(os.listdir(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["pamrig", "import", "data", "mapping.toml", "--out", "out"])
    with pytest.raises(SystemExit) as exit_:
        main()
    told = capsys.readouterr()
    assert exit_.value.code == 2
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert said in told.err
    assert sorted(os.listdir(tmp_path)) == before


def test_a_folder_that_is_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(CSV)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(GapError, match="out: is there already"):
        imported(tmp_path, GOOD)
    assert os.listdir(tmp_path / "out") == ["mine.txt"]


def test_two_files_that_give_one_name_are_refused(tmp_path: Path) -> None:
    for name in ("x", "y"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.csv").write_text(CSV)
    with pytest.raises(GapError, match="two trials are called 'a'"):
        imported(tmp_path, GOOD.replace('"a.csv"', '"*/a.csv"'))


def test_a_name_that_leads_elsewhere_is_no_muscle(tmp_path: Path) -> None:
    rows = CSV.replace("a", "..").replace("b", "../x")
    (tmp_path / "a.csv").write_text(rows)
    cut = '[cut]\nby = ["column"]\ncolumns = ["n"]\n[trials]\nmuscle = { column = "n" }\n'
    with pytest.raises(GapError, match="cannot be the name of a folder"):
        imported(tmp_path, GOOD + cut)
    assert sorted(os.listdir(tmp_path)) == ["a.csv", "mapping.toml"]


def test_values_that_stand_for_nothing_are_counted(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(CSV)
    (made,) = imported(tmp_path, GOOD.replace('"N"', '"N"\nmissing_values = [2]'))
    assert "a.csv: force_n: 1 values stand for no measurement" in made.notes
    samples = pd.read_parquet(tmp_path / "out" / "samples.parquet")
    assert samples["force_n"].isna().tolist() == [False, True, False]


FULL = """
source.files = "a.csv"
source.header = true
source.decimal = "point"
source.skip_lines = 0
time.column = "t"
time.unit = "s"
time.offset_s = 0.0
channels.force_n.column = "f"
channels.force_n.unit = "N"
channels.force_n.sign = -1
channels.force_n.missing_values = [9]
channels.pressure_kpa.column = "p"
channels.pressure_kpa.unit = "bar"
channels.pressure_kpa.reference = "gauge"
channels.pressure_kpa.time.rate_hz = 2.0
channels.inlet_cmd.column = "s"
channels.inlet_cmd.bit = 0
cut.by = ["column", "edges"]
cut.columns = "n"
cut.ignore = ["c"]
cut.edges.column = "s"
cut.edges.edge = "change"
cut.parts = "replicates"
trials.slot = "{stem}"
trials.mounting = { column = "n" }
trials.load_kg = { column = "s", unit = "kg" }
trials.order = "time"
calibration.force_zero_n = 0.1
bench.supply_kpa = 600.0
rest_length_mm = 66.0
"""
LINES = FULL.strip().splitlines()
MANY = 4000 if os.environ.get("PAMRIG_CAMPAIGN") else 60
ROWS = "t,f,p,n,s\n0,1,1,a,0\n1,2,2,a,0\n2,3,3,b,1\n3,4,4,b,1\n"
VALUES = (
    '""', '"f"', '"p"', '"column"', '"s"', '"ISO"', '"{x}"', '"*"', '"\\u0000"', '"strain %"', "0",
    "1", "-3", "99999999999999999", "1e308", "-0.0", "nan", "inf", "true", "[]", '["f", 1]', "[[]]",
    "{}", "{ column = 1 }", "1979-05-27", "07:32:00", '"cycles"', '["gaps"]', '"gauge"',
)  # fmt: skip


def outcome(folder: Path, text: str) -> str:
    """What an import says where it refuses, "" where it does not; any other error is a failure."""
    told = ""
    try:
        imported(folder, text)
    except GapError as error:
        told = str(error)
    assert (folder / "out").exists() == (told == ""), "a refused import leaves nothing"
    shutil.rmtree(folder / "out", ignore_errors=True)
    return told


def test_the_mapping_that_is_varied_below_is_sound(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(ROWS)
    (made,) = imported(tmp_path, FULL)
    assert [trial.name for trial in made.trials] == ["a-1", "b-1"]


@settings(
    max_examples=MANY, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    changes=st.lists(
        st.tuples(st.integers(0, len(LINES) - 1), st.sampled_from(VALUES)), min_size=1, max_size=3
    )
)
def test_any_value_of_any_key_is_read_or_refused_by_name(
    changes: list[tuple[int, str]], tmp_path: Path
) -> None:
    lines = list(LINES)
    for at, value in changes:
        lines[at] = f"{lines[at].partition(' =')[0]} = {value}"
    (tmp_path / "a.csv").write_text(ROWS)
    told = outcome(tmp_path, "\n".join(lines))
    assert told == "" or ": " in told


@settings(
    max_examples=MANY, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    cuts=st.lists(
        st.tuples(st.integers(0, len(ROWS)), st.sampled_from(
            [b"", b"\n", b",", b'"', b"\x00", b"\xff", b"e9", b"-", b"1e999", b"nan", b"\r", b" "]
        )),
        min_size=1, max_size=4,
    ),
    keep=st.integers(0, len(ROWS)),
)  # fmt: skip
def test_any_file_is_read_or_refused_by_name(
    cuts: list[tuple[int, bytes]], keep: int, tmp_path: Path
) -> None:
    content = ROWS.encode()
    for at, text in cuts:
        content = content[:at] + text + content[at + 1 :]
    (tmp_path / "a.csv").write_bytes(content[: max(keep, 12)])
    told = outcome(tmp_path, FULL)
    assert told == "" or "a.csv" in told or "mapping.toml" in told


def test_a_mapping_that_is_not_there_is_said_to_be_missing(tmp_path: Path) -> None:
    """It was said that it "cannot be read as TOML"."""
    with pytest.raises(GapError, match=r"none\.toml: cannot be read: No such file"):
        read_mapping(tmp_path / "none.toml")
