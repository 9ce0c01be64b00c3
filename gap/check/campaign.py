"""Many blind sets on a process pool or a cluster; stopped and taken up again without loss."""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from blind.sets import BESIDE as BESIDE
from blind.sets import HELD_OUT as HELD_OUT
from gap.check.examine import Task, examine
from gap.errors import CheckError

ENGINE = "gap.check.engine:verdict_of_folder"
MOST_DIGITS = 6
RESULTS, SEALS = "results.jsonl", "seals.jsonl"


@dataclass(frozen=True)
class Plan:
    """What a campaign runs: sets of a stream, where its files go, and with what.

    `held_out` admits the stream of forms that are held out from everything else.
    """

    stream: str
    numbers: tuple[int, ...]
    out: Path
    engine: str = ENGINE
    baselines: bool = True
    small: bool = False
    jobs: int = 0
    scheduler: str | None = None
    quiet: bool = False
    held_out: bool = False


def parse_numbers(text: str) -> tuple[int, ...]:
    """`0-59` or `3,5,8-9` as ascending set numbers."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdecimal() or not (last or first).isdecimal():
            raise CheckError("--sets", f"expected numbers like 0-59 or 3,5,8, got {text!r}")
        if max(len(first), len(last)) > MOST_DIGITS:
            raise CheckError("--sets", f"{part.strip()!r} is beyond any stream")
        found |= set(range(int(first), int(last or first) + 1))
    if not found:
        raise CheckError("--sets", f"no set in {text!r}")
    return tuple(sorted(found))


def read_results(path: Path) -> list[dict[str, Any]]:
    """Lines of a results file, the last one of each set; an unfinished last line is left out."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    found: dict[tuple[str, int], dict[str, Any]] = {}
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line)
        except json.JSONDecodeError as error:
            if number == len(lines):
                break  # cut off while being written
            raise CheckError(f"{path}, line {number}", f"not JSON: {error}") from None
        found[entry["stream"], entry["number"]] = entry
    return list(found.values())


@contextmanager
def single_threaded() -> Iterator[None]:
    """Children use one thread each for linear algebra: the pool is the parallelism."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def run_campaign(plan: Plan) -> list[dict[str, Any]]:
    """Run what is not yet in the results file; returns all lines of this plan's sets.

    Each finished set is on disk before the next is waited for: stop at any moment.
    """
    if plan.jobs < 0:
        raise CheckError("--jobs", f"expected 0 or more, got {plan.jobs}")
    try:
        plan.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CheckError(str(plan.out), f"cannot be made: {error.strerror}") from None
    results = plan.out / RESULTS
    done = {(r["stream"], r["number"]) for r in read_results(results)}
    left = [i for i in plan.numbers if (plan.stream, i) not in done]
    tasks = [
        Task(plan.stream, i, plan.small, str((plan.out / SEALS).resolve()), plan.engine,
             plan.baselines, plan.held_out) for i in left
    ]  # fmt: skip
    start = time.monotonic()
    with results.open("a", encoding="utf-8") as file:
        for count, entry in enumerate(outcomes(plan, tasks), 1):
            file.write(json.dumps(entry, allow_nan=False) + "\n")
            file.flush()
            if not plan.quiet:
                progress(count, len(tasks), time.monotonic() - start, entry)
    wanted = {(plan.stream, i) for i in plan.numbers}
    return [r for r in read_results(results) if (r["stream"], r["number"]) in wanted]


def progress(count: int, of: int, elapsed: float, entry: dict[str, Any]) -> None:
    """One line on standard error: drawn again on a terminal, else a new one for each set."""
    rest = elapsed / count * (of - count)
    status = entry["verdict"].get("status")
    line = f"{count}/{of} sets, {rest / 60:.0f} min left; last: {entry['number']} {status}"
    if not sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)
        return
    end = "\n" if count == of else ""
    print(f"\r{line}        ", end=end, file=sys.stderr, flush=True)


def outcomes(plan: Plan, tasks: Sequence[Task]) -> Iterator[dict[str, Any]]:
    """Results in the order in which they are ready."""
    if plan.scheduler:
        yield from on_cluster(plan.scheduler, tasks)
    elif plan.jobs == 1:
        yield from map(examine, tasks)
    else:
        yield from on_pool(plan.jobs or os.cpu_count() or 1, tasks)


def on_pool(jobs: int, tasks: Sequence[Task]) -> Iterator[dict[str, Any]]:
    """On processes of this machine; what has not begun is dropped when stopped.

    The first task is run alone, so that what it compiles is there for the others: numba enters
    machine code in its index before the file is written, and a process that comes in between is
    handed whatever an older version of the source left under that name, which may end it.
    """
    with (
        single_threaded(),
        ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        waiting: set[Future[dict[str, Any]]] = set()
        todo = iter(tasks)
        try:
            for task in islice(todo, 1):
                yield pool.submit(examine, task).result()
            for task in todo:
                waiting.add(pool.submit(examine, task))
                if len(waiting) >= 2 * jobs:
                    ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    yield from (one.result() for one in ready)
            while waiting:
                ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (one.result() for one in ready)
        except (KeyboardInterrupt, GeneratorExit):
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def on_cluster(address: str, tasks: Sequence[Task]) -> Iterator[dict[str, Any]]:
    """On an existing Dask cluster; its workers need this package and a folder in common."""
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise CheckError(
            "--scheduler", "Dask is not installed", "pip install 'pamrig[cluster]'"
        ) from None
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, ValueError, TimeoutError) as error:
        raise CheckError(f"--scheduler {address}", f"no scheduler answers there: {error}") from None
    with client:
        futures = client.map(examine, list(tasks), pure=False)
        for future in distributed.as_completed(futures):
            yield future.result()
