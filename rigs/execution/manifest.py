"""What is known before a run and goes to disk before anything is armed."""

from __future__ import annotations

import platform
import shutil
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rigs.bench.due import due_calibrations
from rigs.bench.rig import Rig
from rigs.execution.procedure import Plan
from rigs.execution.recording import instrument_manifest
from rigs.rigfile.config import camera_values


def software() -> dict[str, Any]:
    """Versions that a result depends on, and the revision of the source where it is a checkout."""
    out: dict[str, Any] = {"python": platform.python_version(), "platform": platform.platform()}
    for name in ("pamrig", "numpy", "numba", "opencv-python-headless", "pyarrow"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = None
    here = Path(__file__).resolve().parents[2]
    out["git"] = None
    if (here / ".git").exists() and shutil.which("git"):

        def git(*words: str) -> str:
            done = subprocess.run(
                ["git", "-C", str(here), *words],
                capture_output=True,
                text=True,
                timeout=10,
                check=False,
            )
            return done.stdout.strip() if done.returncode == 0 else ""

        out["git"] = {"revision": git("rev-parse", "HEAD") or None,
                      "dirty": bool(git("status", "--porcelain"))}  # fmt: skip
    return out


def manifest(
    rig: Rig, protocol: str, plan: Plan, specimen: str, operator: str, note: str
) -> dict[str, Any]:
    """What is known before the run; it goes to disk before anything is armed."""
    config = rig.config
    out: dict[str, Any] = {
        "protocol": protocol,
        "parameters": plan.as_dict(),
        "specimen": specimen,
        "operator": operator,
        "note": note,
        "rig": {"name": config.name, "description": config.description, "source": config.source,
                "crc32": config.crc32, "text": config.text},
        "limits": dict(vars(config.limits)),
        "conditions": dict(vars(config.conditions)),
        "camera": camera_values(config),
        "calibrations": {k: c.to_dict() for k, c in config.calibrations.items()},
        "devices": rig.identities,
        "software": software(),
    }  # fmt: skip
    out.update(instrument_manifest(rig))
    out["load"] = dict(vars(config.instruments.load))
    late = [one.as_dict() for one in due_calibrations(config)]
    if late:
        out["calibrations_due"] = late
    if config.virtual is not None:
        out["virtual"] = {"seed": config.virtual.seed}
    return out
