"""One program at a time on a rig; several rigs on one machine do not mind each other.

A lock is a file held by the operating system (it goes with the process, however that ends), one
for each port or camera of a rig. What does not exist is not locked: opening it says so better.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.errors import PortError
from daq.filelock import try_lock

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig

FOLDER = "pamrig-locks"
RECORD = 512
"""Bytes at the start of a lock file that say who holds it."""


class RigInUse(PortError):
    """Another program holds a device of the rig."""


def lock_folder() -> Path:
    """Where the locks of this machine are."""
    return Path(os.environ.get("PAMRIG_LOCKS") or Path(tempfile.gettempdir()) / FOLDER)


def devices_of(config: RigConfig) -> dict[str, str]:
    """What a rig needs for itself: key in the rig file -> port, of what is there now."""
    ports = {
        "valve.port": config.valve.port,
        "valve_b.port": config.valve_b.port if config.valve_b is not None else "",
        "balance.port": config.balance.port,
        "stage.port": config.stage.port,
        "pressure_source.port": config.pressure_source.port,
        **{f"{name}.port": d.port for name, d in config.instruments.ports().items()},
    }
    source = config.camera.source
    if source.startswith("uvc:"):
        ports["camera.source"] = source
    return {
        key: port
        for key, port in ports.items()
        if port and (port.startswith("uvc:") or "://" in port or os.path.exists(port))
    }


def _lock_path(where: Path, port: str) -> Path:
    identity = port if "://" in port else os.path.realpath(port)
    return where / f"{hashlib.sha256(identity.encode()).hexdigest()[:16]}.lock"


def vent_request(config: RigConfig) -> Path:
    """The file by which another program asks the test on a rig to end and vent."""
    return _lock_path(lock_folder(), config.valve.port).with_suffix(".vent")


@contextlib.contextmanager
def rig_lock(config: RigConfig, folder: Path | None = None) -> Iterator[None]:
    """Hold every device of a rig against other programs; nothing for a virtual rig.

    Raises:
        PortError: names the key and port, and who has it.
    """
    if config.is_virtual:
        yield
        return
    where = folder or lock_folder()
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # without such a folder there are the ports' own locks
            where.mkdir(parents=True, exist_ok=True, mode=0o777)
        mine: dict[str, str] = {}
        for key, port in devices_of(config).items():
            identity = port if "://" in port else os.path.realpath(port)
            if identity in mine:  # a rig file that names a port twice meets the port's own lock
                continue
            mine[identity] = key
            held = _hold(_lock_path(where, port), config, key, port)
            if held is not None:
                stack.callback(os.close, held)
        yield


def _hold(path: Path, config: RigConfig, key: str, port: str) -> int | None:
    """Take one lock; its file descriptor, or None where no lock file can be made."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return None
    if not try_lock(fd, RECORD):
        holder = _who(fd)
        os.close(fd)
        raise RigInUse(
            f"{config.source}: {key} = {port!r}",
            f"is in use{holder}",
            "wait for that test to end, or stop it; another rig can be used meanwhile",
        )
    about = {
        "pid": os.getpid(),
        "rig": config.name,
        "source": config.source,
        "since": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "command": " ".join(["pamrig", *sys.argv[1:]])[:200],
    }
    text = json.dumps(about).encode()[: RECORD - 1].ljust(RECORD)
    with contextlib.suppress(OSError):
        os.pwrite(fd, text, 0) if hasattr(os, "pwrite") else os.write(fd, text)
    return fd


def _who(fd: int) -> str:
    """Who holds a lock, in words; nothing where its file does not tell."""
    try:
        os.lseek(fd, 0, os.SEEK_SET)
        about: dict[str, Any] = json.loads(os.read(fd, RECORD))
        return (
            f" by process {about['pid']} ({about['command']}, rig {about['rig']!r}, since"
            f" {about['since']})"
        )
    except (OSError, ValueError, KeyError):
        return " by another program"
