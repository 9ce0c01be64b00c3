"""Continue an unfinished test: same rig, same protocol, in a new run linked to the first."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.reporting.derived import try_derive
from cli.output import print_json
from cli.protocols.protocol_command import live_maker
from cli.protocols.terminal import ProgressLine, exit_status, print_result
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.record.sealed import plain
from daq.store.run import open_run
from daq.store.store import find_run, list_runs
from daq.user_program import installed
from rigs.execution.procedure import Plan, Procedure
from rigs.execution.resume import continuation
from rigs.execution.runner import Watch
from rigs.protocols.names import PROTOCOLS
from rigs.protocols.own import GROUP
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig

if TYPE_CHECKING:
    from daq.store.run import Run
    from rigs.execution.session import Result

IGNORED = ("source",)
"""Parameters that may differ: the path of a file does not change the test."""


def same_test(run: Run, rig: str = "", protocol: str = "") -> tuple[Procedure, RigConfig, Plan]:
    """Procedure, rig and parameters of a run, read again from their files.

    Args:
        run: an opened run.
        rig, protocol: files to read instead of those named in the record.

    Raises:
        ConfigError: a file is missing, or its content has changed.
    """
    manifest = run.manifest
    name = str(manifest.get("protocol"))
    if name not in {*PROTOCOLS, *installed(GROUP)}:
        raise ConfigError(
            run.run_id,
            f"{name!r} is not a protocol of this version or of an installed package",
            "a protocol in a file of your own is not continued; run it again",
        )
    seed = (manifest.get("virtual") or {}).get("seed")
    recorded_rig = manifest.get("rig") or {}
    config = load_rig(rig or _named(str(recorded_rig.get("source", ""))), seed)
    if recorded_rig.get("crc32") != config.crc32:
        raise ConfigError(
            config.source,
            f"has changed since run {run.run_id} (its checksum differs)",
            "restore it, or start a new test",
        )
    recorded = dict(manifest.get("parameters") or {})
    source = _named(str(recorded.get("source", "")))
    kind = procedure(name)
    plan = kind.read(protocol or source or name, config)
    now = json.loads(json.dumps(plain(plan.as_dict())))
    for key in sorted({*now, *recorded} - set(IGNORED)):
        if now.get(key) != recorded.get(key):
            raise ConfigError(
                f"{protocol or source}: {key}",
                f"was {recorded.get(key)!r} in run {run.run_id}, is {now.get(key)!r}",
                "restore the file, or start a new test",
            )
    return kind, config, plan


def _named(source: str) -> str:
    """The name of a shipped file, or the recorded path."""
    if source.startswith("configs/") and not Path(source).exists():
        return Path(source).stem
    return source


def last_part(run: Run, root: Path) -> Run:
    """The last continuation of a run, or the run itself.

    Raises:
        ConfigError: the test is complete, or two runs continue the same one.
    """
    after: dict[str, list[str]] = {}
    for info in list_runs(root):
        after.setdefault(info.continues, []).append(info.run_id)
    last, seen = run, {run.run_id}
    while following := [name for name in after.get(last.run_id, []) if name not in seen]:
        if len(following) > 1:
            raise ConfigError(
                last.run_id, f"is continued by {' and by '.join(following)}", "name one of them"
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
    live: bool = False,
    browser: bool = True,
) -> Result:
    """Make the trials that a test did not complete, in a new run beside the last one.

    If the run has continuations already, the last of them is continued.

    Raises:
        ConfigError: it cannot be continued, is complete, or its files have changed.
    """
    from rigs.execution.session import run_protocol

    root = Path(run.folder).resolve().parent
    run = last_part(run, root)
    continues = continuation(run)
    kind, config, plan = same_test(run, rig, protocol)
    if kind.done is not None:
        continues.update(kind.done(run))
    manifest = run.manifest
    make_live = live_maker(kind, plan, config, browser, []) if live else None
    return run_protocol(
        kind, config, plan, root,
        specimen=str(manifest.get("specimen") or ""),
        operator=operator or str(manifest.get("operator") or ""),
        note=note, stop=stop, watch=watch, on_start=on_start,
        make_live=make_live, continues=continues,
    )  # fmt: skip


def continue_command(
    run: str,
    runs: Path,
    rig: str,
    protocol: str,
    operator: str,
    note: str,
    as_json: bool,
    live: bool = False,
    browser: bool = True,
) -> int:
    """Continue a run and print the result; returns the exit status."""
    from daq.interrupt import stop_on_signals

    found = find_run(runs, run)
    line = ProgressLine(quiet=as_json)
    with stop_on_signals() as stop:
        result = continue_run(
            found, rig=rig, protocol=protocol, operator=operator, note=note,
            stop=stop, watch=line.watch(), on_start=line.start,
            live=live, browser=browser,
        )  # fmt: skip
    line.close()
    return _print(result, as_json)


def _print(result: Result, as_json: bool) -> int:
    """Derive table and report, print the result; returns the exit status."""
    not_derived = try_derive(result.folder, result.error)
    if not as_json:
        return print_result(result, not_derived)
    print_json(
        {
            "run_id": result.folder.name,
            "folder": str(result.folder),
            "outcome": result.outcome,
            "points": result.points,
            "planned": result.planned,
            "reason": str(result.error) if result.error else None,
        }
    )
    return exit_status(result)
