"""Descriptions of simulators and small trials for their tests."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gap.data.trial import Channel, Trial
from plant.arrays import Array

EXAMPLES = Path(__file__).resolve().parent.parent / "docs" / "examples" / "simulators"
FMU = """
kind = "fmu"
file = "muscle.fmu"
stages = ["force"]

[variables.pressure_kpa]
name = "p"
factor = 1e3

[variables.length_mm]
name = "length"
factor = 1e-3

[variables.force_n]
name = "force"

[parameters.braid_length_mm]
variable = "braid_length"
factor = 1e-3
nominal = 85.0
tolerance = 0.3

[parameters.turns]
nominal = 1.75
tolerance = 0.01
"""
CHAMBER_FMU = """
kind = "fmu"
file = "muscle.fmu"
stages = ["pressure"]

[variables.pressure_kpa]
name = "pressure"
factor = 1e3

[variables.inlet_cmd]
name = "inlet"

[variables.outlet_cmd]
name = "outlet"

[variables.supply_kpa]
name = "supply"
factor = 1e3

[parameters.rate_per_s]
variable = "rate"
nominal = 5.0
tolerance = 0.5
"""
STATIC = """
kind = "python"
function = "muscle.py:force"
static = true
stages = ["force"]

[parameters.braid_length_mm]
nominal = 85.0
tolerance = 0.3

[parameters.turns]
nominal = 1.75
tolerance = 0.01
"""
FORCE = """
import numpy as np


def force(pressure_kpa, length_mm, parameters):
    b, n = parameters["braid_length_mm"] * 1e-3, parameters["turns"]
    length = length_mm * 1e-3
    return pressure_kpa * 1e3 * (3.0 * length**2 - b**2) / (4.0 * np.pi * n**2)
"""


def chou_hannaford(p_kpa: Array, length_mm: Array, b_mm: float = 85.0, n: float = 1.75) -> Array:
    """Chou and Hannaford (1996), equation 11: force in N."""
    length, b = length_mm * 1e-3, b_mm * 1e-3
    return np.asarray(p_kpa * 1e3 * (3.0 * length**2 - b**2) / (4.0 * np.pi * n**2))


def write(folder: Path, **files: str) -> Path:
    """Write `files` (name without dot: `muscle_py`); returns the path of the description."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        stem, _, ending = name.rpartition("_")
        (folder / f"{stem}.{ending}").write_text(text, encoding="utf-8")
    return folder / "simulator.toml"


def built_fmu(folder: Path, fmi: int = 2) -> Path:
    """The example's FMU, compiled on this machine; the test is skipped without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    pytest.importorskip("fmpy")
    folder.mkdir(parents=True, exist_ok=True)
    spec = importlib.util.spec_from_file_location("fmu_build", EXAMPLES / "fmu" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    try:
        return Path(module.build(folder / "muscle.fmu", fmi, compiler))
    except subprocess.CalledProcessError as error:
        raise AssertionError(error.stderr) from error


def trial(
    channels: Mapping[str, tuple[Any, Any]],
    name: str = "t1",
    held_mm: float = 60.0,
    load_kg: float = float("nan"),
    settled: bool = False,
) -> Trial:
    """A trial of channels by name: times and values."""
    made = {
        key: Channel(np.asarray(t, dtype=np.float64), np.asarray(v, dtype=np.float64))
        for key, (t, v) in channels.items()
    }
    rows = max(len(channel) for channel in made.values())
    return Trial(
        name=name, slot="s", replicate="1", protocol="isometric", mounting="m", order=1.0,
        held_length_mm=held_mm, load_kg=load_kg, temperature_c=21.0, start_s=0.0, settled=settled,
        channels=made, direction=np.zeros(rows, dtype=np.int64),
    )  # fmt: skip


def valve_trial(supply: bool = True) -> Trial:
    """Ten seconds at 60 mm: the inlet opens from 1.0 to 1.2503 s, the outlet from 5 to 5.1 s."""
    t = np.arange(0.0, 10.0, 0.01)
    channels = {
        "pressure_kpa": (t, np.full(len(t), 3.0)),
        "inlet_cmd": ([0.0, 1.0, 1.2503], [0.0, 1.0, 0.0]),
        "outlet_cmd": ([0.0, 5.0, 5.1], [0.0, 1.0, 0.0]),
        "force_n": (t[::3] + 0.002, np.zeros(len(t[::3]))),
    }
    if supply:
        channels["supply_kpa"] = ([0.0, 10.0], [600.0, 600.0])
    return trial(channels)


def chamber_kpa(t: Array, rate: float = 5.0, supply: float = 600.0) -> Array:
    """Exact pressure of the example's chamber in `valve_trial`."""
    filled = supply * (1.0 - np.exp(-rate * np.clip(t - 1.0, 0.0, 0.2503)))
    return np.asarray(filled * np.exp(-rate * np.clip(t - 5.0, 0.0, 0.1)))
