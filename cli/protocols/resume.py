"""Go on with a test that did not come to its end: same rig, same protocol, a run linked to it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from analysis.reporting.derived import try_derive
from cli.protocols.outcome import exit_status, print_result
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.record.sealed import plain
from daq.store.run import open_run
from daq.store.store import find_run, list_runs
from rigs.execution.procedure import Plan, Procedure
from rigs.execution.resume import continuation
from rigs.execution.runner import Watch
from rigs.protocols.names import PROTOCOLS
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig

if TYPE_CHECKING:
    from daq.store.run import Run
    from rigs.execution.session import Result

PASSING = ("source",)
"""Parameters that may differ: where a file lies says nothing about the test."""


def same_test(run: Run, rig: str = "", protocol: str = "") -> tuple[Procedure, RigConfig, Plan]:
    """The procedure, rig and parameters that a run was made with, read again.

    Args:
        run: an opened run.
        rig, protocol: files to read instead of those that the record names.

    Raises:
        ConfigError: a file is gone, or says something else by now.
    """
    manifest = run.manifest
    name = str(manifest.get("protocol"))
    if name not in PROTOCOLS:
        raise ConfigError(run.run_id, f"{name!r} is no protocol of this version", "")
    seed = (manifest.get("virtual") or {}).get("seed")
    said = manifest.get("rig") or {}
    config = load_rig(rig or _named(str(said.get("source", ""))), seed)
    if said.get("crc32") != config.crc32:
        raise ConfigError(
            config.source,
            f"is not what it was in run {run.run_id} (its check sum differs)",
            "restore it, or start a new test: what is measured on another rig is another test",
        )
    recorded = dict(manifest.get("parameters") or {})
    source = _named(str(recorded.get("source", "")))
    kind = procedure(name)
    plan = kind.read(protocol or source or name, config)
    now = json.loads(json.dumps(plain(plan.as_dict())))
    for key in sorted({*now, *recorded} - set(PASSING)):
        if now.get(key) != recorded.get(key):
            raise ConfigError(
                f"{protocol or source}: {key}",
                f"was {recorded.get(key)!r} in run {run.run_id}, is {now.get(key)!r}",
                "restore the file, or start a new test",
            )
    return kind, config, plan


def _named(source: str) -> str:
    """The name of a shipped file, or the path as it was."""
    if source.startswith("configs/") and not Path(source).exists():
        return Path(source).stem
    return source


def last_part(run: Run, root: Path) -> Run:
    """The last of the runs that go on with a run, or the run itself.

    Raises:
        ConfigError: the test has come to its end, or two runs go on with the same one.
    """
    after: dict[str, list[str]] = {}
    for info in list_runs(root):
        after.setdefault(info.continues, []).append(info.run_id)
    last, seen = run, {run.run_id}
    while following := [name for name in after.get(last.run_id, []) if name not in seen]:
        if len(following) > 1:
            raise ConfigError(
                last.run_id, f"is continued by {' and by '.join(following)}", "name one of these"
            )
        last = open_run(root / following[0])
        seen.add(last.run_id)
    if last is not run and last.outcome == "clean":
        raise ConfigError(
            run.run_id, f"is continued by {last.run_id}, which ran to its end", "start a new test"
        )
    return last


def continue_run(
    run: Run,
    *,
    rig: str = "",
    protocol: str = "",
    operator: str = "",
    note: str = "",
    stop: StopFlag | None = None,
    watch: Watch | None = None,
    on_start: Callable[..., None] | None = None,
) -> Result:
    """Make the trials that a test did not bring to their end, into a run beside the last one.

    A run that was gone on with already, and broken off again, stands for its test: what goes on
    is the last of its continuations.

    Raises:
        ConfigError: it cannot be continued, has come to its end, or its files have changed.
    """
    from rigs.execution.session import run_protocol

    root = Path(run.folder).resolve().parent
    run = last_part(run, root)
    continues = continuation(run)
    kind, config, plan = same_test(run, rig, protocol)
    manifest = run.manifest
    return run_protocol(
        kind, config, plan, root,
        specimen=str(manifest.get("specimen") or ""),
        operator=operator or str(manifest.get("operator") or ""),
        note=note, stop=stop, watch=watch, on_start=on_start,
        continues=continues,
    )  # fmt: skip


def continue_command(
    run: str, runs: Path, rig: str, protocol: str, operator: str, note: str, as_json: bool
) -> int:
    """Go on with a run and say what came of it; returns the exit status."""
    from cli.protocols.protocol_command import ProgressLine
    from daq.interrupt import stop_on_signals

    found = find_run(runs, run)
    line = ProgressLine(quiet=as_json)
    watch = Watch(
        state=line.state, point=lambda *_: line.redraw(), log=lambda t: typer.echo(t, err=True)
    )
    with stop_on_signals() as stop:
        result = continue_run(
            found, rig=rig, protocol=protocol, operator=operator, note=note,
            stop=stop, watch=watch, on_start=line.start,
        )  # fmt: skip
    line.close()
    return _print(result, as_json)


def _print(result: Result, as_json: bool) -> int:
    """Print a result after making what is derived; returns the exit status."""
    not_derived = try_derive(result.folder, result.error)
    if not as_json:
        return print_result(result, not_derived)
    value: dict[str, Any] = {
        "run_id": result.folder.name,
        "folder": str(result.folder),
        "outcome": result.outcome,
        "points": result.points,
        "planned": result.planned,
        "reason": str(result.error) if result.error else None,
    }
    typer.echo(json.dumps(value, indent=2, allow_nan=False))
    return exit_status(result)
