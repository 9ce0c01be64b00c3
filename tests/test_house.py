"""The rules of the house that a machine can check."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

from conftest import PACKAGES, slow_tests

HOUSE = Path(__file__).resolve().parent.parent
MOST_FILES = 15
# Where each of these may be imported, and nowhere else.
ONLY_IN = {
    "serial": ("daq/link/ports.py",),
    "rerun": ("daq/live", "daq/live/viewfile.py"),
    "machine": ("valvefw/boards/", "valvefw/board_"),
    "rp2": ("valvefw/boards/", "valvefw/board_"),
}
MICROPYTHON = {
    "valvefw",
    "binascii",
    "struct",
    "array",
    "micropython",
    "machine",
    "rp2",
    "uctypes",
    "sys",
    "os",
    "gc",
    "time",
}


@cache
def import_nodes(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """What a file imports, at any depth of its code."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]


def imports(path: Path) -> set[str]:
    """First parts of all modules a file imports, at any depth of its code."""
    found: set[str] = set()
    for node in import_nodes(path):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


@cache
def definitions(path: Path) -> set[str]:
    """Functions and classes of a file, and the functions of its classes as CLASS.FUNCTION."""
    found: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
            inner = node.body if isinstance(node, ast.ClassDef) else []
            found |= {f"{node.name}.{n.name}" for n in inner if isinstance(n, ast.FunctionDef)}
    return found


def module_name(name: str) -> str:
    return name.removesuffix(".py").replace("/", ".").removesuffix(".__init__")


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of this repository that a file imports anywhere in its code."""
    found: set[str] = set()
    for node in import_nodes(path):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            whole = {f"{node.module}.{name.name}" for name in node.names}
            found |= (whole & known.keys()) or {node.module}
    return found & known.keys()


def sources() -> list[tuple[str, Path]]:
    return [
        (path.relative_to(HOUSE).as_posix(), path)
        for package in PACKAGES
        for path in sorted((HOUSE / package).rglob("*.py"))
    ]


def test_imports_only_point_down() -> None:
    tool = shutil.which("lint-imports", path=str(Path(sys.executable).parent)) or "lint-imports"
    done = subprocess.run([tool], cwd=HOUSE, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_each_device_library_has_one_home() -> None:
    for name, path in sources():
        for library in imports(path) & set(ONLY_IN):
            assert name.startswith(ONLY_IN[library]), f"{name} imports {library}"


def test_the_firmware_needs_nothing_micropython_lacks() -> None:
    for name, path in sources():
        if name.startswith("valvefw/"):
            assert imports(path) <= MICROPYTHON, f"{name}: {imports(path) - MICROPYTHON}"


def test_nothing_sleeps_but_the_clock() -> None:
    """The virtual bench in real time, the live view's thread and the command that waits for another
    process live outside protocols.
    """
    allowed = (
        "daq/clock.py",
        "rigs/virtual/server.py",
        "rigs/virtual/bench.py",
        "daq/live",
        "daq/record/disk.py",
        "rigs/devices/uvc.py",
        "rigs/bench/vent.py",
    )
    for name, path in sources():
        if "time.sleep(" in path.read_text(encoding="utf-8"):
            assert name.startswith(allowed), name


def test_no_room_holds_more_files_than_a_reader_can_survey() -> None:
    rooms = Counter(path.parent for _, path in sources())
    assert {room.name: n for room, n in rooms.items() if n > MOST_FILES} == {}


def test_no_module_imports_itself_through_others() -> None:
    """Imports inside functions and under TYPE_CHECKING count as well."""
    names = {module_name(name): path for name, path in sources()}
    edges = {name: imported(path, names) - {name} for name, path in names.items()}
    while True:  # what imports nothing that is left cannot be part of a circle
        done = [name for name, to in edges.items() if not to & edges.keys()]
        if not done:
            break
        for name in done:
            del edges[name]
    assert not edges, f"a circle among {sorted(edges)}"


def test_every_test_that_is_listed_as_slow_exists() -> None:
    for line in slow_tests():
        path, *names = line.partition("[")[0].split("::")
        inside = definitions(HOUSE / path)
        assert ".".join(names) in inside, line


def test_slow_tests_are_listed_and_not_marked_in_their_files() -> None:
    """`make test` leaves out what is listed: a mark alone would leave a test in it."""
    marked = [
        path.name
        for path in (HOUSE / "tests").glob("test_*.py")
        if re.search(r"mark\.slow\b", path.read_text(encoding="utf-8"))
    ]
    assert not marked
