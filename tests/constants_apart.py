"""Numbers that stand in the blind bench and in the diagnosis: a common one ties them together.

Every number written in a source is taken with its effect: in `plant/effects` a file is an effect;
in `blind` a number belongs to the effect whose row of the matrix the code around it reads. Numbers
are compared by their digits alone, so that 4 mm/s and 4e-3 m/s are the same number.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from blind.physics import numbers as n
from blind.physics.entries import CATALOGUE

ROOT = Path(__file__).resolve().parent.parent
# Constants of `numbers` that are rows of the effect matrix stand from LINER to WEAR.
_NAMES = [name for name in vars(n) if name.isupper()]
_ROW_NAMES = _NAMES[_NAMES.index("LINER") : _NAMES.index("WEAR") + 1]
ROWS = dict(zip(_ROW_NAMES, n.EFFECT_IDS, strict=True))
BLIND = ("kernel", "laws", "readings", "bench", "stepping")
# Functions that serve one effect from beginning to end.
OWN = {
    "lost_pressure": "liner_threshold", "shortening": "end_cap", "stretch": "fibre_stretch",
    "warmth": "temperature_stiffening", "wear": "wear", "spring": "bladder_elasticity",
    "jammed": "contraction_limit", "rate_force": "viscosity", "level": "braid_friction",
    "slip_rate": "braid_friction", "side_flow": "dead_volume", "swollen": "dead_volume",
    "swelling": "dead_volume", "valved_flow": "dead_volume", "slow_wall": "dead_volume",
    "preloaded": "dead_volume", "springing": "dead_volume", "sorbed_rate": "dead_volume",
    "leak": "leak", "area": "flow_area", "discharge": "flow_area", "choking": "critical_ratio",
    "exponent": "polytropic", "wall_rate": "polytropic", "stirred_rate": "polytropic",
    "sag_rate": "supply_droop",
    "late": "valve_delay", "late_with_pressure": "valve_delay_pressure",
    "edge_after": "transport_delay", "slide_drag": "link_friction", "tap_rates": "pressure_lag",
    "lever": "payload", "label_shift": "length_label", "pressure_span": "pressure_gain",
    "force_span": "force_gain", "picture_scale": "camera_scale",
    "picture_bend": "camera_distortion", "frame_delay_s": "camera_delay", "relaxation": "creep",
    "viscous_force": "viscosity", "friction_level": "braid_friction", "leak_flow": "leak",
}  # fmt: skip
DRAWS = {e.shape.__name__: e.id for e in CATALOGUE if e.shape is not None}


@dataclass(frozen=True)
class Number:
    """One number in a source: its effect, value, file and line."""

    effect: str
    value: float
    place: str


def digits(value: float) -> str:
    """Significant digits without the power of ten, six at most."""
    return f"{abs(value):.5e}".split("e")[0].rstrip("0").rstrip(".")


def literal(node: ast.AST) -> float | None:
    """The number a node writes, whole or not; None for anything else (truth values too)."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return float(node.value)
    return None


def effect_in(node: ast.AST) -> str | None:
    """The effect whose row a piece of code reads."""
    for inner in ast.walk(node):
        if (
            isinstance(inner, ast.Attribute)
            and isinstance(inner.value, ast.Name)
            and inner.value.id == "n"
            and inner.attr in ROWS
        ):
            return ROWS[inner.attr]
    return None


def of_block(body: list[ast.stmt], current: str | None, place: str) -> Iterator[Number]:
    """Numbers of statements in order; an effect holds from where its row is read."""
    for statement in body:
        blocks = [getattr(statement, name, []) for name in ("body", "orelse")]
        if any(blocks):
            test = getattr(statement, "test", None)
            inside = (effect_in(test) if test is not None else None) or current
            if test is not None:
                yield from of_numbers(test, inside, place, compared=True)
            for block in blocks:
                yield from of_block(block, inside, place)
        else:
            current = effect_in(statement) or current
            yield from of_numbers(statement, current, place)


def of_numbers(
    node: ast.AST, effect: str | None, place: str, compared: bool = False
) -> Iterator[Number]:
    """Numbers in one piece of code that belongs to an effect; no index, no number of a form."""
    if effect is None or (compared and isinstance(node, ast.Compare)):
        return
    places = [s.slice for s in ast.walk(node) if isinstance(s, ast.Subscript)]
    skipped = {id(inner) for one in places for inner in ast.walk(one)}
    for inner in ast.walk(node):
        value = literal(inner)
        if value is not None and id(inner) not in skipped:
            yield Number(effect, value, f"{place}:{inner.lineno}")  # type: ignore[attr-defined]


def in_blind() -> list[Number]:
    """Numbers of the forms of the blind bench, by effect."""
    found: list[Number] = []
    for name in (*BLIND, "alternatives", "entries"):
        path = ROOT / "blind" / "physics" / f"{name}.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                own = OWN.get(node.name) or DRAWS.get(node.name)
                found += of_block(node.body, own, f"blind/physics/{name}.py")
    return found


# What a search is told of ranges, steps and tolerances is no part of a form.
BOUNDS = ("step", "free", "settled", "each_trial", "reference", "plant_misfit", "sign")


def in_diagnosis() -> list[Number]:
    """Numbers of the forms by which the diagnosis and the plant know each effect."""
    ids = {e.id for e in CATALOGUE}
    found: list[Number] = []
    for path in sorted((ROOT / "plant" / "effects").rglob("*.py")):
        if path.stem not in ids:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        left_out: set[int] = set()
        for node in ast.walk(tree):
            bound = isinstance(node, ast.keyword) and node.arg in BOUNDS
            called = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            if bound or (called and node.func.id == "Parameter"):  # type: ignore[attr-defined]
                left_out |= {id(inner) for inner in ast.walk(node)}
        place = path.relative_to(ROOT).as_posix()
        for node in ast.walk(tree):
            value = literal(node)
            if value is not None and id(node) not in left_out:
                found.append(Number(path.stem, value, f"{place}:{node.lineno}"))  # type: ignore[attr-defined]
    return found


def alike(a: float, b: float) -> bool:
    """Whether two numbers are the same but for a change of unit.

    Of several digits: whatever the power of ten. Of one: as they stand, as shares or per cent, or
    with a thousand between them.
    """
    if digits(a) != digits(b):
        return False
    return len(digits(a)) > 1 or round(abs(math.log10(abs(a / b)))) in (0, 3, 6)
