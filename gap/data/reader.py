"""Reads a folder in the dataset format: trials.csv, samples.csv or .parquet, bench.toml.

Beside them may lie calibration.toml: what the sensors may be off by in all trials alike.

A number that is silently wrong costs more than a file that is refused: whatever could be another
unit, a slip of the hand or a broken clock stops the reading with the file, the row and the column.
"""

from __future__ import annotations

import os
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from daq.calibration import StandardReading
from gap.data.dataset import CALIBRATION, DataSet
from gap.data.plausible import remarks
from gap.data.tables import Table, numbers, read_table, unit_check
from gap.data.trial import CHANNELS, COMMANDS, Channel, Trial
from gap.errors import GapError
from plant import tomlfile
from plant.arrays import Array
from plant.constants import PlantConstants, nominal
from plant.effects.effects import NONE, Effects
from plant.effects.empirical import UNCORRECTED, Corrections
from plant.errors import PlantError

TRIAL_TEXT = ("trial", "slot", "replicate", "protocol", "mounting")
TRIAL_NUMBERS = (
    "order", "held_length_mm", "load_kg", "temperature_c", "start_s",
    "tare_length_mm",
)  # fmt: skip
SAMPLE_NUMBERS = ("time_s", *COMMANDS, *CHANNELS, "taken_s")
MOST_UNCERTAIN = 1000.0
ORDER_UNKNOWN = (
    "the order of the trials is not known (trials.csv, column order): no effect that depends on it "
    "can be found"
)
SHORTEST_TRIAL_S = 1e-4
"""A tenth of a sample; a valve test takes a hundred times as long."""


def read_dataset(folder: str | Path) -> DataSet:
    """Read a data set from a folder in the dataset format.

    Raises:
        GapError: names the file, the row and the column, what came and what was expected.
    """
    path = Path(folder)
    if not os.path.exists(path):
        raise GapError(str(path), "no such folder", "check the path")
    if not path.is_dir():
        raise GapError(str(path), "is a file", "give the folder that holds trials.csv")
    bench = path / "bench.toml"
    constants, effects, corrections = (
        _bench(bench) if bench.exists() else (nominal(), NONE, UNCORRECTED)
    )
    trials = _trials_table(path / "trials.csv")
    samples = _samples_table(path)
    made = _join(path, trials, samples, constants, effects)
    return replace(
        made, calibration=_calibration(path / "calibration.toml"), corrections=corrections,
        standards=_standards(path / "standards.csv"),
        notes=(*made.notes, *remarks(made)),
    )  # fmt: skip


def read_bench(path: Path) -> tuple[PlantConstants, Effects]:
    """Constants and effects that a plant file states, over the nominal plant.

    Raises:
        GapError: it cannot be read, or states what the plant does not have, or an empirical term.
    """
    constants, effects, corrections = _bench(path)
    try:
        corrections.refuse("an export of runs")
    except PlantError as exc:
        raise GapError(str(path), str(exc)) from exc
    return constants, effects


def _bench(path: Path) -> tuple[PlantConstants, Effects, Corrections]:
    """What `bench.toml` states: constants, effects and empirical terms."""
    table = _toml(path)
    effects, empirical = table.pop("effects", {}), table.pop("empirical", {})
    try:
        constants = nominal().with_overrides(table, str(path))
        corrections = Corrections.from_config(empirical, f"{path} empirical")
        stated = Effects.from_config(effects, f"{path} effects")
        stated.check_actuator(constants, f"{path} effects")
        return constants, stated, corrections
    except PlantError as exc:
        said = str(exc).removeprefix(str(path)).removeprefix(":").strip()
        raise GapError(str(path), said) from exc


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomlfile.loads(tomlfile.read_text(path))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as exc:
        raise GapError(str(path), f"cannot be read as TOML ({exc})") from exc


def _calibration(path: Path) -> dict[str, float]:
    """Stated uncertainties of the sensors' calibrations, in the order of `CALIBRATION`."""
    table = _toml(path) if path.exists() else {}
    for key, value in table.items():
        where = f"{path}: {key}"
        if key not in CALIBRATION:
            raise GapError(where, "unknown key", f"known: {', '.join(CALIBRATION)}")
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not 0.0 <= value < MOST_UNCERTAIN:
            raise GapError(where, f"expected a standard uncertainty of 0 or more, got {value!r}")
    return {key: float(table[key]) for key in CALIBRATION if table.get(key)}


