"""The trials of one muscle in a test of a joint: locked, with that muscle alone under pressure.

Two muscles that pull at once share one torque, and no sensor of the joint tells their forces apart.
Alone at a locked angle, a muscle is an isometric trial: its force is the torque over the lever arm,
its length that at angle 0 less what the angle has taken up. The lock gives way a little under the
torque. The trial is held at its mean length, and each force is that at this length, by the slope of
the torque over the angle that the run itself shows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from analysis.reduction.joint import JointRecord
from analysis.run_table import reduce_run
from daq.errors import RecordError
from daq.store.run import Run
from gap.data.run_trials import RunTrial

MUSCLES = ("a", "b")
NEEDED = ("radius_mm", "rest_mm")


def is_joint(run: Run) -> bool:
    """Whether a run is a test of a joint."""
    return "joint" in run.manifest


def joint_trials(run: Run, muscle: str) -> Iterator[RunTrial]:
    """One isometric trial of settled points for each locked angle.

    Args:
        run: a static test of a joint with points of one muscle alone (``alone_kpa``).
        muscle: "a" or "b".

    Raises:
        RecordError: the run holds no such points, or does not state what makes a length and a force
            of angle and torque; says which.
    """
    radius, rest = _geometry(run)
    table = reduce_run(run).table
    own = table[(table["state"] == muscle) & table["settled"]] if "state" in table else table[:0]
    if not len(own):
        raise RecordError(
            str(run.folder),
            f"is a test of a joint without points of muscle {muscle} alone; of two muscles that"
            " pull at once only the sum is known",
            "run joint-static with alone_kpa and angles_deg in its file",
        )
    own = own.assign(per_rad=_torque_per_rad(own, muscle))
    way = 1.0 if muscle == "a" else -1.0
    conditions = run.manifest.get("conditions") or {}
    wall_s = int(run.manifest["started"].get("wall_ns", 0)) * 1e-9
    for trial, rows in own.groupby("trial", sort=True):
        first = rows.iloc[0]
        angle = np.radians(rows["angle_deg"].to_numpy(float))
        torque = rows["torque_n_m"].to_numpy(float)
        torque = torque - rows["per_rad"].to_numpy(float) * (angle - angle.mean())
        samples = pd.DataFrame(
            {
                "pressure_kpa": rows[f"pressure_{muscle}_kpa"].to_numpy(float),
                "force_n": way * torque / (radius * 1e-3),
            }
        )
        words = rows["direction"].astype(str).reset_index(drop=True)
        samples["direction"] = words.where(words.isin(["up", "down"]), None)
        yield RunTrial(
            {
                "trial": f"{run.run_id}:{trial}{muscle}",
                "slot": f"isometric:{first['slot']} {muscle}",
                "replicate": first["repeat"],
                "protocol": "isometric",
                "mounting": first["mounting"],
                # By the encoder, which knows it far better than a person sets the lock.
                "held_length_mm": rest - way * radius * float(angle.mean()),
                "load_kg": None,
                "temperature_c": conditions.get("temperature_c"),
                "start_s": wall_s + float(first["order"]),
                "note": run.run_id,
            },
            samples,
        )


def joint_calibration(run: Run, muscle: str) -> dict[str, float]:
    """What pressure, force and length of a muscle may be off by in all trials alike.

    Raises:
        RecordError: as :func:`joint_trials`.
    """
    radius, _ = _geometry(run)
    record = JointRecord(run)
    pressure = record.pressures["valve" if muscle == "a" else "valve_b"]
    u_radius = float(run.manifest["joint"].get("u_radius_mm") or 0.0) / radius
    found: dict[str, Any] = {
        "pressure_zero_kpa": pressure.u_offset,
        "pressure_gain_percent": 100.0 * pressure.u_gain,
        "force_zero_n": record.torque_zero_n_m / (radius * 1e-3),
        "force_gain_percent": 100.0 * math.hypot(record.torque_gain, u_radius),
        "length_zero_mm": radius * math.radians(record.angles.u_offset),
    }
    return {key: float(value) for key, value in found.items() if value > 0.0}


def _torque_per_rad(own: pd.DataFrame, muscle: str) -> Any:
    """dT/dq of each point of a muscle alone, N m/rad; 0 where the angles do not show it."""
    if own["set_angle_deg"].nunique() < 2:
        return 0.0
    kpa = own[f"pressure_{muscle}_kpa"].to_numpy(float)
    design = np.column_stack([kpa, kpa * np.radians(own["angle_deg"].to_numpy(float))])
    found, *_ = np.linalg.lstsq(design, own["torque_n_m"].to_numpy(float), rcond=None)
    return kpa * float(found[1])


def _geometry(run: Run) -> tuple[float, float]:
    """Lever arm and length at angle 0, in mm."""
    joint = run.manifest["joint"]
    missing = [f"joint.{key}" for key in NEEDED if not joint.get(key)]
    if missing:
        raise RecordError(
            str(run.folder),
            f"is a test of a joint, and its rig file does not state {' and '.join(missing)}",
            "they make length and force of angle and torque: add them and run the test again",
        )
    return float(joint["radius_mm"]), float(joint["rest_mm"])
