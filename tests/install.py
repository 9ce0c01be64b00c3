"""Install the pinned packages of lock files with one line of progress; needs nothing installed.

`PYTHON tests/install.py LOCK...`: what pip prints is shown only where it fails. `LOCK:NAME,NAME`
installs only these packages of a lock file.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PIP = (
    "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--no-compile",
    "--no-deps", "--require-hashes", "--only-binary", ":all:", "--progress-bar", "off",
)  # fmt: skip


def packages(lock: Path) -> int:
    """How many packages a lock file pins."""
    return len(re.findall(r"^[A-Za-z0-9._-]+==", lock.read_text("utf-8"), re.MULTILINE))


def part(lock: Path, names: list[str]) -> str:
    """The entries of some packages of a lock file, with their sums."""
    entries = re.split(r"^(?=\S)", lock.read_text("utf-8"), flags=re.MULTILINE)
    return "".join(e for e in entries if e.partition("==")[0] in names)


def install_part(lock: Path, names: list[str]) -> int:
    """Install only some packages of a lock file; the exit status of pip."""
    with tempfile.TemporaryDirectory() as folder:
        some = Path(folder) / lock.name
        some.write_text(part(lock, names), "utf-8")
        return install(some)


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
    """Install every lock file that was named, or its part."""
    for argument in sys.argv[1:]:
        lock, _, names = argument.partition(":")
        status = install_part(Path(lock), names.split(",")) if names else install(Path(lock))
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