STANDARDS = {
    "length_mm": (0.0, 10_000.0), "held_length_mm": (0.0, 10_000.0),
    "pressure_kpa": (-1000.0, 10_000.0), "force_n": (-10_000.0, 10_000.0),
}  # fmt: skip
"""Channels that may have read a reference standard, and the bounds of its value and reading."""


def _standards(path: Path) -> tuple[StandardReading, ...]:
    """Readings of reference standards, in the order of the file."""
    if not path.exists():
        return ()
    table = read_table(path, ("channel", "true", "read", "u"), ("channel",))
    values = {name: numbers(table, name, nominal()) for name in ("true", "read", "u")}
    made = []
    for row, channel in enumerate(table.frame["channel"]):
        if channel not in STANDARDS:
            raise table.error(row, "channel", f"{channel!r}", f"one of {', '.join(STANDARDS)}")
        one = {name: float(column[row]) for name, column in values.items()}
        for name, value in one.items():
            if not np.isfinite(value):
                raise table.error(row, name, "is empty", "each reading has all four values")
        if one["u"] <= 0.0:
            raise table.error(row, "u", f"{one['u']:g}", "a standard uncertainty above 0")
        low, high = STANDARDS[channel]
        for name in ("true", "read"):
            if not low <= one[name] <= high:
                raise table.error(
                    row, name, f"{one[name]:g} is far outside the sensor's range",
                    f"allowed {low:g} to {high:g}; unit?",
                )  # fmt: skip
        made.append(StandardReading(channel, **one))
    return tuple(made)


def _trials_table(path: Path) -> Table:
    table = read_table(path, ("trial",), TRIAL_TEXT)
    unit_check(table, (*TRIAL_TEXT, *TRIAL_NUMBERS, "note"))
    names = table.frame["trial"]
    for row, name in enumerate(names):
        if not isinstance(name, str) or not name.strip():
            raise table.error(row, "trial", "is empty", "give every trial a name")
    repeated = names[names.duplicated()]
    if len(repeated):
        raise table.error(
            int(repeated.index[0]), "trial", f"{repeated.iloc[0]!r} appears a second time"
        )
    return table


def _samples_table(folder: Path) -> Table:
    found = [folder / name for name in ("samples.parquet", "samples.csv")]
    there = [path for path in found if path.exists()]
    if not there:
        raise GapError(str(folder), "holds neither samples.parquet nor samples.csv")
    if len(there) == 2:
        raise GapError(str(folder), "holds samples.parquet and samples.csv", "remove one of them")
    table = read_table(there[0], ("trial",), ("trial", "direction"))
    unit_check(table, ("trial", "direction", *SAMPLE_NUMBERS))
    if not any(name in table.frame for name in CHANNELS):
        raise GapError(
            str(there[0]), "has no measured column", f"expected some of {', '.join(CHANNELS)}"
        )
    return table


def _join(
    path: Path, trials: Table, samples: Table, constants: PlantConstants, effects: Effects
) -> DataSet:
    known = {name: row for row, name in enumerate(trials.frame["trial"])}
    owner = samples.frame["trial"]
    strange = np.flatnonzero(~owner.isin(list(known)).to_numpy())
    if len(strange):
        row = int(strange[0])
        raise samples.error(
            row, "trial", f"{owner.iloc[row]!r} is not in trials.csv", "add it there or drop it"
        )
    columns = {
        name: numbers(samples, name, constants) for name in SAMPLE_NUMBERS if name in samples.frame
    }
    facts = {name: numbers(trials, name, constants) for name in TRIAL_NUMBERS}
    direction = _directions(samples)
    rows_of = owner.groupby(owner, sort=False).indices
    notes = list(samples.notes + trials.notes)
    made: list[Trial] = []
    for name, row in known.items():
        rows = np.asarray(rows_of.get(name, ()), dtype=np.int64)
        if not len(rows):
            notes.append(f"trial {name} has no samples and is left out")
            continue
        made.append(_trial(samples, trials, row, np.sort(rows), columns, facts, direction))
    if all(np.isfinite(trial.order) for trial in made):
        made.sort(key=lambda trial: trial.order)
    elif len(made) > 1:
        notes.append(ORDER_UNKNOWN)
    return DataSet(str(path), tuple(made), constants, effects, tuple(notes))


