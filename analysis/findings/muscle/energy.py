"""Work and efficiency in the reports: of cycles under a load, and of loops of length and force."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import EXPANDED, Section
from analysis.reduction.muscle.energy import (
    State,
    cycle_energy,
    loop_work,
    stated_air,
)

if TYPE_CHECKING:
    import pandas as pd

    from daq.calibration import Calibration

ENERGY_COLUMNS = (
    ("work_j", "work of the stroke, J"), ("exergy_j", "exergy of the air, J"),
    ("efficiency", "efficiency"),
)  # fmt: skip
ENERGY_WORDS = (
    "Work of a stroke: weight times stroke. Over the whole cycle it is zero: what was lifted comes"
    " down again. Exergy of the air: (p_high V_high − p_low V_low) ln(p_supply / p_atmosphere),"
    " with absolute pressures and the stated volume: the most work that the air used in a cycle"
    " could give. Efficiency: work of the stroke over that exergy. Neither is given for a length"
    " beyond those whose volume is stated.",
)
NOT_KNOWN = (
    "The volume of the muscle is not known: the protocol file has no [air], so neither the exergy"
    " of the air nor an efficiency is given."
)
FEWEST = 4
"""A loop has so many points or more."""


def lifting_section(
    table: pd.DataFrame, parameters: Mapping[str, Any], camera: Calibration | None
) -> tuple[Section | None, list[dict[str, Any]]]:
    """Work and efficiency of each cycle under a load, between its lowest and highest pressure.

    Args:
        table: settled points under loads, with ``cycle_max_kpa``.
        parameters: of run.json; ``air`` states the volume.
        camera: calibration of the lengths; the zero cancels in the stroke.
    """
    import pandas as pd

    air = stated_air(parameters)
    rows: list[dict[str, Any]] = []
    for (mass, top, repeat), part in table.groupby(["mass_kg", "cycle_max_kpa", "repeat"]):
        part = part[part["length_mm"].notna()]
        if len(part) < 2:
            continue
        ends = [
            part[part["set_pressure_kpa"] == edge]
            for edge in (part["set_pressure_kpa"].max(), part["set_pressure_kpa"].min())
        ]
        high, low = (_state(end) for end in ends)
        weight, u_weight = (float(part[name].mean()) for name in ("force_n", "u_force_n"))
        stroke = low.length_mm - high.length_mm
        noise = math.hypot(*(_noise(end) for end in ends))
        gain = 0.0 if camera is None else camera.u_gain * stroke
        work = weight * stroke * 1e-3
        u_work = math.hypot(weight * math.hypot(noise, gain) * 1e-3, u_weight * stroke * 1e-3)
        made = cycle_energy(work, u_work, high, low, air)
        rows.append(
            {"held": f"{float(str(mass)):g} kg", "top": float(str(top)), "repeat": int(str(repeat)),
             "stroke": stroke, "u_stroke": math.hypot(noise, gain), **vars(made)}
        )  # fmt: skip
    if not rows:
        return None, []
    words = (*ENERGY_WORDS, *(() if air is not None else (NOT_KNOWN,)))
    columns = (
        ("held", "load"), ("top", "turned at, kPa"), ("repeat", "repeat"), ("stroke", "stroke, mm"),
        *ENERGY_COLUMNS,
    )  # fmt: skip
    frame = pd.DataFrame(rows)
    return Section("Work and efficiency", words, frame, columns, caption=f"{EXPANDED}."), rows


def _state(end: pd.DataFrame) -> State:
    mean = end[["pressure_kpa", "u_pressure_kpa", "length_mm", "u_length_mm"]].mean()
    return State(*(float(value) for value in mean))


def _noise(end: pd.DataFrame) -> float:
    return float(end["u_length_mm_noise"].astype(float).max()) / math.sqrt(len(end))


def loops_section(
    table: pd.DataFrame, calibrations: Mapping[str, Calibration]
) -> tuple[Section | None, list[dict[str, Any]]]:
    """Work lost over each loop of length at a held pressure: stretched and let back.

    Args:
        table: settled points of isobaric trials, with both directions.
        calibrations: by quantity; the zeros cancel over a closed loop, the gains scale it.
    """
    import pandas as pd

    gain = math.hypot(*(c.u_gain for k, c in calibrations.items() if k in ("force_n", "length_mm")))
    rows: list[dict[str, Any]] = []
    for (trial, pressure), part in table.groupby(["trial", "set_pressure_kpa"]):
        del trial
        part = part.dropna(subset=["length_mm", "force_n"]).sort_values("order")
        if len(part) < FEWEST or set(part["direction"]) != {"up", "down"}:
            continue
        force, length, u_force, u_length, kpa = (
            part[name].to_numpy(np.float64)
            for name in (
                "force_n", "length_mm", "u_force_n_noise", "u_length_mm_noise", "pressure_kpa",
            )
        )  # fmt: skip
        # Force is about proportional to pressure, which the valve leaves within its dead zone.
        wander = float(kpa.std()) / max(float(kpa.mean()), 1.0)
        work, u = loop_work(force, length, np.hypot(u_force, force * wander), u_length)
        rows.append(
            {"pressure_kpa": float(str(pressure)), "repeat": part["repeat"].iloc[0],
             "lost_mj": -1e3 * work, "u_lost_mj": 1e3 * math.hypot(u, gain * work)}
        )  # fmt: skip
    if not rows:
        return None, []
    words = (
        "The closed integral of F dL through the points in their order: what a tester gives to the"
        " muscle and does not get back. The pressure is held, so that the gas gives no work over"
        " the loop. The zeros of force and length cancel; what the pressure wandered from point to"
        " point is part of the uncertainty.",
    )
    columns = (
        ("pressure_kpa", "pressure, kPa"), ("repeat", "repeat"), ("lost_mj", "work lost, mJ"),
    )  # fmt: skip
    frame = pd.DataFrame(rows)
    return Section(
        "Work over a loop of length", words, frame, columns, caption=f"{EXPANDED}."
    ), rows
