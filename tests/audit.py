"""`python -m tests.audit`: what the lock file pins, and whether holes are known in it.

The first half needs nothing but the file. The second needs the program pip-audit and a network;
where either is missing it says so and that nothing was audited, and is no failure: whether a
build passes must not hang on somebody else's server.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

LOCK = Path(__file__).parent.parent / "requirements.lock"
PINNED = re.compile(r"^[A-Za-z0-9._-]+(\[[a-z,]+\])?==[0-9][A-Za-z0-9.+!]*( ; .+)?$")
WAIT_S = 300.0


def loose(text: str) -> list[str]:
    """Lines of a lock file that do not name one version from the package index."""
    lines = [line.strip() for line in text.splitlines()]
    return [line for line in lines if line and line[0] != "#" and not PINNED.match(line)]


def main() -> int:
    """Say what was looked at; 1 where a pin is loose or a hole is known."""
    found = loose(LOCK.read_text(encoding="utf-8"))
    for line in found:
        print(f"requirements.lock: not pinned to one version: {line}")
    if found:
        return 1
    print("requirements.lock: every line names one version")
    tool = shutil.which("pip-audit") or shutil.which("pip-audit", path=str(Path(sys.prefix, "bin")))
    if tool is None:
        print("NOT AUDITED for known holes: needs pip-audit (pip install pip-audit)")
        return 0
    command = [tool, "--requirement", str(LOCK), "--no-deps", "--disable-pip"]
    try:
        done = subprocess.run(command, text=True, capture_output=True, timeout=WAIT_S, check=False)
    except subprocess.TimeoutExpired:
        print(f"NOT AUDITED for known holes: no answer within {WAIT_S:g} s")
        return 0
    if done.returncode and "Found" not in done.stderr + done.stdout:
        print(f"NOT AUDITED for known holes: {done.stderr.strip().splitlines()[-1:]}")
        return 0
    print(done.stdout + done.stderr)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