def _trial(
    samples: Table,
    trials: Table,
    row: int,
    rows: npt.NDArray[np.int64],
    columns: dict[str, Array],
    facts: dict[str, Array],
    direction: npt.NDArray[np.int64],
) -> Trial:
    text = {name: _text(trials.frame, name, row) for name in TRIAL_TEXT}
    time_s, settled = _times(samples, rows, columns)
    channels: dict[str, Channel] = {}
    for name in (*COMMANDS, *CHANNELS):
        if name not in columns:
            continue
        value = columns[name][rows]
        here = np.isfinite(value)
        if here.any():
            channels[name] = Channel(time_s[here], value[here])
    order = facts["order"][row]
    return Trial(
        name=text["trial"],
        slot=text["slot"] or text["trial"],
        replicate=text["replicate"],
        protocol=text["protocol"] or "unnamed",
        mounting=text["mounting"],
        order=float(order),
        held_length_mm=float(facts["held_length_mm"][row]),
        load_kg=float(facts["load_kg"][row]),
        temperature_c=float(facts["temperature_c"][row]),
        start_s=float(facts["start_s"][row]),
        settled=settled,
        channels=channels,
        direction=direction[rows],
        tare_length_mm=float(facts["tare_length_mm"][row]),
        taken_s=_taken(samples, rows, columns) if settled else np.empty(0),
    )


def _taken(samples: Table, rows: npt.NDArray[np.int64], columns: dict[str, Array]) -> Array:
    """When the settled points of one trial were read; empty where it is not stated for all."""
    if "taken_s" not in columns:
        return np.empty(0)
    taken_s = columns["taken_s"][rows]
    if not np.isfinite(taken_s).all():
        return np.empty(0)
    twice = np.flatnonzero(np.diff(np.sort(taken_s)) == 0.0)
    if len(twice):
        at = np.sort(taken_s)[int(twice[0])]
        row = int(rows[np.flatnonzero(taken_s == at)[1]])
        what = f"{at:g} s appears a second time in this trial"
        raise samples.error(row, "taken_s", what, "one row for one trial and time")
    return taken_s


def _times(
    samples: Table, rows: npt.NDArray[np.int64], columns: dict[str, Array]
) -> tuple[Array, bool]:
    """Times of the rows of one trial, and whether it is a table of settled points."""
    count = np.arange(len(rows), dtype=np.float64)
    if "time_s" not in columns:
        return count, True
    time_s = columns["time_s"][rows]
    empty = ~np.isfinite(time_s)
    if empty.all():
        return count, True
    if empty.any():
        raise samples.error(
            int(rows[np.argmax(empty)]),
            "time_s",
            "is empty",
            "other rows of this trial have a time",
        )
    step = np.diff(time_s)
    wrong = np.flatnonzero(step <= 0.0)
    if len(wrong):
        at = int(wrong[0])
        what = (
            f"{time_s[at + 1]:g} s appears a second time in this trial"
            if step[at] == 0.0
            else f"runs backwards, from {time_s[at]:g} to {time_s[at + 1]:g} s"
        )
        raise samples.error(int(rows[at + 1]), "time_s", what, "one row for one trial and time")
    if len(step) and time_s[-1] - time_s[0] < SHORTEST_TRIAL_S:
        what = f"the trial lasts {time_s[-1] - time_s[0]:g} s, the least is {SHORTEST_TRIAL_S:g} s"
        raise samples.error(int(rows[-1]), "time_s", what, "are the times in seconds?")
    return time_s, False


def _directions(samples: Table) -> npt.NDArray[np.int64]:
    made = np.zeros(len(samples.frame), dtype=np.int64)
    if "direction" not in samples.frame:
        return made
    words = samples.frame["direction"]
    for row, word in enumerate(words):
        if not isinstance(word, str) or not word.strip():
            continue
        if word.strip() not in ("up", "down"):
            raise samples.error(row, "direction", f"{word!r}", "expected up or down")
        made[row] = 1 if word.strip() == "up" else -1
    return made


def _text(frame: pd.DataFrame, name: str, row: int) -> str:
    if name not in frame:
        return ""
    value: Any = frame[name].iloc[row]
    return value.strip() if isinstance(value, str) else ""
