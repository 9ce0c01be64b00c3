"""pamrig for notebooks: ``import pamrig; pamrig.open_run("last").table``.

A small interface to the other packages. Column names contain the units.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from daq.store.run import Run
    from gap.data.simulator import ExternalSimulator
    from gap.verdict import Verdict
    from rigs.interactive.client import InteractiveRig

NEWEST_S = 1.0
"""Older readings of a slow stream are left out of `RecordedRun.joined`."""

__all__ = ["RecordedRun", "diagnose", "open_rig", "open_run", "runs", "simulate"]


def __getattr__(name: str) -> Any:
    """`pamrig.figures` without an import of its own, loaded when it is used first."""
    if name != "figures":
        raise AttributeError(f"module 'pamrig' has no attribute {name!r}")
    import importlib

    return importlib.import_module("pamrig.figures")


class RecordedRun:
    """A recorded run as tables.

    Attributes:
        run: the record, with raw streams and frames (`daq.store.run.Run`).
    """

    def __init__(self, run: Run) -> None:
        self.run = run

    @property
    def problems(self) -> tuple[str, ...]:
        """What a check of the record found; empty for a sound record."""
        from daq.store.verify import findings

        return findings(self.run)

    @property
    def table(self) -> pd.DataFrame:
        """Settled points, one per row: pressure_kpa, length_mm, force_n, ... and u_ columns.

        Derived from the record if that has not been done yet.
        """
        if not (self.run.folder / "derived" / "table.parquet").is_file():
            from analysis.reporting.derived import derive_all

            self.run = derive_all(self.run.folder)
        return self.run.table

    @property
    def samples(self) -> pd.DataFrame:
        """The 1 kHz stream in engineering units: time_s, pressure_kpa, setpoint_kpa, ..."""
        return self.stream("valve")

    def stream(self, name: str) -> pd.DataFrame:
        """Any stream in engineering units.

        Args:
            name: of the stream: ``valve``, ``balance``, ``points``, or that of an instrument.

        Raises:
            daq.errors.RecordError: the run has no such stream.
        """
        import pandas as pd

        from daq.store.derive import engineering

        columns, _ = engineering(self.run, name)
        return pd.DataFrame(columns)

    def xarray(self, name: str = "valve") -> Any:
        """A stream as `xarray.Dataset` over ``time_s``, with the unit of each variable.

        Needs the extra ``pamrig[xarray]``.

        Args:
            name: of the stream: ``valve``, ``balance``, ...

        Raises:
            ModuleNotFoundError: xarray is not installed.
        """
        try:
            import xarray as xr
        except ModuleNotFoundError:
            text = "xarray is not installed (pip install 'pamrig[xarray]')"
            raise ModuleNotFoundError(text, name="xarray") from None

        from analysis.formats.columns import described

        table = self.stream(name)
        data = xr.Dataset.from_dataframe(table.set_index("time_s"))
        for column in described([str(c) for c in table.columns]):
            data[column.name].attrs["long_name"] = column.meaning
            if column.unit:
                data[column.name].attrs["units"] = column.unit
        data.attrs |= {"run_id": self.run.run_id, "outcome": self.outcome}
        return data

    @property
    def joined(self) -> pd.DataFrame:
        """Force, pressure and all other readings in one table, a row per 1 kHz sample.

        Each row has the newest reading of every slower stream at its time; none if that is older
        than `NEWEST_S`.
        """
        import pandas as pd

        table = self.samples
        for name in self.run.streams:
            other = self.stream(name)
            if name == "valve" or "time_s" not in other or not len(other):
                continue
            new = [c for c in other.columns if c == "time_s" or c not in table]
            tolerance: Any = NEWEST_S  # the stubs know of dates only
            table = pd.merge_asof(
                table.sort_values("time_s"), other[new].sort_values("time_s"),
                on="time_s", direction="backward", tolerance=tolerance,
            )  # fmt: skip
        return table

    @property
    def events(self) -> pd.DataFrame:
        """Events, one per row, with time_s since the start."""
        import pandas as pd

        table = pd.DataFrame(self.run.events)
        if len(table):
            table.insert(0, "time_s", table.pop("t_ns") * 1e-9)
        return table

    @property
    def outcome(self) -> str:
        """clean, stopped, aborted, faulted, interrupted or damaged."""
        return self.run.outcome

    def __repr__(self) -> str:
        return f"RecordedRun({self.run.run_id!r}, {self.outcome})"


def open_run(run: str | Path = "last", runs: str | Path = "runs") -> RecordedRun:
    """Open a run by folder, by id, by part of its id, or the last one.

    The record is checked; what is wrong with it is warned of, and stands in ``problems``.

    Args:
        run: folder, id or part of the id of the run, or "last".
        runs: folder in which an id is looked for.

    Raises:
        daq.errors.RecordError: no run matches, or several do.
    """
    from daq.store.store import find_run

    opened = RecordedRun(find_run(Path(runs), str(run)))
    for text in opened.problems:
        warnings.warn(f"{opened.run.run_id}: {text}", stacklevel=2)
    return opened


def open_rig(rig: str | Path = "virtual", runs: str | Path = "runs", **more: Any) -> InteractiveRig:
    """Open a rig to drive it by hand from a notebook or a script.

    ``with pamrig.open_rig("bench.toml") as rig: ...``; see
    `rigs.interactive.client.InteractiveRig` for its methods and for ``more``.

    Args:
        rig: rig file, or the name of a shipped one.
        runs: folder of runs.
        more: specimen, operator, note, seed, idle_s and log of `InteractiveRig`.

    Raises:
        daq.errors.PamrigError: the rig cannot be opened; names device or file, key and remedy.
    """
    from rigs.interactive.client import InteractiveRig

    return InteractiveRig(rig, runs, **more)


def runs(folder: str | Path = "runs") -> pd.DataFrame:
    """All runs of a folder as a table to filter, oldest first; the index is the run's name.

    ``runs().query("protocol == 'isometric' and outcome == 'clean'").index`` are names for
    `open_run`. ``started`` is a time with time zone, ``duration_s`` NaN for an interrupted run.

    Args:
        folder: of the runs.
    """
    import pandas as pd

    from daq.store.info import RunInfo
    from daq.store.store import list_runs

    rows: list[dict[str, Any]] = [info.as_dict() for info in list_runs(folder)]
    table = pd.DataFrame(rows, columns=list(RunInfo.__dataclass_fields__))
    table["duration_s"] = table["duration_s"].astype(float)
    started = pd.to_datetime(table["started_utc"], utc=True, errors="coerce")
    table.insert(1, "started", started)
    return table.set_index("run_id", drop=False)


def diagnose(
    data: str | Path,
    without: Iterable[str] = (),
    simulator: str | Path | ExternalSimulator | None = None,
) -> Verdict:
    """Diagnose a data set in the dataset format; see `gap.decision.diagnose.diagnose`.

    `verdict.as_dict()` is the object that `pamrig gap diagnose --json` prints.

    Args:
        data: the folder.
        without: effects to remove from the catalogue.
        simulator: your own, in the place of the built-in plant: its description
            (docs/use/your-simulator.md), or an object with that interface. A description may name
            a program, which is then run.

    Raises:
        gap.errors.GapError: the data cannot be used; names file, row and column.
    """
    from gap.data.reader import read_dataset
    from gap.decision.diagnose import diagnose as diagnose_dataset
    from gap.simulators.open import with_simulator

    return diagnose_dataset(with_simulator(read_dataset(data), simulator), without)


def simulate(scenario: str | Path, runs: str | Path = "runs") -> RecordedRun:
    """Simulate a scenario (file or shipped name) with the firmware in the loop; returns the run.

    Args:
        scenario: scenario file, or the name of a shipped one.
        runs: folder of runs.

    Raises:
        daq.errors.PamrigError: names the invalid file and key, or why the simulation ended early.
    """
    from analysis.reporting.derived import derive_all
    from studies.simulation.scenario import load_scenario
    from studies.simulation.session import simulate as run_scenario

    result = run_scenario(load_scenario(str(scenario)), runs)
    return RecordedRun(derive_all(result.folder))
