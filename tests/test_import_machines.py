"""Pull tests of testing machines, joined to our record of the pressure by a step that both saw."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.data.import_data import import_template
from gap.data.reader import read_dataset
from gap.data.trial import Channel
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem
from gap.mapping.join import Join, clock_keys, offset_of
from gap.mapping.write import import_data
from gap_bench import write_set
from gap_sets import settled_set
from import_sets import FORCE_N, HOUSE, KINDS, machine, staircase

TEMPLATES = HOUSE / "configs" / "mappings"
REGULAR = {"at_s": (3.0, 7.0, 11.0, 15.0), "levels": (0.0, 300.0, 0.0, 300.0, 0.0)}
JUST = {"ours_s": 17.5, "theirs_s": (8.3, 24.8)}


def template(folder: Path, kind: str, *changes: tuple[str, str]) -> Path:
    text = (TEMPLATES / f"{kind}.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "pull.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_machines_export_meets_our_pressure(kind: str, tmp_path: Path) -> None:
    true_s = machine(tmp_path, kind)
    (made,) = import_data(template(tmp_path, kind), tmp_path / "out")
    about = json.loads((tmp_path / "out" / "import.json").read_text())
    (join,) = about["joins"]
    assert join["steps"] == 5
    assert abs(join["offset_s"] - true_s) < 3.0 * join["u_s"]
    assert 0.0002 < join["u_s"] < 0.05
    assert any("clock shifted by 7.3" in note for note in made.notes)
    trial = made.data.trials[0]
    assert trial["length_mm"].value == pytest.approx(62.0)
    # At rest between the steps, the force of the machine is that of our pressure.
    force, kpa = trial["force_n"], trial["pressure_kpa"]
    calm = np.interp(force.time_s, kpa.time_s, np.abs(np.gradient(kpa.value, 10))) < 0.2
    calm &= (force.time_s > kpa.time_s[0]) & (force.time_s < kpa.time_s[-1])
    expected = FORCE_N * np.interp(force.time_s, kpa.time_s, kpa.value)
    assert np.abs(force.value - expected)[calm].mean() < 0.3


def test_a_unit_that_the_file_states_otherwise_is_refused(tmp_path: Path) -> None:
    machine(tmp_path)
    path = tmp_path / "Specimen_RawData_1.csv"
    path.write_bytes(path.read_bytes().replace(b'"(N)"', b'"(kN)"'))
    with pytest.raises(GapError, match=r"channels\.force_n\.unit.*is 'N'.*column Load states 'kN'"):
        import_data(template(tmp_path, "instron"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    path.write_bytes(path.read_bytes().replace(b'"(s)"', b'"(min)"').replace(b"(kN)", b"(N)"))
    with pytest.raises(GapError, match=r"time\.unit.*states 'min'"):
        import_data(template(tmp_path, "instron"), tmp_path / "out")


def test_a_stated_event_shifts_the_clock(tmp_path: Path) -> None:
    true_s = machine(tmp_path, offset_s=2.5)
    stated = 'by = "stated"\nchannel_s = 3.1\nto_s = 5.6\nu_s = 0.04\n'
    path = template(tmp_path, "instron", ('by = "steps"', stated))
    import_data(path, tmp_path / "out")
    (join,) = json.loads((tmp_path / "out" / "import.json").read_text())["joins"]
    assert (join["offset_s"], join["u_s"], join["steps"]) == (pytest.approx(true_s), 0.04, 0)


def test_regular_steps_are_ambiguous_until_the_offset_is_about_known(tmp_path: Path) -> None:
    true_s = machine(tmp_path, **REGULAR, **JUST)  # type: ignore[arg-type]
    with pytest.raises(GapError, match=r"ambiguous: 4 steps fall together at 7\.3"):
        import_data(template(tmp_path, "instron"), tmp_path / "out")
    about = ('by = "steps"', 'by = "steps"\nabout_s = 8.0\nwithin_s = 3.0\n')
    import_data(template(tmp_path, "instron", about), tmp_path / "out")
    (join,) = json.loads((tmp_path / "out" / "import.json").read_text())["joins"]
    assert abs(join["offset_s"] - true_s) < 3.0 * join["u_s"]


def test_regular_steps_are_not_ambiguous_where_a_longer_record_shows_no_more(
    tmp_path: Path,
) -> None:
    true_s = machine(tmp_path, **REGULAR)  # type: ignore[arg-type]
    import_data(template(tmp_path, "instron"), tmp_path / "out")
    (join,) = json.loads((tmp_path / "out" / "import.json").read_text())["joins"]
    assert join["steps"] == 4
    assert abs(join["offset_s"] - true_s) < 3.0 * join["u_s"]


def test_steps_that_are_not_those_of_the_other_are_refused(tmp_path: Path) -> None:
    machine(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    machine(other, at_s=(2.0, 4.9, 9.1, 18.3), levels=(0.0, 300.0, 0.0, 300.0, 0.0))
    (other / "samples.csv").rename(tmp_path / "other.csv")
    path = template(tmp_path, "instron", ('"samples.csv"', '"other.csv"'))
    with pytest.raises(GapError, match=r"ambiguous|fall together"):
        import_data(path, tmp_path / "out")


def test_without_a_step_there_is_no_offset(tmp_path: Path) -> None:
    machine(tmp_path, levels=(100.0,) * 6)
    with pytest.raises(GapError, match=r"has no step|fall together|ambiguous"):
        import_data(template(tmp_path, "instron"), tmp_path / "out")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [('to = "force_n"', 'to = "length_mm2"', r"join\.to.*not a channel"),
     ('by = "steps"', 'by = "stated"', r"join\.channel_s.*missing"),
     ('by = "steps"', 'by = "guess"', r"join\.by.*steps, stated"),
     ('channel = "pressure_kpa"\nto', 'channel = "length_mm"\nto', "of another file"),
     ('by = "steps"', 'by = "steps"\nwithin_s = 1.0', "about_s"),
     ('by = "steps"', 'by = "steps"\nlags_s = 1.0', "did you mean lag_s"),
     ('header_begins = "Time"', 'header_begins = "Zeit"', "no line begins with 'Zeit'"),
     ('header_begins = "Time"', 'header_begins = "Time"\nskip_lines = 2', "header_begins")],
)  # fmt: skip
def test_a_mapping_that_cannot_work_names_the_key(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    machine(tmp_path)
    with pytest.raises(GapError, match=words):
        import_data(template(tmp_path, "instron", (old, new)), tmp_path / "out")


def made(seed: int, steps: int) -> tuple[Any, Any, float]:
    """Pressure at 100 Hz and a force with noise, at 20 Hz on another clock."""
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(1.5, 6.0, steps)) + 2.0
    levels = np.cumsum(np.r_[0.0, rng.choice([-1, 1], steps) * rng.uniform(120.0, 300.0, steps)])
    end = float(at[-1]) + 3.0
    ours, theirs = np.arange(0.0, end, 0.01), np.arange(0.0, end + 12.0, 0.05)
    true_s = float(rng.uniform(1.0, 8.0))
    kpa = staircase(ours, tuple(at), tuple(levels)) + rng.normal(0.0, 0.5, len(ours))
    force = 0.1 * staircase(theirs - true_s, tuple(at), tuple(levels))
    return (ours, kpa), (theirs, force + rng.normal(0.0, 0.2, len(theirs))), true_s


def test_the_stated_uncertainty_of_the_offset_holds() -> None:
    join = Join("pressure_kpa", "force_n", "steps")
    errors, refused = [], 0
    for seed in range(80):
        own, main, true_s = made(seed, 1 + seed % 6)
        try:
            found = offset_of(join, "test", own, main)
        except GapError:
            refused += 1
            continue
        errors.append((found.offset_s - true_s) / found.u_s)
    inside = np.mean(np.abs(errors) < 2.0)
    assert refused < 26
    assert inside > 0.93
    assert 0.3 < math.sqrt(np.mean(np.square(errors))) < 1.3  # neither too small nor idle
    assert np.max(np.abs(errors)) < 5.0  # no wrong step was ever taken


def test_a_lag_is_part_of_the_offset_and_of_its_uncertainty() -> None:
    own, main, true_s = made(4, 4)
    plain = offset_of(Join("p", "f", "steps"), "test", own, main)
    lagged = offset_of(Join("p", "f", "steps", lag_s=0.1, u_lag_s=0.05), "test", own, main)
    assert lagged.offset_s == pytest.approx(plain.offset_s - 0.1)
    assert lagged.u_s == pytest.approx(math.hypot(plain.u_s, 0.05))
    assert true_s > 0.0


def test_opposite_steps_need_to_be_stated() -> None:
    own, (time_s, force), true_s = made(5, 3)
    with pytest.raises(GapError):
        offset_of(Join("p", "x", "steps"), "test", own, (time_s, -force))
    found = offset_of(Join("p", "x", "steps", opposite=True), "test", own, (time_s, -force))
    assert abs(found.offset_s - true_s) < 4.0 * found.u_s


def test_templates_are_written_once(tmp_path: Path) -> None:
    path = tmp_path / "pull.toml"
    import_template("zwick", path)
    assert path.read_text("utf-8") == (TEMPLATES / "zwick.toml").read_text("utf-8")
    for name, words in (("zwick", "there already"), ("shimadzu", "instron, mts, zwick")):
        with pytest.raises(GapError, match=words):
            import_template(name, path)


# ---- what is uncertain about the joined time goes on ------------------------------------


@pytest.mark.parametrize(
    ("one", "other", "keys"),
    [
        ({"pressure_kpa"}, {"force_n", "length_mm"}, ("pressure_clock_ms",)),
        ({"pressure_kpa", "length_mm"}, {"force_n"}, ("force_clock_ms",)),
        ({"pressure_kpa", "inlet_cmd"}, {"force_n", "length_mm"},
         ("force_clock_ms", "length_clock_ms")),
        ({"pressure_kpa", "inlet_cmd"}, {"force_n", "outlet_cmd"}, ("pressure_clock_ms",)),
        ({"temperature_c"}, {"force_n", "pressure_kpa"}, ()),
    ],
)  # fmt: skip
def test_the_file_that_has_fewer_channels_and_no_commands_carries_the_error(
    one: set[str], other: set[str], keys: tuple[str, ...]
) -> None:
    assert clock_keys(one, other) == keys


def test_the_data_set_states_the_uncertainty_of_its_joined_clock(tmp_path: Path) -> None:
    machine(tmp_path)
    path = template(tmp_path, "instron")
    (plain,) = import_data(path, tmp_path / "out")
    (join,) = json.loads((tmp_path / "out" / "import.json").read_text())["joins"]
    u_ms = plain.data.calibration["pressure_clock_ms"]
    assert u_ms == pytest.approx(1e3 * join["u_s"], rel=1e-5)
    assert any("pressure_clock_ms" in note for note in plain.notes)
    text = path.read_text()
    path.write_text("calibration = { pressure_clock_ms = 30.0 }\n" + text)
    (both,) = import_data(path, tmp_path / "both")
    assert both.data.calibration["pressure_clock_ms"] == pytest.approx(math.hypot(30.0, u_ms))


@pytest.mark.parametrize(
    ("channel", "key"), [("pressure_kpa", "pressure_clock_ms"), ("force_n", "force_clock_ms")]
)
def test_the_diagnosis_fits_a_joined_clock_that_is_off(
    channel: str, key: str, tmp_path: Path
) -> None:
    """The simulated truth is off by one standard uncertainty; without it the gap is large."""
    late_ms = 4.0
    data = read_dataset(write_set(tmp_path / "set", seed=21, replicates=2, rate_hz=100.0))
    trials = []
    for trial in data.trials:
        channels = dict(trial.channels)
        if channel in channels:
            late = channels[channel]
            channels[channel] = Channel(late.time_s + 1e-3 * late_ms, late.value)
        trials.append(dataclasses.replace(trial, channels=channels))
    off = dataclasses.replace(data, trials=tuple(trials))
    left = {}
    for u_ms in (0.0, late_ms):
        stated = {key: u_ms} if u_ms else {}
        problem = FitProblem.of(dataclasses.replace(off, calibration=stated))
        fit = problem.fit([], [])
        left[u_ms] = fit.cost / len(problem.rows)
        if u_ms:
            shift = float(fit.shift[problem.names.index(f"calibration {key}")])
            assert shift == pytest.approx(1.0, abs=0.15)
    assert left[late_ms] < 0.25 * left[0.0]


def test_settled_points_do_not_depend_on_a_clock(tmp_path: Path) -> None:
    data = read_dataset(settled_set(tmp_path / "table", {}, replicates=2))
    stated = dataclasses.replace(
        data,
        calibration={"pressure_clock_ms": 9.0, "force_clock_ms": 9.0, "length_clock_ms": 9.0},
    )
    plain, clocked = (FitProblem.of(d).fit([], []) for d in (data, stated))
    assert clocked.cost == pytest.approx(plain.cost, rel=1e-6)
