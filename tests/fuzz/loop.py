"""A mutation loop that keeps what reaches new lines; no library, no network, seeded.

Every input is made from one of the corpus by a few mutations. Each fiftieth is run under a tracer
that sees which lines of the target's modules it reaches; one that reaches a new line joins the
corpus. (Tracing every input would be fifty times slower, which finds less in the same time.)
"""

from __future__ import annotations

import random
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import psutil

TRACED = 50
HANG_S = 5.0
MORE_MB = 300.0
LOOK = 2000


@dataclass(frozen=True)
class Target:
    """Something that reads bytes.

    Attributes:
        name: for messages.
        run: takes one input; raises one of ``errors`` or nothing.
        corpus: sound inputs to begin with.
        errors: the documented ones.
        modules: parts of file names whose lines count as reached.
        words: pieces that the format is made of.
        seal: makes a mutated input pass outer checks, such as a CRC; half of the inputs.
        traced: one input in so many is traced.
    """

    name: str
    run: Callable[[bytes], object]
    corpus: Sequence[bytes]
    errors: tuple[type[BaseException], ...]
    modules: tuple[str, ...] = ()
    words: tuple[bytes, ...] = ()
    seal: Callable[[bytes], bytes] | None = None
    traced: int = TRACED


@dataclass
class Tally:
    """What came of one target."""

    name: str
    inputs: int = 0
    refused: int = 0
    kept: int = 0
    lines: int = 0
    seconds: float = 0.0
    grown_mb: float = 0.0
    found: list[tuple[str, bytes]] = field(default_factory=list)


class Hang(Exception):
    """An input took longer than ``HANG_S``."""


def mutated(data: bytes, rng: random.Random, words: Sequence[bytes], other: bytes) -> bytes:
    """A few changes: bits, bytes, cuts, copies, numbers at their edges, pieces, another input."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        at = rng.randrange(len(out) + 1)
        size = rng.choice((1, 1, 2, 4, 8, 32))
        match rng.randrange(8):
            case 0 if out:
                out[at % len(out)] ^= 1 << rng.randrange(8)
            case 1 if out:
                out[at % len(out)] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, 10, 13, 32, 48, 57))
            case 2:
                del out[at : at + size]
            case 3:
                out[at:at] = out[at : at + size] * rng.choice((1, 1, 2, 50))
            case 4:
                out[at : at + size] = rng.randbytes(size)
            case 5 if words:
                out[at:at] = rng.choice(words)
            case 6:
                out[at:] = other[rng.randrange(len(other) + 1) :]
            case _:
                out[at : at + size] = rng.choice((b"-1", b"1e999", b"nan", b"9" * 25, b"", b"\0"))
    return bytes(out[:100_000])


def fuzz(target: Target, inputs: int, seed: int, most_s: float = 1e9) -> Tally:
    """Run so many inputs, or as many as ``most_s`` allow; findings are kept, the loop goes on."""
    rng = random.Random(f"{target.name}/{seed}")
    corpus = list(target.corpus)
    tally = Tally(target.name)
    reached: set[tuple[str, int]] = set()
    process = psutil.Process()
    for data in corpus:
        _traced(target, data, reached, tally)
    before = process.memory_info().rss
    start = time.monotonic()
    while tally.inputs < inputs and time.monotonic() - start < most_s:
        base = corpus[-1 - int(rng.random() ** 2 * len(corpus))]
        data = mutated(base, rng, target.words, rng.choice(corpus))
        if target.seal is not None and rng.random() < 0.5:
            data = target.seal(data)
        if tally.inputs % target.traced == 0:
            lines = len(reached)
            _traced(target, data, reached, tally)
            if len(reached) > lines and len(corpus) < 5000:
                corpus.append(data)
                tally.kept += 1
        else:
            _run(target, data, tally)
        if tally.inputs % LOOK == 0:
            tally.grown_mb = max(tally.grown_mb, (process.memory_info().rss - before) / 1e6)
    tally.grown_mb = max(tally.grown_mb, (process.memory_info().rss - before) / 1e6)
    if tally.grown_mb > MORE_MB:
        tally.found.append((f"memory grew by {tally.grown_mb:.0f} MB", b""))
    tally.lines = len(reached)
    tally.seconds = time.monotonic() - start
    return tally


def _run(target: Target, data: bytes, tally: Tally) -> None:
    def hang(*_: object) -> None:
        raise Hang(f"longer than {HANG_S:g} s")

    tally.inputs += 1
    before = signal.signal(signal.SIGALRM, hang)
    signal.setitimer(signal.ITIMER_REAL, HANG_S)
    try:
        target.run(data)
    except target.errors:
        tally.refused += 1
    except Exception as error:
        if len(tally.found) < 20:
            tally.found.append((f"{type(error).__name__}: {error}"[:300], data))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _traced(target: Target, data: bytes, reached: set[tuple[str, int]], tally: Tally) -> None:
    def local(frame: Any, event: str, _: Any) -> Any:
        if event == "line":
            reached.add((frame.f_code.co_filename, frame.f_lineno))
        return local

    def calls(frame: Any, event: str, _: Any) -> Any:
        del event
        return local if any(m in frame.f_code.co_filename for m in target.modules) else None

    outer = sys.gettrace()
    sys.settrace(calls)
    try:
        _run(target, data, tally)
    finally:
        sys.settrace(outer)
