"""How recordings become trials: time bases, joined files, commands, cuts, replicates, muscles."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.reader import read_dataset
from gap.errors import GapError
from gap.mapping.cutting import cycles_of
from import_sets import imported, strokes

HEAD = '[source]\nfiles = "a.csv"\n[time]\ncolumn = "t"\nunit = "s"\n'
FORCE = '[channels.force_n]\ncolumn = "f"\nunit = "N"\n'


def trials(folder: Path, text: str) -> dict[str, list[tuple[float, float]]]:
    """Times and forces of each trial that a mapping makes."""
    imported(folder, text)
    return {
        trial.name: list(
            zip(trial["force_n"].time_s.tolist(), trial["force_n"].value.tolist(), strict=True)
        )
        for trial in read_dataset(folder / "out").trials
    }


def write(folder: Path, columns: dict[str, list[object]], name: str = "a.csv") -> None:
    pd.DataFrame(columns).to_csv(folder / name, index=False)


# ---------------------------------------------------------------------------- time


@pytest.mark.parametrize(
    ("unit", "cells"),
    [
        ("ms", [5, 7, 30]), ("us", [5000, 7000, 30000]), ("ns", [5000000, 7000000, 30000000]),
        ("s", [0.005, 0.007, 0.030]), ("min", [0.005 / 60, 0.007 / 60, 0.030 / 60]),
        ("ISO", [f"2026-03-01T09:00:00.{k}Z" for k in ("005", "007", "030")]),
    ],
)  # fmt: skip
def test_irregular_times_stay_as_they_are(unit: str, cells: list[object], tmp_path: Path) -> None:
    write(tmp_path, {"t": cells, "f": [1.0, 2.0, 3.0]})
    (found,) = trials(tmp_path, HEAD.replace('"s"', f'"{unit}"') + FORCE).values()
    np.testing.assert_allclose([t for t, _ in found], [0.0, 0.002, 0.025], atol=1e-9)


def test_a_rate_replaces_a_column_of_times(tmp_path: Path) -> None:
    write(tmp_path, {"f": [1.0, 2.0, 3.0]})
    head = '[source]\nfiles = "a.csv"\n[time]\nrate_hz = 250.0\noffset_s = 3.0\n'
    (found,) = trials(tmp_path, head + FORCE).values()
    assert [t for t, _ in found] == pytest.approx([0.0, 0.004, 0.008], abs=1e-12)


def test_channels_of_several_files_are_joined_by_time_and_not_resampled(tmp_path: Path) -> None:
    for run in ("1", "2"):
        write(tmp_path, {"t": [0.0, 0.5, 1.0], "f": [1.0, 2.0, 3.0]}, f"force-{run}.csv")
        write(tmp_path, {"ms": [90, 290, 490], "p": [1.0, 2.0, 3.0]}, f"air-{run}.csv")
    imported(
        tmp_path,
        '[source]\nfiles = "force-{run}.csv"\n[time]\ncolumn = "t"\nunit = "s"\n' + FORCE
        + '[channels.pressure_kpa]\nfile = "air-{run}.csv"\ncolumn = "p"\nunit = "bar"\n'
        'reference = "gauge"\ntime = { column = "ms", unit = "ms", offset_s = 0.01 }\n',
    )  # fmt: skip
    for trial in read_dataset(tmp_path / "out").trials:
        np.testing.assert_allclose(trial["force_n"].time_s, [0.0, 0.5, 1.0], atol=1e-12)
        np.testing.assert_allclose(trial["pressure_kpa"].time_s, [0.1, 0.3, 0.5], atol=1e-12)
        assert trial["pressure_kpa"].value.tolist() == [100.0, 200.0, 300.0]


# ---------------------------------------------------------------------------- commands


COMMANDS = {
    "a bit of a state": ([0, 1, 3, 2, 0], "bit = 0", "bit = 1"),
    "words": (["off", "fill", "both", "vent", "off"], 'on = ["fill", "both"]',
              'on = ["vent", "both"]'),
    "numbers": ([0, 10, 30, 20, 0], "on = [10, 30]", "on = [20, 30]"),
}  # fmt: skip


@pytest.mark.parametrize("case", COMMANDS)
def test_commands_come_from_logged_states(case: str, tmp_path: Path) -> None:
    states, inlet, outlet = COMMANDS[case]
    write(tmp_path, {"t": [0, 1, 2, 3, 4], "f": [1.0] * 5, "s": list(states)})
    imported(
        tmp_path,
        HEAD + FORCE + f'[channels.inlet_cmd]\ncolumn = "s"\n{inlet}\n'
        f'[channels.outlet_cmd]\ncolumn = "s"\n{outlet}\n',
    )
    (trial,) = read_dataset(tmp_path / "out").trials
    for name, edges in (("inlet_cmd", {0: 0, 1: 1, 3: 0}), ("outlet_cmd", {0: 0, 2: 1, 4: 0})):
        at = trial[name]
        assert dict(zip(at.time_s.tolist(), at.value.tolist(), strict=True)) == edges


def test_a_command_given_before_a_trial_holds_in_it(tmp_path: Path) -> None:
    write(tmp_path, {"t": [0, 1, 2, 3], "f": [1.0] * 4, "v": [0.1, 4.9, 4.8, 0.2],
                     "n": [1, 1, 2, 2]})  # fmt: skip
    imported(
        tmp_path,
        HEAD + FORCE + '[channels.inlet_cmd]\ncolumn = "v"\nabove = 2.5\n'
        '[cut]\nby = ["column"]\ncolumns = ["n"]\n',
    )
    second = read_dataset(tmp_path / "out").trials[1]["inlet_cmd"]
    assert second.time_s.tolist() == [0.0, 1.0]
    assert second.value.tolist() == [1.0, 0.0]


# ---------------------------------------------------------------------------- cuts


def test_trials_by_a_column_without_what_lies_between(tmp_path: Path) -> None:
    write(tmp_path, {"t": [0, 1, 2, 3, 4], "f": [1, 2, 3, 4, 5], "n": ["a", "a", "-", "b", "b"]})
    cut = '[cut]\nby = ["column"]\ncolumns = ["n"]\nignore = ["-"]\n'
    found = trials(tmp_path, HEAD + FORCE + cut)
    assert found == {"a": [(0.0, 1.0), (1.0, 2.0)], "b": [(0.0, 4.0), (1.0, 5.0)]}


def test_a_trial_that_begins_again_is_refused(tmp_path: Path) -> None:
    write(tmp_path, {"t": [0, 1, 2], "f": [1, 2, 3], "n": ["a", "b", "a"]})
    with pytest.raises(GapError, match=r"column n, row 4: trial 'a' begins again"):
        trials(tmp_path, HEAD + FORCE + '[cut]\nby = ["column"]\ncolumns = ["n"]\n')


def test_trials_by_pauses(tmp_path: Path) -> None:
    write(tmp_path, {"t": [0.0, 0.1, 5.0, 5.1], "f": [1, 2, 3, 4]})
    found = trials(tmp_path, HEAD + FORCE + '[cut]\nby = ["gaps"]\ngap_s = 1.0\n')
    assert [[f for _, f in trial] for trial in found.values()] == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("edge", "expected"),
    [
        ("rise", [[2, 3, 4], [5, 6]]),
        ("fall", [[4, 5], [6]]),
        ("both", [[2, 3], [4], [5], [6]]),
        ("change", [[1], [2, 3], [4], [5], [6]]),
    ],
)
def test_trials_by_edges_of_a_command(
    edge: str, expected: list[list[float]], tmp_path: Path
) -> None:
    write(tmp_path, {"t": range(6), "f": [1, 2, 3, 4, 5, 6], "c": [0, 1, 1, 0, 1, 0]})
    cut = f'[cut]\nby = ["edges"]\nedges = {{ column = "c", edge = "{edge}" }}\n'
    found = trials(tmp_path, HEAD + FORCE + cut)
    assert [[f for _, f in trial] for trial in found.values()] == expected


def test_a_trial_may_begin_before_its_edge(tmp_path: Path) -> None:
    write(tmp_path, {"t": range(6), "f": [1, 2, 3, 4, 5, 6], "c": [0, 0, 10, 10, 30, 30]})
    cut = '[cut]\nby = ["edges"]\nedges = { column = "c", above = 20, before_s = 1.0 }\n'
    assert list(trials(tmp_path, HEAD + FORCE + cut).values()) == [[(0, 4), (1, 5), (2, 6)]]


def test_cycles_of_a_constant_condition_are_replicates(tmp_path: Path) -> None:
    for bar in (1, 3):
        time_s, length = strokes(cycles=3)
        write(tmp_path, {"t": time_s, "l": length, "f": length * bar}, f"{bar}bar.csv")
    made = imported(
        tmp_path,
        '[source]\nfiles = "{bar}bar.csv"\n[time]\ncolumn = "t"\nunit = "s"\n' + FORCE
        + '[channels.length_mm]\ncolumn = "l"\nunit = "mm"\n[cut]\nby = ["cycles"]\n'
        'cycles = { channel = "length_mm", hysteresis = 2.0, ends = "keep" }\n'
        '[trials]\nslot = "{bar} bar"\n',
    )  # fmt: skip
    assert made[0].replicates == {"1 bar": 3, "3 bar": 3}
    data = read_dataset(tmp_path / "out")
    assert [t.replicate for t in data.trials] == ["1", "2", "3"] * 2
    for trial in data.trials:
        length = trial["length_mm"].value
        assert length[0] == 60.0
        assert length.max() == 68.0
    assert sum(len(t["length_mm"]) for t in data.trials) == 2 * 301


TURNS = st.lists(st.floats(2.0, 20.0), min_size=3, max_size=12)


@given(swings=TURNS, start=st.sampled_from(["low", "high"]), ends=st.sampled_from(["drop", "keep"]))
def test_cycles_follow_each_other_and_each_holds_one_swing(
    swings: list[float], start: str, ends: str
) -> None:
    """A course with known turning points, and ripples on it below the hysteresis."""
    corners = np.cumsum([0.0] + [s if k % 2 == 0 else -s for k, s in enumerate(swings)])
    value = np.concatenate(
        [np.linspace(a, b, 40, endpoint=False) for a, b in itertools.pairwise(corners)]
        + [corners[-1:]]
    )
    value = value + 0.2 * np.sin(np.arange(len(value)))
    turns = 40 * np.arange(1, len(swings))  # high, low, high ...
    wanted = turns[0::2] if start == "high" else turns[1::2]
    found = cycles_of(value, 1.0, start, ends)
    for (_, end), (begin, _) in itertools.pairwise(found):
        assert end == begin
    bounds = sorted({at for cycle in found for at in cycle} - {0, len(value)})
    if found:
        assert len(bounds) == len(wanted)
        assert all(abs(at - true) < 20 for at, true in zip(bounds, wanted, strict=True))
    if ends == "drop":
        assert len(found) == max(len(wanted) - 1, 0)
        assert all(begin > 0 and end < len(value) for begin, end in found)


@given(value=st.lists(st.floats(-0.4, 0.4), min_size=1, max_size=60))
def test_ripples_below_the_hysteresis_are_no_cycles(value: list[float]) -> None:
    for ends in ("drop", "keep"):
        assert cycles_of(np.array(value), 1.0, "low", ends) == []


def test_a_channel_that_does_not_swing_is_named(tmp_path: Path) -> None:
    write(tmp_path, {"t": range(30), "f": [5.0] * 30})
    cut = '[cut]\nby = ["cycles"]\ncycles = { channel = "force_n", hysteresis = 2.0 }\n'
    with pytest.raises(GapError, match=r"force_n of .*a\.csv makes no whole cycle .* spans 0"):
        trials(tmp_path, HEAD + FORCE + cut)


# ---------------------------------------------------------------------------- order and muscles


def settled(folder: Path, more: str = "", order: str = "") -> str:
    write(folder, {"l": [60, 60, 64, 64], "p": [100, 200, 100, 200], "f": [1, 2, 3, 4],
                   "m": ["A", "A", "B", "B"], "w": ["u", "d", "u", ""]})  # fmt: skip
    return (
        '[source]\nfiles = "a.csv"\n[time]\nsettled = true\n[channels.pressure_kpa]\n'
        'column = "p"\nunit = "kPa"\nreference = "gauge"\n' + FORCE + more
        + '[cut]\nby = ["column"]\ncolumns = ["l"]\n[trials]\n'
        f'held_length_mm = {{ column = "l", unit = "mm" }}\n{order}'
    )  # fmt: skip


def test_a_table_of_settled_points_gets_neither_time_nor_order(tmp_path: Path) -> None:
    imported(tmp_path, settled(tmp_path))
    samples = pd.read_parquet(tmp_path / "out" / "samples.parquet")
    rows = pd.read_csv(tmp_path / "out" / "trials.csv")
    assert "time_s" not in samples
    assert rows["order"].isna().all()
    assert rows["start_s"].isna().all()
    data = read_dataset(tmp_path / "out")
    assert data.settled
    assert [trial.held_length_mm for trial in data.trials] == [60.0, 64.0]
    assert np.isnan([trial.order for trial in data.trials]).all()


def test_rows_are_an_order_where_the_mapping_says_so(tmp_path: Path) -> None:
    imported(tmp_path, settled(tmp_path, order='order = "rows"\n'))
    assert [trial.order for trial in read_dataset(tmp_path / "out").trials] == [1.0, 2.0]


def test_files_without_a_common_clock_have_no_order_unless_stated(tmp_path: Path) -> None:
    for name in ("a1.csv", "a2.csv"):
        write(tmp_path, {"t": [0, 1], "f": [1.0, 2.0]}, name)
    text = HEAD.replace("a.csv", "a*.csv") + FORCE
    imported(tmp_path, text)
    rows = pd.read_csv(tmp_path / "out" / "trials.csv")
    assert rows[["order", "start_s"]].isna().all(axis=None)
    (tmp_path / "out").rename(tmp_path / "first")
    imported(tmp_path, text + '[trials]\norder = "files"\n')
    assert list(pd.read_csv(tmp_path / "out" / "trials.csv")["order"]) == [1, 2]


def test_dates_put_trials_in_order_whatever_the_files_are_called(tmp_path: Path) -> None:
    for name, day in (("a1.csv", "02"), ("a2.csv", "01")):
        times = [f"2026-03-{day}T09:00:0{k}+01:00" for k in range(2)]
        write(tmp_path, {"t": times, "f": [1.0, 2.0]}, name)
    imported(tmp_path, HEAD.replace("a.csv", "a*.csv").replace('"s"', '"ISO"') + FORCE)
    data = read_dataset(tmp_path / "out")
    assert [trial.name for trial in data.trials] == ["a2", "a1"]
    assert data.trials[1].start_s - data.trials[0].start_s == 86400.0


def test_the_way_of_settled_points_is_read(tmp_path: Path) -> None:
    way = '[channels.direction]\ncolumn = "w"\nup = "u"\ndown = "d"\n'
    imported(tmp_path, settled(tmp_path, way))
    data = read_dataset(tmp_path / "out")
    assert [trial.direction.tolist() for trial in data.trials] == [[1, -1], [1, 0]]


def test_several_muscles_make_a_folder_each(tmp_path: Path) -> None:
    more = "[muscles.A]\nbench = { braid_length_mm = 90.0 }\ncalibration = { force_zero_n = 0.2 }\n"
    muscle = 'muscle = { column = "m" }\n'
    made = imported(tmp_path, settled(tmp_path, order=muscle) + more)
    assert [one.muscle for one in made] == ["A", "B"]
    one, other = (read_dataset(tmp_path / "out" / name) for name in "AB")
    assert [len(one.trials), len(other.trials)] == [1, 1]
    assert one.constants.braid_length_m == 0.09
    assert other.constants.braid_length_m != 0.09
    assert one.calibration == {"force_zero_n": 0.2}
    assert not other.calibration


def test_a_muscle_in_the_name_of_the_file_has_its_own_rest_length(tmp_path: Path) -> None:
    for name in ("m-A.csv", "m-B.csv"):
        write(tmp_path, {"t": [0, 1], "l": [0.0, 10.0]}, name)
    imported(
        tmp_path,
        HEAD.replace("a.csv", "m-{muscle}.csv")
        + '[channels.length_mm]\ncolumn = "l"\nunit = "contraction %"\n'
        '[trials]\nmuscle = "{muscle}"\n'
        "[muscles.A]\nrest_length_mm = 60.0\n[muscles.B]\nrest_length_mm = 70.0\n",
    )
    found = [read_dataset(tmp_path / "out" / n).trials[0]["length_mm"].value for n in "AB"]
    np.testing.assert_allclose(found, [[60.0, 54.0], [70.0, 63.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "doubts"),
    [("ring_1bar.csv", False), ("ring_lc_1bar.csv", True)],
)  # fmt: skip
def test_a_name_that_the_pattern_fits_in_two_ways_is_said(
    name: str, doubts: bool, tmp_path: Path
) -> None:
    write(tmp_path, {"t": [0.0, 0.5, 1.0], "f": [1.0, 2.0, 3.0]}, name)
    text = HEAD.replace("a.csv", "{seal}_{bar}bar.csv") + FORCE + '[trials]\nslot = "{bar} bar"\n'
    (made,) = imported(tmp_path, text)
    said = [note for note in made.notes if "rename it" in note]
    wanted = (
        "ring_lc_1bar.csv: read as seal = ring, bar = lc_1, "
        "but its pattern fits seal = ring_lc, bar = 1 too; rename it"
    )
    assert said == ([wanted] if doubts else [])
