"""What the commands on recorded runs do: index, find, export, remarks and exclusions."""

from __future__ import annotations

import json
import re
from datetime import date
from pathlib import Path
from typing import Any

import typer

from daq.errors import ConfigError, PamrigError
from daq.record.writer import OUTCOMES
from daq.store.annotations import annotate
from daq.store.index import rebuild_index
from daq.store.info import RunInfo
from daq.store.run import DAMAGED, INTERRUPTED
from daq.store.store import find_run, list_runs
from rigs.protocols.names import PROTOCOLS


def emit(value: Any) -> None:
    """Print one JSON value."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def index_command(runs: Path, as_json: bool) -> None:
    """Make the index anew and say what is in it."""
    found = rebuild_index(runs)
    if as_json:
        emit({"index": str(runs / "index.sqlite"), "runs": len(found)})
    else:
        typer.echo(f"{runs / 'index.sqlite'}: {len(found)} runs")


def find_command(runs: Path, as_json: bool, **wanted: str) -> None:
    """The runs that fit every condition."""
    for key in ("since", "until"):
        if wanted[key]:
            try:
                date.fromisoformat(wanted[key])
            except ValueError:
                raise ConfigError(f"--{key}", f"{wanted[key]!r} is no day", "2026-01-31") from None
    there = list_runs(runs)
    words = {"protocol": tuple(PROTOCOLS), "outcome": (*OUTCOMES, INTERRUPTED, DAMAGED)}
    for key, usual in words.items():
        known = sorted({*usual, *(str(getattr(info, key)) for info in there)} - {""})
        if wanted[key] and wanted[key] not in known:
            raise ConfigError(f"--{key}", f"{wanted[key]!r} is not one of {', '.join(known)}")
    found = [info for info in there if _fits(info, wanted)]
    if as_json:
        emit([info.as_dict() for info in found])
        return
    for info in found:
        typer.echo(f"{info.outcome:12} {info.protocol:18} {info.specimen:16} {info.run_id}")
    if not found:
        typer.echo(f"no run in {runs} fits")


def _fits(info: RunInfo, wanted: dict[str, str]) -> bool:
    day = info.started_utc[:10]
    return (
        wanted["specimen"].lower() in info.specimen.lower()
        and wanted["operator"].lower() in info.operator.lower()
        and wanted["protocol"] in ("", info.protocol)
        and wanted["outcome"] in ("", info.outcome)
        and (not wanted["since"] or day >= wanted["since"])
        and (not wanted["until"] or day <= wanted["until"])
    )


def export_command(
    run: str, runs: Path, kind: str, out: Path | None, what: str, as_json: bool
) -> None:
    """Write the files and name them."""
    from analysis.formats.export import export_run

    if what not in ("table", "samples", "all"):
        raise ConfigError("--what", f"{what!r} is not one of table, samples, all")
    written = export_run(find_run(runs, run), kind, out, what)
    if as_json:
        emit({"files": [str(path) for path in written]})
        return
    for path in written:
        typer.echo(str(path))


def remark_command(
    action: str, run: str, runs: Path, points: str, reason: str, who: str, as_json: bool
) -> None:
    """Append a remark; an exclusion makes table and report anew."""
    from analysis.reporting.derived import derive_all
    from analysis.run_table import reduce_run

    found = find_run(runs, run)
    numbers = point_numbers(points)
    if numbers:
        reduction = reduce_run(found)
        there = {int(order) for order in reduction.table["order"]}
        there |= {int(point["order"]) for point in reduction.excluded}
        missing = [n for n in numbers if n not in there]
        if missing:
            raise ConfigError(
                "--points",
                f"{found.run_id} has no point {missing[0]}",
                f"it has {min(there)} to {max(there)}" if there else "it has none",
            )
    made = annotate(found.folder, action, numbers, reason, who)
    not_made = ""
    try:
        derive_all(found.folder)
    except PamrigError as error:  # the remark is in the record, which is what counts
        not_made = str(error)
    if as_json:
        emit({**vars(made), "points": list(made.points), "run_id": found.run_id})
        return
    what = f"points {', '.join(map(str, made.points))}" if made.points else "the run"
    words = {"note": "noted about", "exclude": "excluded:", "include": "taken in again:"}
    typer.echo(f"{words[action]} {what}")
    if not_made:
        typer.echo(f"  table and report could not be made: {not_made}")


def point_numbers(text: str) -> list[int]:
    """Numbers from ``3,7-9``.

    Raises:
        ConfigError: something else stands there.
    """
    numbers: set[int] = set()
    for part in filter(None, (p.strip() for p in text.split(","))):
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", part)
        if match is None or (match[2] and int(match[2]) < int(match[1])):
            raise ConfigError("--points", f"{part!r} is no number or range", "as in 3,7-9")
        first = int(match[1])
        last = int(match[2] or first)
        if last - first > 100_000:
            raise ConfigError("--points", f"{part!r} is too long a range")
        numbers.update(range(first, last + 1))
    return sorted(numbers)
