"""`pamrig import data`: the docs page's examples, the dry run, and that a diagnosis reads it."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest

from cli.main import main
from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.data.trial import CHANNELS, COMMANDS
from gap.decision.diagnose import diagnose
from gap.mapping.cost import costs_of
from gap.mapping.mapping import read_mapping
from gap.mapping.write import import_data
from gap.thesis.data import thesis_set
from gap_sets import settled_set
from import_sets import HOUSE, PAGE, imported, page_mappings, prepare_page
from plant.effects.catalogue import CATALOGUE

TABLES = HOUSE / "plant" / "data"


def pamrig(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> str:
    """Run a command; its output."""
    monkeypatch.setattr(sys, "argv", shlex.split(command))
    with pytest.raises(SystemExit) as exit_:
        main()
    told = capsys.readouterr()
    assert exit_.value.code == 0, told.err
    return told.out


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("desk")
    prepare_page(folder)
    return folder


def test_the_commands_of_the_page_make_what_it_says(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(desk)
    commands = re.findall(r"^    (pamrig import .*)$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert len(commands) == 7
    for command in commands:
        pamrig(command, monkeypatch, capsys)
    assert (desk / "first.png").read_bytes().startswith(b"\x89PNG")
    log = read_dataset(desk / "data" / "log")
    assert log.slots == {"60 mm": [0, 1]}
    assert {"inlet_cmd", "outlet_cmd"} <= set(log.trials[0].channels)
    assert abs(log.trials[0]["pressure_kpa"].value[:20]).max() < 2.0
    for name, braid_mm in (("A", None), ("B", 86.0)):
        data = read_dataset(desk / "data" / "static" / name)
        assert data.settled
        assert len(data.trials) == 5
        assert braid_mm is None or data.constants.braid_length_m == pytest.approx(0.001 * braid_mm)
    pull = read_dataset(desk / "data" / "pull")
    assert [len(trials) for trials in pull.slots.values()] == [4]
    assert np.diff(pull.trials[1]["force_n"].time_s) == pytest.approx(1 / 400, abs=1e-9)
    assert np.diff(pull.trials[1]["length_mm"].time_s) == pytest.approx(0.02, abs=1e-9)
    assert pull.trials[0]["pressure_kpa"].value.mean() == pytest.approx(150.0, abs=0.5)
    spool = read_dataset(desk / "data" / "spool")
    assert spool.constants.valve == "proportional"
    # 3 V of 5 to both sides; rows 10 ms apart miss the top of the sine by a little.
    assert spool.trials[0]["inlet_cmd"].value.max() == pytest.approx(0.6, abs=1e-3)
    assert spool.trials[0]["outlet_cmd"].value.max() == pytest.approx(0.6, abs=1e-3)


def test_the_page_has_a_row_for_every_key() -> None:
    """Keys are taken from the reader's own source: what it asks for is what a mapping can hold."""
    source = (HOUSE / "gap" / "mapping" / "mapping.py").read_text(encoding="utf-8")
    asked = set(
        re.findall(
            r"\.(?:text|texts|choice|number|positive|count|flag|scalars|columns|table|raw|value)"
            r'\(\s*"([a-z_]+)"',
            source,
        )
    )
    asked |= set(re.findall(r'_required\(\w+, "([a-z_]+)"\)', source))
    page = PAGE.read_text(encoding="utf-8")
    assert len(asked) > 40
    for key in asked:
        assert re.search(rf"`(\w+\.)?{key}[`.]|\[{key}[\].]|{{ {key} = ", page), key


def test_every_mapping_that_is_shown_or_shipped_can_be_read(desk: Path) -> None:
    assert set(page_mappings()) == {"log.toml", "static.toml", "pull.toml", "spool.toml"}
    shipped = sorted((HOUSE / "tests" / "real").glob("*/mapping.toml"))
    assert {path.parent.name for path in shipped} == {
        "martens-boblan",
        "zillen",
        "zillen-chambers",
        "zillen-seals",
    }
    for path in shipped:
        assert read_mapping(path).channels


