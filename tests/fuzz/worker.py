"""One target in a process of its own: `python -m tests.fuzz.worker JOB`; see `tests.fuzz.guard`.

The input that is about to be run stands in a file shared with the guard, so that it outlives a
crash; what was done stands in a journal, so that it can be stopped at any moment and gone on with.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import mmap
import os
import struct
import sys
import tempfile
import time
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

from .cover import Marks
from .loop import LARGEST, Loop

HEAD = struct.Struct("<QQ")
NOW_BYTES = HEAD.size + LARGEST + 1000
STRETCH_S = 5.0
"""A journal entry at least so often."""


class Now:
    """How many inputs were begun, and the last of them, in pages that outlive the process."""

    def __init__(self, path: Path) -> None:
        if not path.exists() or path.stat().st_size != NOW_BYTES:
            path.write_bytes(bytes(NOW_BYTES))
        with open(path, "r+b") as file:
            self._map = mmap.mmap(file.fileno(), NOW_BYTES)
        self._count = 0
        self.counting = False

    def tell(self, data: bytes) -> None:
        """This one is next."""
        self._count += self.counting
        data = data[: LARGEST + 1000]
        self._map[HEAD.size : HEAD.size + len(data)] = data
        HEAD.pack_into(self._map, 0, self._count, len(data))

    def read(self) -> tuple[int, bytes]:
        """Number and bytes of the last."""
        count, length = HEAD.unpack_from(self._map)
        return count, self._map[HEAD.size : HEAD.size + length]


def main() -> None:
    """Work through a job; its members are those that `guard` writes."""
    faulthandler.enable()
    job = json.loads(sys.argv[1])
    folder = Path(job["folder"])
    tempfile.tempdir = job["tmp"]
    now = Now(folder / "now")
    marks = Marks(job["marked"])
    marks.install()
    make = importlib.import_module(job["targets"]).TARGETS[job["name"]]
    loop = Loop(make(), job["seed"], marks, now.tell)
    loop.warm([path.read_bytes() for path in sorted((folder / "kept").iterdir())])
    now.counting = True  # what compiles has compiled: from here on an input has a time limit
    _bound(job["more_mb"])
    start = time.monotonic()
    while loop.tally.inputs < job["inputs"] and time.monotonic() - start < job["most_s"]:
        loop.run(min(job["inputs"] - loop.tally.inputs, job["step"]), STRETCH_S)
        _journal(folder, loop)


def _bound(more_mb: float) -> None:
    """What asks for far more memory than is allowed is refused it, instead of the machine."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        return  # the guard looks at the peak all the same
    most = pages * os.sysconf("SC_PAGE_SIZE") + int(4 * more_mb * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _journal(folder: Path, loop: Loop) -> None:
    for data in loop.kept:
        (folder / "kept" / sha256(data).hexdigest()[:20]).write_bytes(data)
    loop.kept.clear()
    fields: dict[str, Any] = asdict(loop.tally)
    fields["found"] = [[what, data.hex()] for what, data in loop.tally.found]
    fields["reads"] = loop.target.reads
    partial = folder / "tally.partial"
    partial.write_text(json.dumps(fields))
    partial.replace(folder / "tally.json")


if __name__ == "__main__":
    main()
