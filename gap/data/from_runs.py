"""Recorded runs as a data set in the dataset format: trials.csv, samples.parquet, bench.toml; and
calibration.toml, what the sensors may be off by in all trials alike. A single run can be read the
same way without leaving files.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
import tomllib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.run_table import contents_of
from daq.calibration import StandardReading
from daq.errors import RecordError
from daq.store.run import Run, open_run
from daq.store.verify import findings
from daq.wholefile import whole_files
from gap.data.dataset import DataSet
from gap.data.joint_trials import MUSCLES, is_joint, joint_calibration, joint_trials
from gap.data.reader import read_bench, read_dataset
from gap.data.regulator import regulator_notes
from gap.data.run_tables import table_trials
from gap.data.run_trials import RunTrial, run_trials, tares
from gap.errors import GapError
from plant import tomlfile
from plant.constants import CHOICES, KEYS

COLUMNS = ("trial", "slot", "replicate", "protocol", "mounting", "order", "held_length_mm",
           "load_kg", "temperature_c", "start_s", "tare_length_mm", "note")  # fmt: skip


@dataclass(frozen=True)
class Exported:
    """What an export wrote, what a check of the records found, and what a reader should know."""

    folder: Path
    trials: int
    slots: int
    rows: int
    runs: tuple[str, ...]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def export_runs(
    runs: Sequence[Run],
    folder: Path,
    *,
    plant: Path | None = None,
    form: str = "time",
    commands_of: Collection[str] | None = None,
    muscle: str = "a",
    standards: Sequence[StandardReading] = (),
) -> Exported:
    """Write runs as one data set; trials keep the order in which they were measured.

    Args:
        runs: of any protocols, of one bench.
        folder: made if need be; it must hold no data set yet.
        plant: what of the bench differs from the nominal plant (a `bench.toml`); by
            default the file of that name beside the rig file, or what a virtual rig states.
        form: "time" for channels against time, "points" for the settled points alone. A run of
            settled points from elsewhere has no other form.
        muscle: which one of a joint, "a" or "b"; runs of one muscle have no other.
        standards: what the instruments read of reference standards.

    Raises:
        GapError: the folder is taken, the plant file cannot be read, or runs contradict each other.
        RecordError: a run holds no trial, or is damaged.
    """
    if not runs:
        raise GapError("export", "no run given")
    if muscle not in MUSCLES:
        raise GapError("--muscle", f"{muscle!r} is not one of {', '.join(MUSCLES)}")
    problems = {run.run_id: findings(run) for run in runs}
    bench = _bench(runs, plant)
    with contents_of(runs[0]):
        calibration = _calibration(runs, muscle)
    trials: list[RunTrial] = []
    notes: list[str] = []
    known: dict[str, list[str]] = {}
    tared_mm: float | None = None
    # Whole runs follow each other: on a simulated bench the clock of a run does not go as ours.
    for run in sorted(runs, key=lambda run: int(run.manifest["started"].get("wall_ns", 0))):
        with contents_of(run):
            of_regulator = regulator_notes(run)
            notes += of_regulator
            own = list(
                joint_trials(run, muscle)
                if is_joint(run)
                else _trials(run, form, commands_of, tared_mm)
            )
            tared_mm = tares(run, tared_mm)[-1][1]  # a balance keeps its tare from run to run
            for trial in own:
                trial.row["slot"] += _told_apart(run, known)
                words = list(of_regulator)
                if problems[run.run_id]:
                    count = len(problems[run.run_id])
                    words.append(f"{run.run_id}: {count} findings in its record")
                if words:
                    trial.row["note"] = "; ".join(words)
            trials += sorted(own, key=lambda trial: float(trial.row["start_s"]))
    made = _write(folder, trials, bench, calibration, standards, tuple(run.run_id for run in runs))
    named = (f"{name}: {text}" for name, found in problems.items() for text in found)
    return dataclasses.replace(made, problems=tuple(named), notes=tuple(notes))


def _trials(
    run: Run, form: str, commands_of: Collection[str] | None, tared_mm: float | None
) -> Iterable[RunTrial]:
    _refuse_mechanism(run)
    if form == "points" or run.manifest.get("imported"):
        return table_trials(run)
    wanted = commands_of is None or run.manifest.get("protocol") in commands_of
    return run_trials(run, wanted, tared_mm)


NO_SETTING = (
    "name", "source", "repeats", "mountings", "mounting", "order", "seed", "leak", "frames",
)  # fmt: skip


def _told_apart(run: Run, known: dict[str, list[str]]) -> str:
    """A number that separates the slots of a run from those of the same protocol, other settings.

    Trials of one slot are replicates, and those of other settings are none.
    """
    seen = known.setdefault(str(run.manifest.get("protocol")), [])
    text = json.dumps(_settings(run.manifest.get("parameters") or {}), sort_keys=True)
    if text not in seen:
        seen.append(text)
    number = seen.index(text) + 1
    return f" ({number})" if number > 1 else ""


def _settings(parameters: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _settings(value) if isinstance(value, dict) else value
        for key, value in parameters.items()
        if key not in NO_SETTING
    }


def _refuse_mechanism(run: Run) -> None:
    """A simulation of joints or of the ram is no trial of one muscle."""
    load = (run.manifest.get("parameters") or {}).get("load")
    if run.manifest.get("protocol") == "simulate" and load not in ("held", "hung"):
        raise RecordError(
            str(run.folder),
            f"simulates a load of kind {load!r}; a data set holds trials of one muscle",
            "export a scenario whose load is held or hung",
        )


def _write(
    folder: Path, trials: Sequence[RunTrial], bench: dict[str, Any],
    calibration: dict[str, float], standards: Sequence[StandardReading], runs: tuple[str, ...],
) -> Exported:  # fmt: skip
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GapError(str(folder), f"cannot be made: {error.strerror}") from None
    for name in ("trials.csv", "samples.csv", "samples.parquet"):
        if (folder / name).exists():
            raise GapError(str(folder / name), "is there already", "choose another folder")
    rows = [{**trial.row, "order": number} for number, trial in enumerate(trials, start=1)]
    frames = []
    for trial in trials:
        frame = trial.samples.copy()
        frame.insert(0, "trial", trial.row["trial"])
        frames.append(frame)
    samples = pd.concat(frames, ignore_index=True)
    try:
        with whole_files() as part:
            table = pd.DataFrame(rows, columns=list(COLUMNS))
            table.to_csv(part(folder / "trials.csv"), index=False)
            samples.to_parquet(part(folder / "samples.parquet"), index=False)
            if standards:
                text = standards_text(standards)
                part(folder / "standards.csv").write_text(text, encoding="utf-8")
            for name, values in (("bench.toml", bench), ("calibration.toml", calibration)):
                if values:
                    part(folder / name).write_text(_toml_text(values), encoding="utf-8")
    except OSError as error:
        raise GapError(str(folder), f"cannot be written: {error.strerror}") from None
    slots = len({row["slot"] for row in rows})
    return Exported(folder, len(rows), slots, len(samples), runs)


def standards_text(readings: Iterable[StandardReading]) -> str:
    """What instruments read of standards as the text of a `standards.csv`."""
    return str(pd.DataFrame([vars(one) for one in readings]).to_csv(index=False))


def _bench(runs: Sequence[Run], plant: Path | None) -> dict[str, Any]:
    """Constants that differ from the nominal plant: of a file, or of the virtual rig's own text."""
    if plant is not None:
        return stated_plant(plant)
    stated = [(run, _stated(run)) for run in runs]
    for run, table in stated:
        if table != stated[0][1]:
            raise GapError(
                str(run.folder),
                f"was recorded on another bench than {stated[0][0].run_id}",
                "export runs of one bench at a time, or name its constants with --plant",
            )
    return stated[0][1]


