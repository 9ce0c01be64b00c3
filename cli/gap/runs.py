"""`pamrig gap export`: recorded runs as a data set that anyone can read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Optional

import typer


def gap_export(
    runs: Annotated[list[str], typer.Argument(help="Run folders, run ids, or 'last'.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to make.")],
    folder: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = Path("runs"),
    plant: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--plant", help="Constants of the bench, as bench.toml holds them."),
    ] = None,
    points: Annotated[
        bool, typer.Option("--points", help="Settled points alone, without time.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON value, nothing else.")
    ] = False,
) -> None:
    """Write recorded runs as one data set in the dataset format."""
    from daq.store.store import find_run
    from gap.data.from_runs import export_runs

    found = [find_run(folder, run) for run in runs]
    made = export_runs(found, out, plant=plant, form="points" if points else "time")
    if as_json:
        values = {**vars(made), "folder": str(made.folder), "runs": list(made.runs)}
        typer.echo(json.dumps(values, indent=2, allow_nan=False))
        return
    typer.echo(
        f"{made.folder}: {made.trials} trials in {made.slots} slots, {made.rows} rows, "
        f"of {len(made.runs)} run{'s' if len(made.runs) > 1 else ''}"
    )
