"""Settled points for models: from a recorded or imported run, or from a table of the thesis."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.errors import PamrigError

if TYPE_CHECKING:
    from daq.store.run import Run
    from plant.fitting.data import Points

_SI = {"pressure_kpa": 1e3, "length_mm": 1e-3, "force_n": 1.0}
_SENSOR = {"pressure_kpa": "pressure", "length_mm": "length", "force_n": "force"}
_THESIS = re.compile(r"^c-?0?[1-6]$", re.IGNORECASE)


def load_points(data: str, runs: Path, warm: bool = False) -> Points:
    """Points of a thesis table ("c01", "C-1") or of a run (folder, id, part of an id, "last").

    Args:
        data: what the user named.
        runs: folder of runs.
        warm: also the columns of a thesis table above 21 degC, which are a formula.

    Raises:
        PamrigError: no such run or table, or it holds no points that can be used.
    """
    from daq.store.store import find_run
    from plant.errors import PlantError
    from plant.fitting.thesis_points import thesis_points

    if _THESIS.match(data) and not Path(data).exists():
        try:
            return thesis_points(f"c0{data[-1]}", warm)
        except PlantError as error:
            raise PamrigError(data, str(error), "name a run or one of those tables") from None
    return run_points(find_run(runs, data))


def run_points(run: Run) -> Points:
    """The settled points of a run, with what the record knows of their errors.

    Raises:
        PamrigError: the run has no points with pressure, length and force.
    """
    from analysis.reduction.points import reduce_isometric
    from plant.fitting.data import Points, SensorErrors
    from plant.models.law import History

    reduction = reduce_isometric(run)
    table = reduction.table
    needed = list(_SI)
    usable = table[needed].notna().all(axis=1) & table["settled"]
    rows = table[usable]
    if not len(rows):
        why = reduction.notes[0] if reduction.notes else "none of its points is settled"
        raise PamrigError(run.run_id, why, "a model needs settled points: name another run")
    # Trials of a run follow one another; each begins with the muscle vented and the scale tared.
    slots = rows["trial"].astype(str) + "/" + rows["slot"].astype(str)
    start = (slots != slots.shift()).to_numpy(dtype=np.bool_)
    temperature = rows["temperature_c"].to_numpy(dtype=np.float64)
    noise: dict[str, Any] = {}
    for name, factor in _SI.items():
        values = rows[f"u_{name}_noise"].to_numpy(dtype=np.float64) * factor
        noise[f"sd_{_SENSOR[name]}_{'pa' if name[0] == 'p' else name.split('_')[1][-1]}"] = (
            values if np.all(np.isfinite(values)) and np.any(values > 0) else None
        )
    if any(v is None for v in noise.values()):
        noise = dict.fromkeys(noise)
    sensors = {}
    for name, calibration in reduction.calibrations.items():
        if name not in _SENSOR:  # a quantity that the models do not take, such as a hung load
            continue
        sensors[_SENSOR[name]] = SensorErrors(
            zero=calibration.u_offset * _SI[name],
            gain=calibration.u_gain,
            origin=calibration.offset * _SI[name],
            zero_per_trial=name == "force_n",  # a balance is tared before each trial
        )
    lengths = rows["set_length_mm"].fillna(rows["length_mm"].round(1))
    pressures = rows["set_pressure_kpa"].fillna(rows["pressure_kpa"].round(0))
    cells = [
        f"{p:g} kPa {x:g} mm {d}"
        for p, x, d in zip(pressures, lengths, rows["direction"], strict=True)
    ]
    return Points(
        pressure_pa=rows["pressure_kpa"].to_numpy(dtype=np.float64) * 1e3,
        length_m=rows["length_mm"].to_numpy(dtype=np.float64) * 1e-3,
        temperature_c=np.where(np.isfinite(temperature), temperature, 21.0),
        force_n=rows["force_n"].to_numpy(dtype=np.float64),
        **noise,
        sensors=sensors,
        length_label=np.array([f"{x:g} mm" for x in lengths]),
        mounting_label=rows["mounting"].astype(str).to_numpy(dtype=np.str_),
        cell=np.array(cells),
        path=History(None, start),
        source=f"run {run.run_id}",
    )
