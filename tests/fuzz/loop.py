"""A mutation loop that keeps every input that takes a new branch; seeded, no library, no network.

Each input is one of the corpus after a few mutations. What it reaches is seen by the marks of
`cover`; an input that takes a branch no other took joins the corpus, and the newest are tried most.
"""

from __future__ import annotations

import random
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from .cover import Marks

HANG_S = 5.0
LARGEST = 100_000
MOST_KEPT = 5000
MOST_FOUND = 20


@dataclass(frozen=True)
class Target:
    """Something that reads bytes.

    Attributes:
        name: for messages.
        reads: what it is, in a few words.
        run: takes one input; raises one of ``errors`` or nothing.
        corpus: sound inputs to begin with.
        errors: the documented ones.
        words: pieces that the format is made of.
        seal: makes a mutated input pass outer checks, such as a CRC; half of the inputs.
        change: changes the structure of an input, in place of its bytes; half of the inputs.
    """

    name: str
    reads: str
    run: Callable[[bytes], object]
    corpus: Sequence[bytes]
    errors: tuple[type[BaseException], ...]
    words: tuple[bytes, ...] = ()
    seal: Callable[[bytes], bytes] | None = None
    change: Callable[[bytes, random.Random], bytes] | None = None


@dataclass
class Tally:
    """What came of one target.

    Attributes:
        inputs, refused: how many were run, and how many of them were refused in words.
        kept: inputs that took a new branch.
        branches: taken so far by sound inputs and others.
        seconds: of processor time.
        before_mb, peak_mb: largest resident size after the sound inputs, and since.
        slowest_s: of any one input, processor time.
        found: what was wrong, once for each place, with the first input it was wrong with.
    """

    name: str
    inputs: int = 0
    refused: int = 0
    kept: int = 0
    branches: int = 0
    seconds: float = 0.0
    before_mb: float = 0.0
    peak_mb: float = 0.0
    slowest_s: float = 0.0
    found: list[tuple[str, bytes]] = field(default_factory=list)


class Hang(BaseException):
    """An input took ``HANG_S`` of processor time; no target's ``except Exception`` may hide it."""


class Loop:
    """The loop over one target; whoever runs it asks for a stretch at a time.

    Args:
        target: what is fuzzed.
        seed: of the mutations.
        marks: see :mod:`tests.fuzz.cover`; without installed marks nothing new is ever seen.
        tell: called with each input before it is run.
    """

    def __init__(
        self,
        target: Target,
        seed: int | str,
        marks: Marks | None = None,
        tell: Callable[[bytes], object] = lambda data: None,
    ) -> None:
        self.target = target
        self.tally = Tally(target.name)
        self.corpus = list(target.corpus)
        self.kept: list[bytes] = []
        self._marks = marks or Marks()
        self._words = (*target.words, *sorted(self._marks.words))
        self._rng = random.Random(f"{target.name}/{seed}")
        self._tell = tell
        self._began_s = 0.0
        self._places: set[tuple[Any, ...]] = set()

    def warm(self, more: Sequence[bytes] = ()) -> None:
        """Run the sound inputs, and ``more`` that were kept before."""
        for data in [*self.target.corpus, *more]:
            self._one(data)
        self.corpus += [data for data in more if data not in self.corpus]
        self._marks.news()
        self.tally = Tally(self.target.name, found=self.tally.found, before_mb=peak_mb())
        self.tally.branches = self._marks.reached()

    def run(self, inputs: int, most_s: float = 1e9) -> Tally:
        """So many inputs more, or as many as ``most_s`` allows; what is found does not end it."""
        rng, target, tally = self._rng, self.target, self.tally
        upto, start, cpu = tally.inputs + inputs, time.monotonic(), time.process_time()
        with _alarm(self._hung):
            while tally.inputs < upto and time.monotonic() - start < most_s:
                corpus = self.corpus
                base = corpus[-1 - int(rng.random() ** 2 * len(corpus))]
                if target.change is not None and rng.random() < 0.5:
                    data = target.change(base, rng)[:LARGEST]
                else:
                    data = mutated(base, rng, self._words, corpus)
                    if target.seal is not None and rng.random() < 0.5:
                        data = target.seal(data)
                self._one(data)
                tally.inputs += 1
                if self._marks.news() and len(corpus) < MOST_KEPT:
                    corpus.append(data)
                    self.kept.append(data)
                    tally.kept += 1
        tally.seconds += time.process_time() - cpu
        tally.branches = self._marks.reached()
        tally.peak_mb = max(tally.peak_mb, peak_mb())
        return tally

    def _one(self, data: bytes) -> None:
        self._tell(data)
        self._began_s = began = time.process_time()
        try:
            self.target.run(data)
        except self.target.errors:
            self.tally.refused += 1
        except (Exception, Hang) as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = (type(error).__name__, where.filename, where.lineno)
            if place not in self._places and len(self.tally.found) < MOST_FOUND:
                self._places.add(place)
                self.tally.found.append((f"{type(error).__name__}: {error}"[:300], data))
        self._began_s = 0.0
        self.tally.slowest_s = max(self.tally.slowest_s, time.process_time() - began)

    def _hung(self, *_: object) -> None:
        if self._began_s and time.process_time() - self._began_s > HANG_S:
            raise Hang(f"longer than {HANG_S:g} s")


@contextmanager
def _alarm(look: Callable[..., None]) -> Iterator[None]:
    """Call ``look`` each second, for the price of nothing an input."""
    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    before = signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, 1.0, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def peak_mb() -> float:
    """Largest resident size of this process so far."""
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


TIMES = (1, 1, 1, 2, 3, 6)
SIZES = (1, 1, 2, 4, 8, 32)
EDGES = (0, 1, 0x7F, 0x80, 0xFF, 10, 13, 32, 48, 57)
NUMBERS = (b"-1", b"1e999", b"nan", b"9" * 25, b"", b"\0", b"2147483648", b"0.0000001")


def mutated(
    data: bytes, rng: random.Random, words: Sequence[bytes], corpus: Sequence[bytes]
) -> bytes:
    """A few changes: bits, bytes, cuts, copies, numbers at their edges, words, another input."""
    out = bytearray(data)
    pick = rng.random
    for _ in range(TIMES[int(pick() * 6)]):
        at = int(pick() * (len(out) + 1))
        size = SIZES[int(pick() * 6)]
        kind = int(pick() * 8)
        if kind == 0 and out:
            out[at % len(out)] ^= 1 << int(pick() * 8)
        elif kind == 1 and out:
            out[at % len(out)] = EDGES[int(pick() * len(EDGES))]
        elif kind == 2:
            del out[at : at + size]
        elif kind == 3:
            out[at:at] = out[at : at + size] * (1, 1, 2, 50)[int(pick() * 4)]
        elif kind == 4:
            out[at : at + size] = rng.randbytes(size)
        elif kind == 5 and words:
            out[at:at] = words[int(pick() * len(words))]
        elif kind == 6:
            other = corpus[int(pick() * len(corpus))]
            out[at:] = other[int(pick() * (len(other) + 1)) :]
        else:
            out[at : at + size] = NUMBERS[int(pick() * len(NUMBERS))]
    return bytes(out[:LARGEST])
