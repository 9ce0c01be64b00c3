"""Rigs and tiny tests of the campaign, as files: a run is continued from its files."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from rigs.protocols.names import PROTOCOLS, default_rig

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
EMPTY_S = {"virtual-thesis-loop": 0.3}
EMPTY_ELSE_S = 1.5
"""How long the muscle takes from the command to below 20 kPa, by rig (docs/safety-contract.md)."""

assert set(CLASSES) == set(PROTOCOLS)


def empty_s(protocol: str) -> float:
    """The deadline for emptying on this protocol's rig."""
    return EMPTY_S.get(default_rig(protocol), EMPTY_ELSE_S)


@lru_cache
def lay_out(folder: Path) -> dict[str, tuple[Path, Path]]:
    """Write the files; (rig, protocol) of each protocol."""
    folder.mkdir(parents=True, exist_ok=True)
    out = {}
    for name in PROTOCOLS:
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
