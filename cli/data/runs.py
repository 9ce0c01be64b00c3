"""`pamrig runs ...`: list, show, verify, rebuild, index, find, export, archive, annotations."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.completion import run_names
from cli.options import RUNS, JsonOption, RunArgument, RunsOption
from cli.output import print_json, state_findings
from cli.progress import progress_line
from daq.errors import ConfigError

if TYPE_CHECKING:
    from daq.store.annotations import Annotation
    from daq.store.info import RunInfo
    from daq.store.run import Run

PointsOption = Annotated[
    str, typer.Option("--points", help="Numbers of points (order): 3,7-9. Default: the run itself.")
]
ReasonOption = Annotated[str, typer.Option("--reason", help="Reason; it stays in the record.")]
WhoOption = Annotated[str, typer.Option("--who", help="Name of the author.")]
EXPORTED = ("table", "samples", "all")
MAX_RANGE = 100_000


def add_runs(app: typer.Typer) -> None:
    """Add the commands of `pamrig runs`."""
    app.command("list")(list_all)
    for command in (show, verify, rebuild, index, find, export, archive):
        app.command()(command)
    for name, (action, done, summary) in ANNOTATIONS.items():
        app.command(name, help=summary)(_annotation(action, done))


def list_all(runs: RunsOption = RUNS, as_json: JsonOption = False) -> None:
    """List all runs, oldest first."""
    from daq.store.store import list_runs

    _folder_of_runs(runs)
    found = list_runs(runs)
    if as_json:
        print_json([info.as_dict() for info in found])
        return
    if not found:
        typer.echo(f"no runs in {runs}")
        return
    _print_list(found)


def _folder_of_runs(runs: Path) -> None:
    """Refuse a folder that is not there: an empty list would look like an empty folder.

    Raises:
        ConfigError: it does not exist, or is no folder.
    """
    if not runs.is_dir():
        what = "is not a folder" if runs.exists() else "there is no such folder"
        raise ConfigError(
            str(runs), what, "name the folder of your runs with --runs; a test makes it"
        )


def _print_list(found: list[RunInfo]) -> None:
    """Print runs as a table with a header; each column is as wide as its longest text."""
    head = ("outcome", "duration", "origin", "protocol", "specimen", "run")
    rows = [
        (
            info.outcome,
            "–" if info.duration_s is None else f"{info.duration_s:.1f} s",
            info.origin, info.protocol, info.specimen, info.run_id,
        )
        for info in found
    ]  # fmt: skip
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    for row in (head, *rows):
        cells = [f"{text:>{w}}" if i == 1 else f"{text:<{w}}"
                 for i, (text, w) in enumerate(zip(row, widths, strict=True))]  # fmt: skip
        typer.echo("  ".join(cells).rstrip())


def show(run: RunArgument = "last", runs: RunsOption = RUNS, as_json: JsonOption = False) -> None:
    """Show what a run contains and how it ended."""
    from daq.store.store import find_run, show

    facts = show(find_run(runs, run))
    if as_json:
        print_json(facts)
        return
    typer.echo(
        f"{facts['run_id']}\n  {facts['protocol']} of {facts['specimen']}: {facts['outcome']}"
    )
    final = facts.get("final") or {}
    if final.get("reason"):
        typer.echo(f"  because: {final['reason']}")
    typer.echo(
        f"  started {facts['started_utc']}, {facts['bytes'] / 1e6:.1f} MB, {facts['frames']} frames"
    )
    for name, stream in facts["streams"].items():
        if not stream:
            typer.echo(f"  stream {name}: not read")
            continue
        lost = f", {len(stream['lost_rows'])} damaged sections" if stream["lost_rows"] else ""
        typer.echo(f"  stream {name}: {stream['rows']} rows{lost}")
    counters = (final.get("counters") or {}).get("valve")
    if isinstance(counters, dict) and counters:
        missing, gaps, damaged, twice = (
            counters.get(key, "unknown") for key in ("missing", "gaps", "damaged", "duplicates")
        )
        typer.echo(
            f"  telemetry: {missing} samples missing in {gaps} gaps, {damaged} damaged frames, "
            f"{twice} duplicates"
        )
    lateness = final.get("lateness")
    for what in ("heartbeat", "reading", "program"):
        late = lateness.get(what) if isinstance(lateness, dict) else None
        if isinstance(late, dict):
            most, usual = late.get("max_ms", "unknown"), late.get("p99_ms", "unknown")
            typer.echo(f"  lateness of the {what}: at most {most} ms, 99 % below {usual} ms")
    typer.echo(
        "  events: " + ", ".join(f"{n} {kind}" for kind, n in sorted(facts["events"].items()))
    )
    typer.echo("  derived: " + (", ".join(facts["derived"]) or "nothing (pamrig runs rebuild)"))
    for name, settings in facts["versions"].items():
        chosen = {**settings.get("camera", {})}
        if "length_mm" in settings:
            chosen["calibration"] = settings["length_mm"].get("id", "")
        typer.echo(f"  version {name}: {chosen}")
    for problem in facts["problems"]:
        typer.echo(f"  PROBLEM {problem}")


def verify(run: RunArgument = "last", runs: RunsOption = RUNS, as_json: JsonOption = False) -> None:
    """Check every byte of a record against its checksums; exit status 1 on damage."""
    from daq.store.store import find_run
    from daq.store.verify import summary_of, unproven, verify

    found = find_run(runs, run)
    with progress_line("checking every byte"):
        problems = verify(found)
    note = unproven(found)
    if as_json:
        print_json(
            {
                "run_id": found.run_id,
                "outcome": found.outcome,
                "sound": not problems,
                "problems": summary_of(problems),
                "unproven": note,
            }
        )
    elif not problems:
        typer.echo(f"{found.run_id}: sound ({found.outcome})")
    else:
        typer.echo(f"{found.run_id} ({found.outcome}):")
        for problem in problems:
            typer.echo(f"  {problem}")
    if note and not as_json:
        typer.echo(f"  {note}")
    raise typer.Exit(1 if problems else 0)


def rebuild(
    run: RunArgument = "last",
    vision: Annotated[
        list[str] | None,
        typer.Option(
            "--vision",
            help="NAME=VALUE: other region, method, threshold, flip or calibration for its"
            " pictures. Makes table and report as a new version; nothing is replaced.",
        ),
    ] = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Make everything derived from the record again: table, samples, report, view."""
    from analysis.reporting.derived import derive_all, derive_version
    from analysis.run_table import record_findings
    from daq.store.store import find_run

    found = find_run(runs, run)
    if vision:
        from cli.data.pictures import vision_settings

        folder = derive_version(found.folder, vision_settings(vision))
        made_files = sorted(p.name for p in folder.iterdir())
        if as_json:
            told = {"run_id": found.run_id, "version": folder.name, "derived": made_files}
            print_json({**told, "problems": list(record_findings(found))})
        else:
            typer.echo(f"{folder}: {', '.join(made_files)}")
            state_findings(record_findings(found))
        return
    problems = record_findings(found)
    with progress_line("making all derived files"):
        made = derive_all(found.folder)
    names = sorted(p.name for p in (made.folder / "derived").iterdir())
    if as_json:
        print_json({"run_id": made.run_id, "derived": names, "problems": list(problems)})
    else:
        typer.echo(f"{made.folder / 'derived'}: {', '.join(names)}")
        state_findings(problems)