def test_a_dry_run_writes_nothing_and_says_what_it_understood(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(desk)
    before = sorted(path.name for path in desk.iterdir())
    text = pamrig("pamrig import data log.toml --dry-run --out new", monkeypatch, capsys)
    told = json.loads(pamrig("pamrig import data log.toml --dry-run --json", monkeypatch, capsys))
    assert sorted(path.name for path in desk.iterdir()) == before
    (one,) = told["sets"]
    channels = {channel["name"]: channel for channel in one["channels"]}
    assert channels["pressure_kpa"]["column"] == "pressure"
    assert channels["pressure_kpa"]["rate_hz"] == pytest.approx(100.0)
    assert 0.2 < channels["pressure_kpa"]["noise"] < 0.6
    assert channels["inlet_cmd"]["unit"] == "bit 0"
    assert one["replicates"] == {"60 mm": 2}
    assert [trial["rows"] for trial in one["trials"]] == [400, 400]
    assert one["trials"][0]["duration_s"] == pytest.approx(3.99)
    assert "temperature_stiffening" in text
    assert "without temperature_c, cannot be named: temperature_stiffening" in text


def test_the_picture_names_every_channel_with_its_unit(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(matplotlib.rcParams, "svg.fonttype", "none")
    for name, labels in (
        ("log", ["pressure / kPa (gauge)", "force / N", "inlet / 0 to 1", "time / s"]),
        ("static", ["length / mm", "row of the table (no time)"]),
    ):
        picture = tmp_path / f"{name}.svg"
        command = f"pamrig import data {desk / name}.toml --dry-run --picture {picture}"
        pamrig(command, monkeypatch, capsys)
        drawn = picture.read_text(encoding="utf-8")
        for label in labels:
            assert f">{label}</text>" in drawn


def test_a_picture_of_no_known_format_is_refused_before_anything_is_written(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = f"pamrig import data {desk / 'log.toml'} --out {tmp_path / 'x'} --picture a.doc"
    monkeypatch.setattr(sys, "argv", shlex.split(command))
    with pytest.raises(SystemExit) as exit_:
        main()
    assert exit_.value.code == 2
    assert "a.doc: is not a picture file" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


# ---------------------------------------------------------------------------- costs


def test_what_a_column_costs_follows_from_the_effects_of_the_product(desk: Path) -> None:
    (made,) = import_data(desk / "log.toml", desk / "none", dry=True)
    assert made.costs is not None
    costs = {cost.column: cost for cost in made.costs.missing}
    assert set(costs) == {"length_mm", "supply_kpa", "temperature_c", "load_kg", "order"}
    assert "wear" in costs["order"].effects
    assert costs["temperature_c"].families == ("temperature",)
    for cost in costs.values():
        assert not set(cost.effects) & set(made.costs.shown)
        assert cost.families == tuple(
            dict.fromkeys(CATALOGUE[name].family for name in cost.effects)
        )
    data = made.data
    without = DataSet(
        data.origin,
        tuple(
            type(t)(**{**vars(t), "channels": {k: v for k, v in t.channels.items()
                                               if k != "force_n"}})
            for t in data.trials
        ),
        data.constants,
    )  # fmt: skip
    lost = {c.column: c for c in costs_of(without).missing}["force_n"]
    only_force = {
        name for name, effect in CATALOGUE.items()
        if "pressure" not in effect.search.blocks and name in made.costs.shown
    }  # fmt: skip
    assert only_force
    assert set(lost.effects) >= only_force


def test_a_set_that_lacks_nothing_costs_nothing(tmp_path: Path) -> None:
    rows = pd.DataFrame(
        {"trial": "a", "time_s": np.arange(200) * 0.01, "pressure_kpa": np.linspace(0, 300, 200),
         "length_mm": np.linspace(58.0, 68.0, 200), "force_n": 5.0, "supply_kpa": 600.0,
         "temperature_c": np.linspace(20.0, 30.0, 200), "inlet_cmd": np.arange(200) < 100,
         "outlet_cmd": 0.0}
    )  # fmt: skip
    assert {*CHANNELS, *COMMANDS} <= set(rows)
    (tmp_path / "trials.csv").write_text("trial,order,load_kg\na,1,0.8\nb,2,0.8\n")
    pd.concat([rows, rows.assign(trial="b", force_n=6.0)]).to_parquet(tmp_path / "samples.parquet")
    costs = costs_of(read_dataset(tmp_path))
    assert costs.missing == ()
    assert costs.together == ()
    assert {"valve_delay", "temperature_stiffening", "wear", "payload"} <= set(costs.shown)


# ---------------------------------------------------------------------------- the thesis


THESIS = {
    "c01": (
        'empty_cells = "no sample"', "isometric", ["length_mm", "temperature_c"],
        'held_length_mm = { column = "length_mm", unit = "mm" }\n'
        'temperature_c = { column = "temperature_c", unit = "C" }\n', "force_n"),
    "c03": (
        'empty_cells = "no sample"', "isotonic", ["force_n"],
        'load_kg = { column = "force_n", unit = "N" }\ntemperature_c = 21.0\n', "length_mm"),
    "c04": (
        'empty_cells = "no sample"', "hysteresis", ["length_mm", "cycle_max_kpa"],
        'held_length_mm = { column = "length_mm", unit = "mm" }\ntemperature_c = 21.0\n',
        "force_n"),
    "c06": (
        'empty_cells = "no sample"', "hysteresis", ["mass_kg", "cycle_max_kpa"],
        'load_kg = { column = "mass_kg", unit = "kg" }\ntemperature_c = 21.0\n', "length_mm"),
}  # fmt: skip


@pytest.mark.parametrize("table", THESIS)
def test_a_table_of_the_thesis_through_a_mapping(table: str, tmp_path: Path) -> None:
    """The same points as `pamrig gap thesis` reads, whatever order somebody printed them in."""
    empty, protocol, columns, facts, measured = THESIS[table]
    (source,) = TABLES.glob(f"{table}_*.csv")
    (tmp_path / source.name).write_bytes(source.read_bytes())
    unit = "N" if measured == "force_n" else "mm"
    way = '[channels.direction]\ncolumn = "direction"\n' if table in ("c04", "c06") else ""
    imported(
        tmp_path,
        f'[source]\nfiles = "{source.name}"\n[time]\nsettled = true\n[channels.pressure_kpa]\n'
        'column = "pressure_kpa"\nunit = "kPa"\nreference = "gauge"\n'
        f'[channels.{measured}]\ncolumn = "{measured}"\nunit = "{unit}"\n{empty}\n{way}'
        f'[cut]\nby = ["column"]\ncolumns = {json.dumps(columns)}\n'
        f'[trials]\nprotocol = "{protocol}"\n{facts}',
    )

    def points(data: DataSet) -> list[Any]:
        found = []
        for trial in data.trials:
            held = trial.load_kg if np.isfinite(trial.load_kg) else trial.held_length_mm
            held = 51.45 if held == 51.0 else round(held, 9)  # A01 of the table's anomalies
            for k, p in enumerate(trial["pressure_kpa"].value):
                at = np.flatnonzero(trial[measured].time_s == trial["pressure_kpa"].time_s[k])
                if len(at):
                    value = float(trial[measured].value[at[0]])
                    found.append((held, trial.temperature_c, p, int(trial.direction[k]), value))
        return sorted(found)

    data = read_dataset(tmp_path / "out")
    assert {trial.protocol for trial in data.trials} == {protocol}
    assert np.isnan([trial.order for trial in data.trials]).all()
    assert points(data) == points(thesis_set(table, warm=table == "c01"))


# ---------------------------------------------------------------------------- the diagnosis


def foreign(folder: Path, source: Path) -> str:
    """A data set as another program would write it: psi absolute, lbf, inches, Fahrenheit."""
    rows = pd.read_csv(source / "samples.csv").merge(pd.read_csv(source / "trials.csv"), on="trial")
    out = pd.DataFrame(
        {
            "Test": rows["trial"], "Setting": rows["slot"], "Set up": rows["mounting"],
            "p abs [psi]": (rows["pressure_kpa"] + 101.325) / 6.894757293168361,
            "Load cell [lbf]": -rows["force_n"] / 4.4482216152605,
            "L [in]": rows["held_length_mm"] / 25.4, "T [F]": rows["temperature_c"] * 1.8 + 32.0,
            "way": "+",
        }
    )  # fmt: skip
    out.to_csv(folder / "rig.csv", index=False, sep=";", decimal=",")
    return """[source]
files = "rig.csv"
delimiter = "semicolon"
decimal = "comma"
[time]
settled = true
[channels.pressure_kpa]
column = "p abs [psi]"
unit = "psi"
reference = "absolute"
ambient_kpa = 101.325
[channels.force_n]
column = "Load cell [lbf]"
unit = "lbf"
sign = -1
[channels.direction]
column = "way"
up = "+"
down = "-"
[cut]
by = ["column"]
columns = ["Test"]
[trials]
slot = { column = "Setting" }
mounting = { column = "Set up" }
protocol = "isometric"
order = "rows"
held_length_mm = { column = "L [in]", unit = "in" }
temperature_c = { column = "T [F]", unit = "F" }
"""


def test_a_foreign_file_gives_the_same_data_set(tmp_path: Path) -> None:
    original = settled_set(tmp_path / "original", {"force_zero": {"offset_n": 3.0}})
    imported(tmp_path, foreign(tmp_path, original))
    ours, theirs = read_dataset(original), read_dataset(tmp_path / "out")
    assert ours.slots == theirs.slots
    for one, other in zip(ours.trials, theirs.trials, strict=True):
        assert (one.name, one.order, one.mounting) == (other.name, other.order, other.mounting)
        assert other.held_length_mm == pytest.approx(one.held_length_mm, abs=1e-9)
        assert other.temperature_c == pytest.approx(one.temperature_c, abs=1e-9)
        assert other.direction.tolist() == one.direction.tolist()
        for name in ("pressure_kpa", "force_n"):
            np.testing.assert_allclose(other[name].value, one[name].value, atol=1e-9)


def test_a_foreign_file_is_diagnosed_as_the_data_set_that_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    original = settled_set(tmp_path / "original", {"liner_threshold": {"threshold_kpa": 110.0}})
    (tmp_path / "rig.toml").write_text(foreign(tmp_path, original))
    monkeypatch.chdir(tmp_path)
    pamrig("pamrig import data rig.toml --out data", monkeypatch, capsys)
    told = json.loads(pamrig("pamrig gap diagnose data --json", monkeypatch, capsys))
    own = diagnose(read_dataset(original))
    assert told["status"] == str(own.status)
    assert [tuple(e["ids"]) for e in told["effects"]] == [e.ids for e in own.effects]
    assert told["effects"][0]["ids"] == ["liner_threshold"]
