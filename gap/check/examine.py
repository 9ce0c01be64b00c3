"""One blind set from making to score: made, sealed, diagnosed, and only then opened.

The diagnosis gets a folder on disk and nothing else. The seal's digest is appended to the
campaign's file before the diagnosis starts.
"""

from __future__ import annotations

import importlib
import json
import os
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from blind.exchange import write
from blind.recording import record
from blind.seal import opened, seal
from blind.sets import BlindSet, answer, blind_set
from gap.check.scoring.closed import closed_fraction
from gap.check.scoring.score import score


@dataclass(frozen=True)
class Task:
    """The task of a worker: which set, where seals go, and what else to run on it.

    `engine` names the diagnosis as `module:function`; it takes a folder and the ids struck from
    the catalogue, and returns a verdict (exchange form) or an object with `as_dict`. `held_out`
    admits the stream of forms that are held out.
    """

    stream: str
    number: int
    small: bool
    seals: str
    engine: str
    baselines: bool
    held_out: bool = False


def call_engine(engine: str, folder: Path, without: Sequence[str]) -> dict[str, Any]:
    """The verdict as plain values."""
    module, _, name = engine.partition(":")
    found = getattr(importlib.import_module(module), name)(folder, without=tuple(without))
    plain = found.as_dict() if hasattr(found, "as_dict") else dict(found)
    return dict(json.loads(json.dumps(plain, allow_nan=False)))


def publish(path: str, line: Mapping[str, Any]) -> None:
    """Append one line in one write, so that workers do not mix theirs."""
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(file, (json.dumps(line) + "\n").encode())
    finally:
        os.close(file)


def diagnosed(engine: str, folder: Path, without: Sequence[str]) -> dict[str, Any]:
    """Verdict with the processor seconds it took; a crash is a verdict of its own."""
    start = time.process_time()
    try:
        verdict = call_engine(engine, folder, without)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        verdict = {
            "status": "crashed",
            "reason": f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})",
        }
    verdict["seconds"] = round(time.process_time() - start, 3)
    return verdict


def examine(task: Task) -> dict[str, Any]:
    """Make, seal, diagnose, open and score one set; returns the line for the results file."""
    one = blind_set(task.stream, task.number, task.small, task.held_out)
    with tempfile.TemporaryDirectory(prefix="blind-") as temporary:
        folder = Path(temporary) / "data"
        write(record(one), folder, as_csv=task.number % 5 == 4)
        digest, envelope = seal(answer(one))
        publish(task.seals, {"stream": task.stream, "number": task.number, "seal": digest})
        verdict = diagnosed(task.engine, folder, one.without)
        rivals: dict[str, dict[str, Any]] = {}
        if task.baselines:
            from gap.check.scoring.baselines import baseline_verdicts

            rivals = baseline_verdicts(folder, one.without)
        truth = opened(envelope, digest)
        scored = judged(one, truth, verdict, folder)
    return {
        "stream": task.stream,
        "number": task.number,
        "seal": digest,
        "envelope": envelope,
        "verdict": verdict,
        "score": scored,
        "baselines": {name: score(truth, v) for name, v in rivals.items()},
    }


def judged(
    one: BlindSet, truth: Mapping[str, Any], verdict: Mapping[str, Any], folder: Path
) -> dict[str, Any]:
    """The score, with the true closed fraction of the diagnosis's fit where that applies."""
    scored = score(truth, verdict)
    if scored["named_right"] and scored["size"] >= 2.0 and scored["closed"] is not None:
        scored["closed_true"] = closed_fraction(one, folder, one.without, verdict["gap"])
    return scored
