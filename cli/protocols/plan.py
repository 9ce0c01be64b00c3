"""A plan: tests one after another over hours, stopped and gone on with at any moment.

How far a plan is stands in a journal beside it (``PLAN.journal``), one sealed line a test begun or
ended. A test that was broken off is continued after its last whole trial.
"""

from __future__ import annotations

import contextlib
import json
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from analysis.reporting.derived import try_derive
from daq.clock import RealClock
from daq.errors import ConfigError, PamrigError, RecordError
from daq.interrupt import StopFlag
from daq.record.disk import disk_error
from daq.record.sealed import read_lines, seal_line, write_all
from daq.store.run import Run, open_run
from rigs.execution.procedure import Plan
from rigs.execution.runner import Watch
from rigs.execution.session import Result, run_protocol
from rigs.protocols.names import PROTOCOLS, default_rig, default_specimen
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.rigfile.toml_reader import load_toml

JOURNAL = ".journal"
REST_STEP_S = 0.2


@dataclass(frozen=True)
class Item:
    """One test of a plan, checked beforehand."""

    number: int
    protocol: str
    file: str
    config: RigConfig
    plan: Plan
    specimen: str
    operator: str
    note: str
    rest_s: float


@dataclass(frozen=True)
class Chain:
    """A plan as read from its file."""

    name: str
    out: Path
    on_fault: str
    items: tuple[Item, ...]
    crc32: str
    path: Path

    @property
    def journal(self) -> Path:
        """Where it is noted how far the plan is."""
        return self.path.with_name(self.path.name + JOURNAL)


@dataclass
class Standing:
    """How far a plan is: the run that each test ended in, and the one that was begun last."""

    done: dict[int, str] = field(default_factory=dict)
    begun: dict[int, str] = field(default_factory=dict)


def load_plan(path: Path) -> Chain:
    """Read a plan and check every test of it against its rig before any is begun.

    Raises:
        ConfigError: names file, key and what to do.
    """
    t = load_toml(str(path), "plans")
    text = path.read_bytes()
    here = path.resolve().parent
    rig = t.text("rig", "")
    seed = t.integer("seed", 0, 2**63 - 1, -1) if "seed" in t else None
    specimen, operator = t.text("specimen", ""), t.text("operator", "")
    rows = t.raw("test", [])
    if not isinstance(rows, list) or not rows:
        raise t.fail("test", "a plan needs at least one [[test]]", "protocol = ... in each")
    items: list[Item] = []
    for index in range(len(rows)):
        one = t.row("test", index)
        protocol = one.text("protocol", choices=tuple(PROTOCOLS))
        file = one.text("file", protocol)
        name = one.text("rig", rig) or default_rig(protocol)
        try:
            config = load_rig(_beside(here, name), seed)
            plan = procedure(protocol).read(_beside(here, file), config)
        except PamrigError as error:
            where = f"{t.source}: {one.path}: {error.where}"
            raise ConfigError(where, error.what, error.remedy) from None
        repeats = one.integer("repeats", 1, 1000, 1)
        values = {
            "specimen": one.text("specimen", specimen) or default_specimen(protocol),
            "operator": one.text("operator", operator),
            "note": one.text("note", ""),
            "rest_s": one.number("rest_s", 0, 7 * 86400, 0.0, unit="s"),
        }
        one.finish()
        for _ in range(repeats):
            items.append(Item(len(items) + 1, protocol, file, config, plan, **values))  # type: ignore[arg-type]
    out = Chain(
        name=t.text("name", path.stem),
        out=here / t.text("out", "runs"),
        on_fault=t.text("on_fault", "stop", choices=("stop", "next")),
        items=tuple(items),
        crc32=f"{zlib.crc32(text):08x}",
        path=path,
    )
    t.finish()
    return out


def _beside(here: Path, name: str) -> str:
    """A file beside the plan, or the name as it stands."""
    beside = here / name
    return str(beside) if name.endswith(".toml") and beside.exists() else name


def standing(plan: Chain) -> Standing:
    """How far a plan is by its journal.

    Raises:
        ConfigError: the plan was changed since it was begun.
        RecordError: the journal is damaged.
    """
    out = Standing()
    if not plan.journal.is_file():
        return out
    for line in read_lines(plan.journal.read_bytes()):
        if line.fields is None:
            if not line.raw.endswith(b"\n"):
                break  # torn by a crash: what it was about shows in the runs themselves
            raise RecordError(
                str(plan.journal), "is damaged", "remove it to begin the plan anew (--again)"
            )
        fields = line.fields
        if fields["crc32"] != plan.crc32:
            raise ConfigError(
                str(plan.path),
                "was changed since it was begun",
                "restore it, or begin anew with --again",
            )
        if fields["what"] == "begun":
            out.begun[int(fields["test"])] = str(fields["run_id"])
        elif fields["what"] == "done":
            out.done[int(fields["test"])] = str(fields["run_id"])
    return out


