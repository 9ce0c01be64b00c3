"""A plan: a sequence of tests that can be stopped and continued at any time.

A journal beside the plan (``PLAN.journal``) has one line, with checksum, for each test started or
completed. An interrupted test is continued after its last complete trial.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from analysis.reporting.derived import try_derive
from cli.output import print_json
from cli.protocols.resume import continue_run
from cli.protocols.terminal import ProgressLine, print_outcome
from daq.clock import RealClock
from daq.errors import ConfigError, PamrigError, RecordError
from daq.interrupt import StopFlag, stop_on_signals
from daq.record.disk import disk_error
from daq.record.safe_read import read_inside
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
class PlannedTest:
    """One test of a plan; its files were read without error."""

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
class TestPlan:
    """A plan as read from its file."""

    __test__ = False  # not a pytest class

    name: str
    out: Path
    on_fault: str
    items: tuple[PlannedTest, ...]
    crc32: str
    path: Path

    @property
    def journal(self) -> Path:
        """Path of the journal."""
        return self.path.with_name(self.path.name + JOURNAL)


@dataclass
class Progress:
    """Progress of a plan: by test number, the run that completed it and the run started last."""

    done: dict[int, str] = field(default_factory=dict)
    started: dict[int, str] = field(default_factory=dict)


def load_plan(path: Path) -> TestPlan:
    """Read a plan and check every test against its rig before the first one starts.

    Raises:
        ConfigError: names file, key and remedy.
    """
    t = load_toml(str(path), "plans")
    text = _bytes(path)
    here = path.resolve().parent
    rig = t.text("rig", "")
    seed = t.integer("seed", 0, 2**63 - 1, -1) if "seed" in t else None
    specimen, operator = t.text("specimen", ""), t.text("operator", "")
    rows = t.raw("test", [])
    if not isinstance(rows, list) or not rows:
        raise t.fail("test", "a plan needs at least one [[test]]", "protocol = ... in each")
    items: list[PlannedTest] = []
    for index in range(len(rows)):
        one = t.row("test", index)
        protocol = one.text("protocol", choices=tuple(PROTOCOLS))
        file = one.text("file", protocol)
        name = one.text("rig", rig) or default_rig(protocol)
        try:
            config = load_rig(_beside(here, name), seed)
            procedure(protocol).check(config)
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
            items.append(PlannedTest(len(items) + 1, protocol, file, config, plan, **values))  # type: ignore[arg-type]
    out = TestPlan(
        name=t.text("name", path.stem),
        out=here / t.text("out", "runs"),
        on_fault=t.text("on_fault", "stop", choices=("stop", "next")),
        items=tuple(items),
        crc32=f"{zlib.crc32(text):08x}",
        path=path,
    )
    t.finish()
    return out


def _bytes(path: Path) -> bytes:
    return read_inside(path.resolve().parent, path.resolve().name)


def _beside(here: Path, name: str) -> str:
    """The path of a file beside the plan, or the name unchanged."""
    beside = here / name
    return str(beside) if name.endswith(".toml") and beside.exists() else name


def progress(plan: TestPlan) -> Progress:
    """Progress of a plan, from its journal.

    Raises:
        ConfigError: the plan was changed since it was started.
        RecordError: the journal is damaged.
    """
    out = Progress()
    if not plan.journal.is_file():
        return out
    for line in read_lines(_bytes(plan.journal)):
        if line.fields is None:
            if not line.raw.endswith(b"\n"):
                break  # cut off by a crash; the runs themselves show their state
            raise RecordError(str(plan.journal), "is damaged", "start again with --again")
        fields = line.fields
        if type(fields.get("test")) is not int or not isinstance(fields.get("run_id"), str):
            raise RecordError(str(plan.journal), "is not a journal", "start again with --again")
        if fields.get("crc32") != plan.crc32:
            raise ConfigError(
                str(plan.path),
                "was changed since it was started",
                "restore it, or start again with --again",
            )
        if fields.get("what") == "begun":
            out.started[fields["test"]] = fields["run_id"]
        elif fields.get("what") == "done":
            out.done[fields["test"]] = fields["run_id"]
    return out


def _append(plan: TestPlan, what: str, test: int, run_id: str, outcome: str = "") -> None:
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


def run_tests(
    plan: TestPlan, stop: StopFlag, watch: Watch | None = None, on_start: Any = None
) -> list[Result]:
    """Run the remaining tests of a plan; returns the results of the tests run now.

    Raises:
        PamrigError: a test could not be started.
    """
    before = progress(plan)
    results: list[Result] = []
    for test in plan.items:
        if test.number in before.done:
            continue
        if results or before.done:
            _rest(test, stop)
        if stop.reason:
            break
        result = _run_test(plan, test, before.started.get(test.number), stop, watch, on_start)
        results.append(result)
        if result.outcome == "stopped" or stop.reason:
            break
        if result.outcome != "clean" and plan.on_fault == "stop":
            break
        _append(plan, "done", test.number, result.folder.name, result.outcome)
    return results


def _run_test(
    plan: TestPlan,
    test: PlannedTest,
    run_id: str | None,
    stop: StopFlag,
    watch: Watch | None,
    on_start: Any,
) -> Result:
    """Run one test, or continue the run `run_id` of it."""

    def started(runner: Any, record: Any) -> None:
        _append(plan, "begun", test.number, record.folder.name)
        if on_start is not None:
            on_start(runner, record)

    before = _open(plan, run_id)
    if before is not None:
        if before.outcome == "clean":  # complete, but its journal line was not written
            count = sum(event.get("kind") == "point" for event in before.events)
            return Result(before.folder, "clean", None, count, count)
        return _derived(continue_run(before, stop=stop, watch=watch, on_start=started))
    result = run_protocol(
        procedure(test.protocol), test.config, test.plan, plan.out,
        specimen=test.specimen, operator=test.operator, note=test.note,
        stop=stop, watch=watch, on_start=started,
    )  # fmt: skip
    return _derived(result)


def _derived(result: Result) -> Result:
    """The result, after deriving table and report; the plan continues if this fails."""
    try_derive(result.folder, result.error)
    return result


def _open(plan: TestPlan, run_id: str | None) -> Run | None:
    if run_id is not None:
        with contextlib.suppress(RecordError):
            return open_run(plan.out / run_id)
    return None


def _rest(test: PlannedTest, stop: StopFlag) -> None:
    """Let the specimen rest before a test, except on a virtual bench."""
    if test.config.is_virtual:
        return
    clock = RealClock()
    left = test.rest_s
    while left > 0 and not stop.reason:
        clock.sleep(min(REST_STEP_S, left))
        left -= REST_STEP_S


def plan_command(path: Path, again: bool, as_json: bool) -> int:
    """Run a plan and print the result of each test; returns the exit status."""
    plan = load_plan(path)
    if again:
        plan.journal.unlink(missing_ok=True)
    before = progress(plan)
    line = ProgressLine(quiet=as_json)

    def started(runner: Any, record: Any) -> None:
        if not as_json:
            n = len(progress(plan).done) + 1
            line.log(f"test {n} of {len(plan.items)}: {record.folder.name}")
        line.start(runner, record)

    failed = ""
    results: list[Result] = []
    with stop_on_signals() as stop:
        try:
            results = run_tests(plan, stop, line.watch(), started)
        except PamrigError as error:
            failed = str(error)
        stopped = bool(stop.reason)
    line.close()
    after = progress(plan)
    left = [test.number for test in plan.items if test.number not in after.done]
    faults = [r for r in results if r.outcome not in ("clean", "stopped")]
    status = 130 if stopped else 2 if failed or faults else 0
    if as_json:
        runs = [
            {"run_id": r.folder.name, "outcome": r.outcome, "points": r.points} for r in results
        ]
        print_json(
            {"plan": plan.name, "runs": runs, "done": len(after.done), "left": left,
             "error": failed or None}
        )  # fmt: skip
        return status
    if before.done:
        typer.echo(f"{len(before.done)} of {len(plan.items)} tests had been done before")
    for result in results:
        print_outcome(result)
    if failed:
        typer.echo(f"pamrig: {failed}", err=True)
    typer.echo(
        f"{plan.name}: {len(after.done)} of {len(plan.items)} tests done"
        + (f"; run it again to continue with test {left[0]}" if left else "")
    )
    return status
