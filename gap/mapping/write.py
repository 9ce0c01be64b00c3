"""A mapping carried out: data sets written whole or not at all, and read as they will be read."""

from __future__ import annotations

import hashlib
import json
import math
import re
import shutil
import tempfile
from collections.abc import Iterator
from collections.abc import Mapping as MappingOf
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.errors import GapError
from gap.mapping.assemble import SAMPLE_COLUMNS, TRIAL_COLUMNS, MuscleSet, assemble
from gap.mapping.cost import Costs, costs_of
from gap.mapping.mapping import Mapping, Muscle, read_mapping
from gap.mapping.summary import (
    ChannelSummary,
    TrialSummary,
    channels_of,
    replicates_of,
    trials_of,
)

_PLAIN = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Imported:
    """One data set that an import makes.

    Attributes:
        muscle: its name; "" where the mapping names none.
        folder: where it is written.
        data: as the diagnosis reads it.
        replicates: number of trials of each slot.
        costs: what missing columns cost; None where nobody asked.
        notes: what a reader should know.
    """

    muscle: str
    folder: Path
    data: DataSet
    channels: tuple[ChannelSummary, ...]
    trials: tuple[TrialSummary, ...]
    replicates: MappingOf[str, int]
    costs: Costs | None
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON: null where something does not apply."""
        return {
            "muscle": self.muscle,
            "folder": str(self.folder),
            "channels": [_finite(asdict(channel)) for channel in self.channels],
            "trials": [_finite(asdict(trial)) for trial in self.trials],
            "replicates": dict(self.replicates),
            "missing": None if self.costs is None else asdict(self.costs),
            "notes": list(self.notes),
        }


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and v != v else v for k, v in values.items()}


def import_data(
    mapping_file: Path, out: Path, *, folder: Path | None = None, dry: bool = False
) -> list[Imported]:
    """Carry out a mapping file.

    Everything is written to a folder beside `out`, read back by the reader of the diagnosis, and
    only then renamed: an error leaves nothing behind.

    Args:
        mapping_file: the mapping.
        out: folder to make; with several muscles, one folder in it for each.
        folder: of the data files; by default that of the mapping file.
        dry: write nothing that stays, but compute what missing columns cost.

    Raises:
        GapError: names the file and row, or the mapping file and key.
    """
    mapping = read_mapping(mapping_file)
    if not dry and out.exists():
        raise GapError(str(out), "is there already", "choose another folder")
    sets = assemble(mapping, folder or mapping_file.parent)
    for one in sets:
        _check_name(mapping, one.name, len(sets))
    with _scratch(out, dry) as scratch:
        whole = scratch / "data"
        made = []
        for one in sets:
            inside = Path(one.name) if len(sets) > 1 else Path()
            _write(whole / inside, mapping, one)
            made.append(_read_back(whole / inside, out / inside, mapping, one, dry))
        if not dry:
            try:
                whole.rename(out)
            except OSError as error:
                raise GapError(str(out), f"cannot be made: {error.strerror}") from None
    return made


def _check_name(mapping: Mapping, name: str, count: int) -> None:
    if count > 1 and not (_PLAIN.fullmatch(name.replace(".", "_")) and name.strip(".")):
        raise GapError(
            f"{mapping.path}: trials.muscle", f"{name!r} cannot be the name of a folder",
            "use letters, digits, - and _",
        )  # fmt: skip


@contextmanager
def _scratch(out: Path, dry: bool) -> Iterator[Path]:
    """A folder that is gone afterwards; beside `out`, so that a rename is one step."""
    try:
        if not dry:
            out.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".pamrig-import-", dir=None if dry else out.parent))
    except OSError as error:
        raise GapError(str(out), f"cannot be made: {error.strerror}") from None
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _stated(mapping: Mapping, one: MuscleSet) -> Muscle:
    """What holds for a muscle: its own values over the common ones, and what its clocks leave."""
    own = mapping.muscles.get(one.name, Muscle())
    calibration = {**mapping.common.calibration, **own.calibration}
    for key, u_ms in one.clock_errors_ms.items():
        calibration[key] = float(f"{math.hypot(calibration.get(key, 0.0), u_ms):.6g}")
    return Muscle({**mapping.common.bench, **own.bench}, calibration)


def _write(folder: Path, mapping: Mapping, one: MuscleSet) -> None:
    stated = _stated(mapping, one)
    samples = pd.concat(one.samples, ignore_index=True)
    columns = [name for name in SAMPLE_COLUMNS if name in samples]
    try:
        folder.mkdir(parents=True)
        trials = pd.DataFrame(one.trials, columns=list(TRIAL_COLUMNS))
        trials.to_csv(folder / "trials.csv", index=False, lineterminator="\n")
        samples[columns].to_parquet(folder / "samples.parquet", index=False)
        for name, table in (("bench", stated.bench), ("calibration", stated.calibration)):
            if table:
                text = "\n".join(_toml(table, ())) + "\n"
                (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        about = json.dumps(_about(mapping, one), indent=2) + "\n"
        (folder / "import.json").write_text(about, encoding="utf-8")
    except OSError as error:
        raise GapError(str(folder), f"cannot be written: {error.strerror}") from None


def _about(mapping: Mapping, one: MuscleSet) -> dict[str, Any]:
    """Where the data came from: the mapping as it stood, and the files with their SHA-256."""
    files = sorted({path for recording in one.recordings for path in recording.files})
    return {
        "mapping": {"file": mapping.path.name, "text": mapping.text},
        "muscle": one.name,
        "files": [
            {"file": path.name, "bytes": path.stat().st_size, "sha256": _sha256(path)}
            for path in files
        ],
        "joins": [
            {"file": r.found.path.name, **asdict(r.offset)}
            for r in one.recordings
            if r.offset is not None
        ],
        "notes": one.notes,
    }


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _toml(table: MappingOf[str, Any], parts: tuple[str, ...]) -> list[str]:
    """A TOML table: its values, then the tables within."""
    lines = [f"[{'.'.join(json.dumps(part) for part in parts)}]"] if parts else []
    for key, value in table.items():
        if not isinstance(value, dict):
            lines.append(f"{json.dumps(key)} = {json.dumps(value)}")
    for key, value in table.items():
        if isinstance(value, dict):
            lines += ["", *_toml(value, (*parts, key))]
    return lines


def _read_back(
    written: Path, folder: Path, mapping: Mapping, one: MuscleSet, costs: bool
) -> Imported:
    """The data set as the diagnosis reads it; what it refuses, nobody gets."""
    try:
        data = read_dataset(written)
    except GapError as error:
        where = error.where.replace(str(written), f"{mapping.path}: the data set")
        raise GapError(where, error.what, error.remedy) from None
    known = any(row["order"] is not None for row in one.trials)
    return Imported(
        one.name, folder, data, tuple(channels_of(mapping, data)), tuple(trials_of(one, data)),
        replicates_of(data), costs_of(data, known) if costs else None,
        (*one.notes, *_beyond_the_plant(data), *data.notes),
    )  # fmt: skip


def _beyond_the_plant(data: DataSet) -> list[str]:
    """A note where lengths are of another muscle than the constants."""
    braid_mm = data.constants.braid_length_m * 1e3
    lengths = [float(t["length_mm"].value.max()) for t in data.trials if "length_mm" in t]
    lengths += [t.held_length_mm for t in data.trials if t.held_length_mm == t.held_length_mm]
    if max(lengths, default=0.0) <= braid_mm:
        return []
    return [
        f"lengths up to {max(lengths):g} mm exceed braid_length_mm = {braid_mm:g} of the plant: "
        "state the constants of this muscle in [bench]"
    ]
