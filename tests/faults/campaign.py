"""Thousands of faulted runs, shared out over processes, each outcome on one line of a journal."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rigs.execution.manifest import software
from rigs.protocols.names import PROTOCOLS

from .judge import Verdict, judge
from .kinds import Fault, draw
from .places import CLASSES
from .trial import run_trial
from .values import check_continuing, check_values

ORDER = tuple(name for name in PROTOCOLS if name in CLASSES)
FINDINGS = ("untold", "late", "unreadable", "wrong", "stuck")
SHOWN = ("layer", "kind", "device", "hits", "must_tell")


def protocol_of(number: int) -> str:
    """Every protocol in turn."""
    return ORDER[number % len(ORDER)]


def one(
    number: int, work: Path, keep: bool = False, faults: list[Fault] | None = None
) -> dict[str, Any]:
    """One run and what was found of it, as plain values."""
    protocol, seed = protocol_of(number), number // len(ORDER)
    start = _cpu_s()
    faults = draw(protocol, seed) if faults is None else faults
    truth = run_trial(protocol, seed, work, faults)
    verdict = judge(truth)
    check_values(truth, verdict, work)
    if number % 2 or not verdict.sound:
        check_continuing(truth, verdict)
    folder = work / "runs" / f"{protocol}-{seed}"
    if verdict.sound and not keep:
        shutil.rmtree(folder, ignore_errors=True)
    return {
        "number": number,
        "protocol": protocol,
        "outcome": truth.outcome,
        "faults": [
            {k: v for k, v in asdict(f).items() if k in SHOWN}
            for f in truth.faults
        ],
        **asdict(verdict),
        "cpu_s": round(_cpu_s() - start, 3),
        "revision": revision(),
    }  # fmt: skip


def _cpu_s() -> float:
    """Of this process and of those it had killed."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _one(job: tuple[int, str]) -> dict[str, Any]:
    number, work = job
    try:
        return one(number, Path(work))
    except Exception as error:  # the campaign's own; it is told, and the others go on
        verdict = Verdict(crashed=f"judging failed: {type(error).__name__}: {error}")
        return {"number": number, "protocol": protocol_of(number), "outcome": "?", "faults": [],
                **asdict(verdict), "cpu_s": 0.0, "revision": revision()}  # fmt: skip


@lru_cache
def revision() -> str:
    """Of the source that makes the runs; with a + where it was changed since."""
    git = software()["git"] or {}
    return f"{(git.get('revision') or 'unknown')[:7]}{'+' if git.get('dirty') else ''}"


def run_campaign(
    numbers: Iterable[int],
    work: Path,
    processes: int = 1,
    tell: Callable[[dict[str, Any]], None] = lambda result: None,
    again: bool = False,
) -> list[dict[str, Any]]:
    """Run what is not yet in the journal; everything that is in it then.

    Args:
        numbers: of the runs; a number names protocol, seed and faults.
        work: folder of journal and runs; what failed stays there.
        processes: how many at a time.
        tell: called with each new result.
        again: make those once more of which something was found.
    """
    work.mkdir(parents=True, exist_ok=True)
    journal = work / "journal.jsonl"
    known = read_journal(journal)
    wanted = [n for n in numbers if n not in known or (again and bad(known[n]))]
    jobs = [(n, str(work)) for n in wanted]
    with open(journal, "a", encoding="utf-8") as out:

        def note(result: dict[str, Any]) -> None:
            out.write(json.dumps(result) + "\n")
            out.flush()
            before = known.get(result["number"])
            known[result["number"]] = result | ({"before": before} if before else {})
            tell(result)

        if processes <= 1:
            for job in jobs:
                note(_one(job))
        else:
            with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
                for result in pool.map(_one, jobs, chunksize=4):
                    note(result)
    return [known[n] for n in sorted(known)]


def bad(result: dict[str, Any]) -> bool:
    """Whether anything was found of a run."""
    return bool(result["crashed"]) or any(result[name] for name in FINDINGS)


def read_journal(path: Path) -> dict[int, dict[str, Any]]:
    """Results by number; a last line that was being written is left out.

    Of a run that was made again the last result counts; the one before it is its ``before``.
    """
    out: dict[int, dict[str, Any]] = {}
    if not path.exists():
        return out
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            result = json.loads(line)
        except ValueError:
            continue
        number = result["number"]
        out[number] = result | ({"before": out[number]} if number in out else {})
    return out


def versions() -> str:
    """What the results depend on."""
    import platform
    from importlib.metadata import version

    names = ("numpy", "numba", "pyarrow", "opencv-python-headless")
    parts = [f"{name} {version(name)}" for name in names]
    return f"Python {platform.python_version()}, {', '.join(parts)}, {os.uname().sysname}"