def stated_plant(path: Path) -> dict[str, Any]:
    """What a plant file states, `[effects.<id>]` included.

    Raises:
        GapError: it cannot be read, or states what the plant does not have.
    """
    read_bench(path)
    return tomlfile.loads(tomlfile.read_text(path))


def _calibration(runs: Sequence[Run], muscle: str) -> dict[str, float]:
    """What each sensor's zero and gain may be off by in all trials alike, the largest of the runs.

    A force zero is left anew by each tare, so its trials tell; what they share is no calibration.
    """
    found: dict[str, float] = {}
    for run in runs:
        if is_joint(run):
            for key, value in joint_calibration(run, muscle).items():
                found[key] = max(found.get(key, 0.0), value)
            continue
        for quantity, known in run.calibrations.items():
            name, _, unit = quantity.rpartition("_")
            zero, gain = f"{name}_zero_{unit}", f"{name}_gain_percent"
            if quantity in ("pressure_kpa", "length_mm"):
                found[zero] = max(found.get(zero, 0.0), float(known.u_offset))
            elif quantity != "force_n":
                continue
            found[gain] = max(found.get(gain, 0.0), 100.0 * float(known.u_gain))
    return {key: value for key, value in found.items() if value > 0.0}


def _read(path: Path) -> dict[str, Any]:
    try:
        table = tomlfile.loads(tomlfile.read_text(path))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise GapError(str(path), f"cannot be read as TOML ({error})") from None
    return {key: value for key, value in table.items() if key in KEYS or key in CHOICES}


def _stated(run: Run) -> dict[str, Any]:
    """The plant that a simulation or a virtual rig's file states, or the rig's `bench.toml`."""
    if run.manifest.get("protocol") == "simulate":
        return dict((run.manifest.get("virtual") or {}).get("plant") or {})
    beside = Path(str(run.manifest.get("rig", {}).get("source", ""))).parent / "bench.toml"
    if beside.is_file():
        return _read(beside)
    try:
        table = tomlfile.loads(str(run.manifest.get("rig", {}).get("text", "")))
    except tomllib.TOMLDecodeError:
        return {}
    virtual = table.get("virtual", {})
    stated = virtual.get("plant", {}) if isinstance(virtual, dict) else {}
    if not isinstance(stated, dict):
        return {}
    return {key: value for key, value in stated.items() if key in KEYS or key in CHOICES}


def _toml_text(table: dict[str, Any]) -> str:
    """A plant file: constants, then a table for each effect."""
    lines = [f"{key} = {_toml(value)}" for key, value in table.items() if key != "effects"]
    for name, effect in table.get("effects", {}).items():
        lines += ["", f"[effects.{name}]", *(f"{k} = {_toml(v)}" for k, v in effect.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return repr(float(value))


def open_data(path: str | Path) -> DataSet:
    """Read a folder in the dataset format, or a run folder as `pamrig gap export` would write it.

    Raises:
        GapError: it is neither, or cannot be read.
        RecordError: the run holds no trial, or is damaged.
    """
    folder = Path(path)
    if not (folder / "run.json").is_file():
        return read_dataset(folder)
    with tempfile.TemporaryDirectory(prefix="pamrig-gap-") as scratch:
        made = Path(scratch) / "data"
        exported = export_runs([open_run(folder)], made)
        found = read_dataset(made)
    notes = (*found.notes, *exported.notes, *exported.problems)
    return dataclasses.replace(found, origin=str(folder), notes=notes)