def index(runs: RunsOption = RUNS, as_json: JsonOption = False) -> None:
    """Rebuild the index of a folder of runs; `list` and `find` use it afterwards."""
    from daq.store.index import rebuild_index

    _folder_of_runs(runs)
    found = rebuild_index(runs)
    if as_json:
        print_json({"index": str(runs / "index.sqlite"), "runs": len(found)})
    else:
        typer.echo(f"{runs / 'index.sqlite'}: {len(found)} runs")


def find(
    specimen: Annotated[str, typer.Option(help="Part of the specimen's name.")] = "",
    protocol: Annotated[str, typer.Option(help="Protocol.")] = "",
    outcome: Annotated[str, typer.Option(help="clean, stopped, faulted, ...")] = "",
    operator: Annotated[str, typer.Option(help="Part of the operator's name.")] = "",
    since: Annotated[str, typer.Option(help="Started on this day or later: 2026-01-31.")] = "",
    until: Annotated[str, typer.Option(help="Started on this day or earlier.")] = "",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """List the runs that match every condition, oldest first."""
    from daq.record.writer import OUTCOMES
    from daq.store.run import DAMAGED, INTERRUPTED
    from daq.store.store import list_runs
    from rigs.protocols.names import PROTOCOLS

    _check_day("--since", since)
    _check_day("--until", until)
    _folder_of_runs(runs)
    all_runs = list_runs(runs)
    _check_known("--protocol", protocol, {*PROTOCOLS, *(i.protocol for i in all_runs)})
    outcomes = {*OUTCOMES, INTERRUPTED, DAMAGED, *(i.outcome for i in all_runs)}
    _check_known("--outcome", outcome, outcomes)

    def matches(info: RunInfo) -> bool:
        day = info.started_utc[:10]
        return (
            specimen.lower() in info.specimen.lower()
            and operator.lower() in info.operator.lower()
            and protocol in ("", info.protocol)
            and outcome in ("", info.outcome)
            and (not since or day >= since)
            and (not until or day <= until)
        )

    found = [info for info in all_runs if matches(info)]
    if as_json:
        print_json([info.as_dict() for info in found])
        return
    if found:
        _print_list(found)
    else:
        typer.echo(f"no run in {runs} matches")


def _check_day(option: str, day: str) -> None:
    from datetime import date

    try:
        if day:
            date.fromisoformat(day)
    except ValueError:
        raise ConfigError(option, f"{day!r} is not a date", "for example 2026-01-31") from None


def _check_known(option: str, value: str, known: set[str]) -> None:
    if value and value not in known:
        raise ConfigError(option, f"{value!r} is not one of {', '.join(sorted(known - {''}))}")


def export(
    run: RunArgument = "last",
    to: Annotated[str, typer.Option("--to", help="csv, parquet or mat.")] = "csv",
    out: Annotated[Path | None, typer.Option("--out", help="Folder to write to.")] = None,
    what: Annotated[str, typer.Option("--what", help="table, samples or all.")] = "all",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Write a run's table and samples for other programs; names contain the units."""
    from analysis.formats.export import export_run
    from analysis.run_table import record_findings
    from daq.store.store import find_run

    if what not in EXPORTED:
        raise ConfigError("--what", f"{what!r} is not one of {', '.join(EXPORTED)}")
    found = find_run(runs, run)
    with progress_line("writing tables"):
        files = [str(path) for path in export_run(found, to, out, what)]
    problems = record_findings(found)
    if as_json:
        print_json({"files": files, "problems": list(problems)})
        return
    for path in files:
        typer.echo(path)
    state_findings(problems)


def archive(
    run: Annotated[
        list[str],
        typer.Argument(help="Run folders, run ids, or 'last'.", autocompletion=run_names),
    ],
    title: Annotated[str, typer.Option("--title", help="Title of the data.")],
    author: Annotated[
        list[str], typer.Option("--author", help="Name, ORCID, affiliation; may be repeated.")
    ],
    licence: Annotated[
        str, typer.Option("--licence", help="SPDX identifier, or the address of the licence.")
    ] = "CC-BY-4.0",
    description: Annotated[
        str, typer.Option("--description", help="What the data are, in a few sentences.")
    ] = "",
    publisher: Annotated[
        str, typer.Option("--publisher", help="Institution that publishes the data.")
    ] = "",
    record: Annotated[
        bool, typer.Option("--record/--no-record", help="Also the raw records, byte for byte.")
    ] = True,
    out: Annotated[Path, typer.Option("--out", help="Archive to write (.zip).")] = Path("data.zip"),
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Pack runs for publication: one RO-Crate archive with units, sums, licence and citation."""
    from analysis.formats.archive import Publication, read_author, read_licence, write_archive
    from daq.store.store import find_run

    authors = tuple(read_author(text) for text in author)
    about = Publication(title, read_licence(licence), authors, description, publisher)
    found = [find_run(runs, name) for name in run]
    with progress_line("packing"):
        problems = write_archive(found, about, out, record)
    if as_json:
        print_json({"archive": str(out), "runs": [r.run_id for r in found], "problems": problems})
        return
    typer.echo(str(out))
    state_findings(problems)


ANNOTATIONS = {
    "annotate": ("note", "noted about", "Add a note about a run or some of its points."),
    "exclude": ("exclude", "excluded:", "Exclude points from table, fits and figures."),
    "include": ("include", "included again:", "Cancel an exclusion; both stay in the record."),
}
"""For each command: kind of annotation, text for the confirmation, help."""


def _annotation(action: str, done: str) -> Callable[..., None]:
    """The command for one kind of annotation."""

    def command(
        run: RunArgument = "last",
        points: PointsOption = "",
        reason: ReasonOption = "",
        who: WhoOption = "",
        runs: RunsOption = RUNS,
        as_json: JsonOption = False,
    ) -> None:
        from daq.store.store import find_run

        found = find_run(runs, run)
        with progress_line("making table and report"):
            made, not_derived = _annotate(found, action, points, reason, who)
        if as_json:
            print_json({**vars(made), "points": list(made.points), "run_id": found.run_id})
            return
        what = f"points {', '.join(map(str, made.points))}" if made.points else "the run"
        typer.echo(f"{done} {what}")
        if not_derived:
            typer.echo(f"  table and report could not be made: {not_derived}")

    return command


def _annotate(run: Run, action: str, points: str, reason: str, who: str) -> tuple[Annotation, str]:
    """Add an annotation to the record and derive table and report again.

    Returns the annotation, and why table and report could not be made, or "".
    """
    from analysis.reporting.derived import try_derive
    from analysis.run_table import reduce_run
    from daq.store.annotations import annotate

    numbers = point_numbers(points)
    if numbers:
        made = [event for event in run.events if event.get("kind") == "point"]
        known = {int(point["order"]) for point in made if "order" in point}
        if not known.issuperset(numbers):  # not every protocol numbers its points in the record
            reduction = reduce_run(run)
            known = {int(order) for order in reduction.table["order"]}
            known |= {int(point["order"]) for point in reduction.excluded}
        missing = [n for n in numbers if n not in known]
        if missing:
            raise ConfigError(
                "--points",
                f"{run.run_id} has no point {missing[0]}",
                f"it has {min(known)} to {max(known)}" if known else "it has none",
            )
    return annotate(run.folder, action, numbers, reason, who), try_derive(
        run.folder, only_results=True
    )


def point_numbers(text: str) -> list[int]:
    """Parse numbers and ranges such as ``3,7-9``; returns them sorted, without duplicates.

    Raises:
        ConfigError: the text is something else, or a range is too long.
    """
    numbers: set[int] = set()
    for part in filter(None, (p.strip() for p in text.split(","))):
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", part)
        if match is None or (match[2] and int(match[2]) < int(match[1])):
            raise ConfigError("--points", f"{part!r} is not a number or range", "as in 3,7-9")
        first = int(match[1])
        last = int(match[2] or first)
        if last - first > MAX_RANGE:
            raise ConfigError("--points", f"{part!r} is too long a range")
        numbers.update(range(first, last + 1))
    return sorted(numbers)
