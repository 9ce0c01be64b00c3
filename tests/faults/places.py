"""Rigs and tiny tests of the campaign, as files: a run is continued from its files."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from plant.constants import GAS_CONSTANT_J_KG_K, PlantConstants, nominal
from plant.physics.flow import mass_flow_kg_s
from plant.physics.muscle import braid_volume
from plant.scene.ram import RamConstants
from rigs.protocols.names import PROTOCOLS, default_rig
from rigs.rigfile.config import RigConfig, load_rig
from valvefw.config import defaults
from valvefw.core import JUMP_N

CHANGES = {
    "isometric": (("[100, 200, 300]", "[100, 250]"), ("cycles = 1", "cycles = 0")),
    "isobaric": (("[59.0, 62.0]", "[61.0]"),),
    "isotonic": (("[150, 300]", "[250]"),),
    "isothermal": (("[21.0, 22.0]", "[21.0]"),),
    "hysteresis": (
        ("cycles_kpa = [200]", "cycles_kpa = [150]"),
        ("step_kpa = 100", "step_kpa = 75"),
    ),
    "flow": (("[50, 90, 120, 150]", "[60, 120]"),),
}  # fmt: skip
RIG_CHANGES = {"virtual": (("frames = 60", "frames = 30"),)}
CLASSES = {
    "isometric": "static", "isobaric": "static", "isotonic": "static", "isothermal": "static",
    "hysteresis": "static", "switching-time": "valve", "switching-voltage": "valve",
    "flow": "valve", "step": "control", "ram": "control",
}  # fmt: skip
"""Protocols that are alike, for the page."""
EMPTY_KPA = 20.0
EMPTY_SHARE, EMPTY_MORE_S = 1.15, 0.05
"""Empty in time: below 20 kPa in 1.15 times what ISO 6358 gives for the open outlet and the rig's
largest chamber, and 50 ms for the valves (docs/reference/safety-contract.md)."""
STEP_S = 1e-3

OF_JOINT = {"joint-static", "joint-step"}
"""Their rig has other devices; `tests/test_joint_safety.py` harms it."""
OF_MUSCLE = {
    "blocked-force", "free-contraction", "creep", "relaxation", "dynamic", "fatigue",
}  # fmt: skip
"""Made of steps of the others, and with tests of their own."""

assert set(CLASSES) | OF_JOINT | OF_MUSCLE == set(PROTOCOLS)


@lru_cache
def rig_of(protocol: str) -> RigConfig:
    """The rig that a protocol runs on."""
    return load_rig(default_rig(protocol))


def plant_of(protocol: str) -> PlantConstants:
    """The constants of its bench."""
    virtual = rig_of(protocol).virtual
    assert virtual is not None
    return nominal().with_overrides(virtual.plant)


@lru_cache
def _emptying(protocol: str) -> tuple[list[float], list[float]]:
    """Pressures in kPa, falling, and the seconds it takes to them from 1.2 MPa."""
    c, ram = plant_of(protocol), RamConstants()
    virtual = rig_of(protocol).virtual
    if virtual is not None and virtual.load == "ram":
        volume_m3 = ram.dead_volume_m3 + ram.area_m2 * ram.stroke_m
    else:
        ends = c.length_min_m, c.length_max_m
        volume_m3 = max(float(braid_volume(x, c.braid_length_m, c.turns)) for x in ends)
        volume_m3 += c.dead_volume_m3
    per_kg_pa = GAS_CONSTANT_J_KG_K * c.gas_temperature_k / volume_m3
    kpa, seconds = [1200.0], [0.0]
    while kpa[-1] > EMPTY_KPA:
        flow = mass_flow_kg_s(
            kpa[-1] * 1e3 + c.atmosphere_pa, c.atmosphere_pa, c.outlet_conductance_m3_s_pa,
            c.critical_ratio, c.gas_temperature_k,
        )  # fmt: skip
        kpa.append(kpa[-1] - flow * per_kg_pa * STEP_S * 1e-3)
        seconds.append(seconds[-1] + STEP_S)
    return kpa, seconds


def empty_s(protocol: str, kpa: float) -> float:
    """The deadline for emptying this protocol's rig from a pressure."""
    pressures, seconds = _emptying(protocol)
    took_s = seconds[-1] - float(np.interp(-kpa, -np.array(pressures), seconds))
    return EMPTY_SHARE * took_s + EMPTY_MORE_S


def tellable_kpa(protocol: str) -> float:
    """From here on a reading that falls to 0 at once is no pressure: four samples at ``slew`` and
    one ``jump`` (docs/reference/safety-contract.md), with 2 kPa for noise and zero."""
    rig = rig_of(protocol)
    told = {**defaults(), **rig.valve.parameters}
    counts = JUMP_N * told["slew"] + told["jump"]
    return float(rig.calibrations["pressure_kpa"].apply(float(counts))) + 2.0


@lru_cache
def lay_out(folder: Path) -> dict[str, tuple[Path, Path]]:
    """Write the files; (rig, protocol) of each protocol."""
    folder.mkdir(parents=True, exist_ok=True)
    out = {}
    for name in CLASSES:
        rig = default_rig(name)
        paths = folder / f"{rig}.toml", folder / f"{name}-tiny.toml"
        for path, kind, source, changes in (
            (paths[0], "rigs", rig, RIG_CHANGES.get(rig, ())),
            (paths[1], "protocols", f"{name}-short", CHANGES.get(name, ())),
        ):
            text = files("configs").joinpath(kind, f"{source}.toml").read_text(encoding="utf-8")
            for old, new in changes:
                assert text.count(old) == 1, (source, old)
                text = text.replace(old, new)
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")
        out[name] = paths
    return out
