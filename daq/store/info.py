"""The line of a run in a list of runs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.store.annotations import excluded_points
from daq.store.run import DAMAGED, Run

BENCH, VIRTUAL = "bench", "virtual"
"""Origin of a test on a real bench, and of one on the virtual bench."""
TESTS = (BENCH, VIRTUAL)
SIMULATED_BOARD = "sim"
"""What the controller of the virtual bench answers for its board."""


@dataclass(frozen=True)
class RunInfo:
    """One line of a list of runs.

    Attributes:
        run_id: name of the folder.
        started_utc: ISO time; empty if run.json is damaged.
        protocol, specimen, operator, rig: as in run.json.
        outcome: see :attr:`daq.store.run.Run.outcome`.
        duration_s: from start to final.json; None if interrupted.
        folder: path of the folder.
        excluded: number of excluded points; -1 if the annotations are damaged.
        continues: the run that this one continues; empty for none.
        origin: "bench", "virtual" (bench), "calibration", "simulation" or "import".
    """

    run_id: str
    started_utc: str
    protocol: str
    specimen: str
    outcome: str
    duration_s: float | None
    folder: str
    operator: str = ""
    rig: str = ""
    excluded: int = 0
    continues: str = ""
    origin: str = BENCH

    def as_dict(self) -> dict[str, Any]:
        """The attributes for ``--json``."""
        return asdict(self)


def run_info(run: Run) -> RunInfo:
    """Read the line of a run from its folder."""
    manifest = run.run_json or {}
    ended = ((run.final or {}).get("ended") or {}).get("t_ns")
    return RunInfo(
        run_id=run.run_id,
        started_utc=str(manifest.get("started", {}).get("utc", "")),
        protocol=str(manifest.get("protocol", DAMAGED if not manifest else "")),
        specimen=str(manifest.get("specimen", "")),
        outcome=run.outcome,
        duration_s=None if ended is None else ended * 1e-9,
        folder=str(run.folder),
        operator=str(manifest.get("operator") or ""),
        rig=str((manifest.get("rig") or {}).get("name", "")),
        excluded=_excluded(run.folder),
        continues=str((manifest.get("continues") or {}).get("run_id", "")),
        origin=_origin(manifest),
    )


def _origin(manifest: dict[str, Any]) -> str:
    if manifest.get("imported"):
        return "import"
    if manifest.get("simulated"):
        return "simulation"
    if str(manifest.get("protocol", "")).startswith("calibrate-"):
        return "calibration"
    return VIRTUAL if on_virtual_bench(manifest) else BENCH


def on_virtual_bench(manifest: dict[str, Any]) -> bool:
    """Whether a run was made on the virtual bench, also over ports."""
    valve = (manifest.get("devices") or {}).get("valve") or {}
    return bool(manifest.get("virtual")) or valve.get("board") == SIMULATED_BOARD


def _excluded(folder: Path) -> int:
    try:
        return len(excluded_points(folder))
    except RecordError:  # `pamrig runs verify` describes the damage
        return -1