def _note(plan: Chain, what: str, test: int, run_id: str, outcome: str = "") -> None:
    line = seal_line(
        {"what": what, "test": test, "run_id": run_id, "outcome": outcome, "crc32": plan.crc32}
    )
    try:
        fd = os.open(plan.journal, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            write_all(fd, line)
            os.fsync(fd)
        finally:
            os.close(fd)
    except OSError as error:
        raise disk_error(plan.journal, "cannot be written", error) from error


def run_chain(
    plan: Chain, stop: StopFlag, watch: Watch | None = None, on_start: Any = None
) -> list[Result]:
    """Run what is left of a plan; the results of the tests that were run now.

    Raises:
        PamrigError: a test could not even be begun.
    """
    far = standing(plan)
    results: list[Result] = []
    for item in plan.items:
        if item.number in far.done:
            continue
        if results or far.done:
            _rest(item, stop)
        if stop.reason:
            break
        result = _one(plan, item, far.begun.get(item.number), stop, watch, on_start)
        results.append(result)
        if result.outcome == "stopped" or stop.reason:
            break
        if result.outcome != "clean" and plan.on_fault == "stop":
            break
        _note(plan, "done", item.number, result.folder.name, result.outcome)
    return results


def _one(
    plan: Chain,
    item: Item,
    begun: str | None,
    stop: StopFlag,
    watch: Watch | None,
    on_start: Any,
) -> Result:
    """One test: new, or gone on with."""
    from cli.protocols.resume import continue_run

    def started(runner: Any, record: Any) -> None:
        _note(plan, "begun", item.number, record.folder.name)
        if on_start is not None:
            on_start(runner, record)

    before = _before(plan, begun)
    if before is not None:
        if before.outcome == "clean":  # it ended, and only the journal does not say so
            count = sum(event.get("kind") == "point" for event in before.events)
            return Result(before.folder, "clean", None, count, count)
        return _derived(continue_run(before, stop=stop, watch=watch, on_start=started))
    result = run_protocol(
        procedure(item.protocol), item.config, item.plan, plan.out,
        specimen=item.specimen, operator=item.operator, note=item.note,
        stop=stop, watch=watch, on_start=started,
    )  # fmt: skip
    return _derived(result)


def _derived(result: Result) -> Result:
    """The result, after making what is derived; a plan goes on where that is not possible."""
    try_derive(result.folder, result.error)
    return result


def _before(plan: Chain, begun: str | None) -> Run | None:
    if begun is None:
        return None
    with contextlib.suppress(RecordError):
        return open_run(plan.out / begun)
    return None


def _rest(item: Item, stop: StopFlag) -> None:
    """Let the specimen rest before a test; a virtual bench needs none."""
    if item.config.is_virtual:
        return
    clock = RealClock()
    left = item.rest_s
    while left > 0 and not stop.reason:
        clock.sleep(min(REST_STEP_S, left))
        left -= REST_STEP_S


def plan_command(path: Path, again: bool, as_json: bool) -> int:
    """Run a plan and say what came of each test; returns the exit status."""
    from cli.protocols.protocol_command import ProgressLine
    from daq.interrupt import stop_on_signals

    plan = load_plan(path)
    if again:
        plan.journal.unlink(missing_ok=True)
    before = standing(plan)
    line = ProgressLine(quiet=as_json)

    def started(runner: Any, record: Any) -> None:
        if not as_json:
            n = len(standing(plan).done) + 1
            typer.echo(f"test {n} of {len(plan.items)}: {record.folder.name}", err=True)
        line.start(runner, record)

    watch = Watch(
        state=line.state, point=lambda *_: line.redraw(), log=lambda t: typer.echo(t, err=True)
    )
    failed = ""
    results: list[Result] = []
    with stop_on_signals() as stop:
        try:
            results = run_chain(plan, stop, watch, started)
        except PamrigError as error:
            failed = str(error)
        stopped = bool(stop.reason)
    line.close()
    after = standing(plan)
    left = [item.number for item in plan.items if item.number not in after.done]
    faults = [r for r in results if r.outcome not in ("clean", "stopped")]
    status = 130 if stopped else 2 if failed or faults else 0
    if as_json:
        runs = [
            {"run_id": r.folder.name, "outcome": r.outcome, "points": r.points} for r in results
        ]
        typer.echo(
            json.dumps({"plan": plan.name, "runs": runs, "done": len(after.done), "left": left,
                        "error": failed or None}, indent=2, allow_nan=False)
        )  # fmt: skip
        return status
    if before.done:
        typer.echo(f"{len(before.done)} of {len(plan.items)} tests were done before")
    for result in results:
        typer.echo(
            f"{result.outcome}: {result.points} of {result.planned} points in {result.folder}"
        )
        if result.error:
            typer.echo(f"  because: {result.error}")
    if failed:
        typer.echo(f"pamrig: {failed}", err=True)
    typer.echo(
        f"{plan.name}: {len(after.done)} of {len(plan.items)} tests done"
        + (f"; run it again to go on with test {left[0]}" if left else "")
    )
    return status
