"""Python files that a user names on the command line, and packages that bring parts of pamrig.

Such a file is the user's own program, like a script given to Python. No data names one: no record,
rig file or data set can have a file run.
"""

from __future__ import annotations

import importlib.util
import sys
import traceback
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from daq.errors import ConfigError


def load_program(path: Path) -> ModuleType:
    """Import a Python file; files beside it can be imported by it.

    Raises:
        Exception: whatever the file raises; :func:`place_in` says in which line.
    """
    path = path.resolve()
    folder = str(path.parent)
    if folder not in sys.path:  # at the end: a neighbour must not hide a library
        sys.path.append(folder)
    name = f"pamrig_program_{abs(hash(path))}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def place_in(error: BaseException, path: str | Path) -> str:
    """The line of the user's own file in which its import failed: " (line 3)", or nothing."""
    if isinstance(error, SyntaxError):
        return f" (line {error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename).name == Path(path).name]
    return f" (line {own[-1].lineno})" if own else ""


def installed(group: str) -> dict[str, EntryPoint]:
    """What installed packages bring under an entry-point group, by name."""
    return {point.name: point for point in entry_points(group=group)}


def load_installed(group: str, name: str) -> Any:
    """The object that an installed package brings under that name.

    Raises:
        ConfigError: there is none, or its package cannot be imported.
    """
    points = installed(group)
    if name not in points:
        raise ConfigError(name, f"no installed package brings it ({group})")
    point = points[name]
    try:
        return point.load()
    except Exception as error:
        raise ConfigError(
            f"{group}: {name} = {point.value}", f"cannot be loaded: {type(error).__name__}: {error}"
        ) from error
