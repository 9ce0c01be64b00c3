"""Install the pinned packages of lock files with one line of progress; needs nothing installed.

`PYTHON tests/install.py LOCK...`: what pip prints is shown only where it fails.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

PIP = (
    "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--no-compile",
    "--no-deps", "--require-hashes", "--only-binary", ":all:", "--progress-bar", "off",
)  # fmt: skip


def packages(lock: Path) -> int:
    """How many packages a lock file pins."""
    return len(re.findall(r"^[A-Za-z0-9._-]+==", lock.read_text("utf-8"), re.MULTILINE))


def install(lock: Path) -> int:
    """Install a lock file; the exit status of pip."""
    start, said = time.monotonic(), []
    total, seen = packages(lock), 0
    pip = subprocess.Popen(
        [sys.executable, *PIP, "-r", str(lock)], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    assert pip.stdout is not None
    for line in pip.stdout:
        said.append(line)
        if line.startswith(("Collecting ", "Requirement already satisfied: ")):
            seen += 1
            name = line.split(": " if ": " in line else " ", 1)[1].split()[0].partition("==")[0]
            show(f"downloading {seen} of {total}: {name}")
        elif line.startswith("Installing collected packages"):
            show(f"unpacking {total} packages")
    status = pip.wait()
    show("")
    if status:
        sys.stderr.write("".join(said))
    else:
        print(f"{lock.name}: {total} packages in {time.monotonic() - start:.0f} s", flush=True)
    return status


def show(text: str) -> None:
    """Show a line over the last one; on what is not a terminal, nothing."""
    if sys.stdout.isatty():
        print(f"\r  {text:<60}\r" if not text else f"\r  {text:<60}", end="", flush=True)


def main() -> int:
    """Install every lock file that was named."""
    return next((status for lock in sys.argv[1:] if (status := install(Path(lock)))), 0)


if __name__ == "__main__":
    sys.exit(main())
