"""Derived versions: table and report of a run made again with other settings for its pictures.

``derived/`` holds what follows from the record with the settings of its run.json. A version stands
beside it in a folder of its own, ``derived-0001``, ``derived-0002`` and so on, and is never
replaced. Its sealed ``manifest.json`` states the settings, the run, and size and CRC of each file.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.disk import disk_error
from daq.store.derive import Maker, seal_folder
from daq.store.run import PARTIAL, Run

_NAME = re.compile(r"derived-(\d{4})")
MOST_VERSIONS = 9999


def version_folders(folder: Path) -> list[str]:
    """Names of the version folders of a run, in order."""
    with contextlib.suppress(OSError):
        return sorted(name for name in os.listdir(folder) if _NAME.fullmatch(name))
    return []


def missing_versions(names: Iterable[str]) -> list[str]:
    """Names that are absent below the highest one."""
    there = set(names)
    last = max((int(name.removeprefix("derived-")) for name in there), default=0)
    return [name for k in range(1, last) if (name := f"derived-{k:04d}") not in there]


def make_version(run: Run, makers: Iterable[Maker]) -> Path:
    """Make the next version of a run from the settings in ``run.pictures``; returns its folder.

    Nothing that exists changes.

    Raises:
        RecordError: the folder cannot be written, or there are too many versions.
    """
    fresh = run.folder / PARTIAL
    number = max((int(n.removeprefix("derived-")) for n in version_folders(run.folder)), default=0)
    if number >= MOST_VERSIONS:
        raise RecordError(str(run.folder), f"has {number} derived versions", "delete some")
    target = run.folder / f"derived-{number + 1:04d}"
    try:
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        for make in makers:
            make(run, fresh)
        seal_folder(run, fresh, version=target.name, pictures=run.pictures or {})
        if os.path.lexists(target):
            raise RecordError(str(target), "was made meanwhile", "give the command again")
        fresh.rename(target)
    except OSError as error:
        raise disk_error(target, "a derived version cannot be written", error) from error
    finally:
        with contextlib.suppress(OSError):
            shutil.rmtree(fresh, ignore_errors=True)
    return target


def version_settings(run: Run, name: str) -> dict[str, Any]:
    """Settings that a version was made with; empty if its manifest is damaged."""
    manifest = run.sealed(f"{name}/manifest.json") or {}
    found = manifest.get("pictures")
    return found if isinstance(found, dict) else {}
