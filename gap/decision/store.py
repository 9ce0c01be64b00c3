"""Entries on disk, one file each, known by a key: JSON and arrays in one npz file, never pickle.

An entry is written beside its place and moved there, so that two processes may write one at once
and nobody reads half of one. What cannot be read or written only costs the time to compute it.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

MOST_BYTES = 512 << 20
_MOST_SHARE = 0.5
"""Share of all that one entry may take."""
_LEFT_OVER_S = 3600.0
_SUFFIX = ".npz"
_DAMAGED = (
    OSError, ValueError, TypeError, KeyError, IndexError, EOFError, MemoryError,
    zipfile.BadZipFile, zlib.error, NotImplementedError, RecursionError,
)  # fmt: skip
"""What reading a damaged or foreign file may raise."""


def user_folder() -> Path | None:
    """Folder of kept diagnoses; None where keeping is switched off.

    `$PAMRIG_DIAGNOSES` names another, or switches it off with the word off.
    """
    stated = os.environ.get("PAMRIG_DIAGNOSES", "").strip()
    if stated:
        return None if stated.lower() == "off" else Path(stated)
    try:
        return _user_cache() / "diagnoses"
    except RuntimeError:  # no home
        return None


def _user_cache() -> Path:
    """Cache folder of this program, where the system keeps such things."""
    whole = os.environ.get("PAMRIG_CACHE")
    if whole:
        return Path(whole)
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA")
        return (Path(local) if local else Path.home() / "AppData" / "Local") / "pamrig" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "pamrig"
    stated = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification has relative paths ignored.
    return (Path(stated) if os.path.isabs(stated) else Path.home() / ".cache") / "pamrig"


class Store:
    """Entries of a folder, the least recently used dropped beyond `most_bytes`."""

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self.folder = folder
        self.most_bytes = most_bytes

    def read(self, key: str) -> tuple[Any, list[Any]] | None:
        """The JSON value and the arrays under a key; None where there is none that is sound."""
        path = self._path(key)
        try:
            with open(path, "rb") as opened, np.load(opened) as file:  # without pickle
                about = json.loads(file["about"].tobytes())
                if about["key"] != key:
                    return None
                found = about["value"], [file[f"a{k}"] for k in range(about["arrays"])]
            os.utime(path)
        except _DAMAGED:
            return None
        return found

    def write(self, key: str, value: Any, arrays: list[Any]) -> None:
        """Keep a JSON value and arrays under a key, if the disk allows."""
        about = json.dumps({"key": key, "value": value, "arrays": len(arrays)}).encode()
        if len(about) + sum(array.nbytes for array in arrays) > _MOST_SHARE * self.most_bytes:
            return
        named = {f"a{k}": array for k, array in enumerate(arrays)}
        scratch = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, scratch = tempfile.mkstemp(".part", dir=self.folder)
            with os.fdopen(handle, "wb") as file:
                np.savez(file, about=np.frombuffer(about, dtype=np.uint8), **named)
            os.replace(scratch, self._path(key))
            self._drop_oldest()
        except OSError:
            if scratch is not None:
                _remove(Path(scratch))

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}{_SUFFIX}"

    def _drop_oldest(self) -> None:
        now = time.time()
        for part in self.folder.glob("*.part"):
            if now - _used(part)[0] > _LEFT_OVER_S:  # of a process that was killed
                _remove(part)
        kept = sorted((_used(path), path) for path in self.folder.glob(f"*{_SUFFIX}"))
        whole = sum(size for (_, size), _ in kept)
        for (_, size), path in kept[:-1]:
            if whole <= self.most_bytes:
                break
            _remove(path)
            whole -= size


def _used(path: Path) -> tuple[float, int]:
    """When a file was last used, and its size; another process may just have removed it."""
    try:
        found = path.stat()
    except OSError:
        return 0.0, 0
    return found.st_mtime, found.st_size


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError:  # gone already, or in use
        return
