"""Remarks on units and signs: one test told right, and with each slip that a mapping may have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gap.data.plausible import remarks
from gap.data.reader import read_dataset
from gap.thesis.data import thesis_set
from import_sets import imported
from plant.physics.muscle import braid_force

BRAID_MM, TURNS = 120.0, 2.4
BENCH = f"braid_length_mm = {BRAID_MM}\nturns = {TURNS}\nlength_max_mm = 100.0\n"
Change = Callable[[pd.DataFrame], None]


def steps(change: Change | None = None) -> pd.DataFrame:
    """Three trials of a muscle that is filled and vented, held at lengths of its own each."""
    rng = np.random.default_rng(4)
    made = []
    for k, length_mm in enumerate((78.0, 84.0, 90.0)):
        t = np.arange(0.0, 4.0, 0.02)
        inlet, outlet = (t > 0.5) & (t < 1.5), t > 2.5
        kpa = np.where(t < 0.5, 0.0, 480.0 * (1.0 - np.exp(-(t - 0.5) / 0.2)))
        kpa = np.where(t > 2.5, 480.0 * np.exp(-(t - 2.5) / 0.2), kpa)
        newton = [braid_force(1e3 * p, 1e-3 * length_mm, 1e-3 * BRAID_MM, TURNS) for p in kpa]
        made.append(pd.DataFrame({
            "trial": f"t{k}", "time_s": t, "inlet_cmd": inlet.astype(int),
            "outlet_cmd": outlet.astype(int),
            "pressure_kpa": kpa + 0.3 * rng.standard_normal(len(t)),
            "length_mm": length_mm + 0.02 * rng.standard_normal(len(t)),
            "force_n": np.array(newton) + 0.1 * rng.standard_normal(len(t)),
            "supply_kpa": 500.0,
        }))  # fmt: skip
    table = pd.concat(made, ignore_index=True)
    if change is not None:
        change(table)
    return table


def notes_of(folder: Path, table: pd.DataFrame, **trials: Any) -> list[str]:
    """What reading such a set remarks."""
    names = table["trial"].unique()
    facts = {"trial": names, "slot": names, "order": range(1, len(names) + 1), **trials}
    pd.DataFrame(facts).to_csv(folder / "trials.csv", index=False)
    table.to_csv(folder / "samples.csv", index=False)
    (folder / "bench.toml").write_text(BENCH)
    return list(read_dataset(folder).notes)


def _times(column: str, factor: float, offset: float = 0.0) -> Change:
    def change(table: pd.DataFrame) -> None:
        table[column] = factor * table[column] + offset

    return change


def _exchanged(table: pd.DataFrame) -> None:
    table[["inlet_cmd", "outlet_cmd"]] = table[["outlet_cmd", "inlet_cmd"]].to_numpy()


def _psi(table: pd.DataFrame) -> None:
    table[["pressure_kpa", "supply_kpa"]] /= 6.894757


def test_a_test_told_right_has_no_remark(tmp_path: Path) -> None:
    assert notes_of(tmp_path, steps()) == []


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_psi, "forces are 6.89 times those of the muscle as stated, as of pressures in psi read"),
        (_times("force_n", 1.0 / 9.80665), "as of pressures in mbar read as kPa, or forces in kgf"),
        (_times("force_n", 1.0 / 4.448222), "as of forces in lbf read as N"),
        (_times("force_n", 1e-3), "as of pressures in Pa read as kPa, or forces in kN read as N"),
        (_times("pressure_kpa", 0.01), "no pressure is above 4.81 kPa: check the unit"),
        (_times("pressure_kpa", 10.0), "kPa: check the unit of pressure_kpa (mbar?)"),
        (_times("pressure_kpa", 1.0, 101.3), "if the muscle was vented then, the pressure is abs"),
        (_times("force_n", -1.0), "per kPa of pressure: force_n is the pull, check its sign"),
        (_times("supply_kpa", 1.0 / 6.894757), "from a supply of 72.52 kPa: check the units"),
        (_exchanged, "the pressure falls while inlet_cmd is 1 or rises while outlet_cmd is 1"),
    ],
)
def test_a_slip_is_remarked(tmp_path: Path, change: Change, told: str) -> None:
    notes = notes_of(tmp_path, steps(change))
    assert any(told in note for note in notes), notes


def test_a_contraction_that_is_read_as_a_length_is_remarked(tmp_path: Path) -> None:
    table = steps()
    kpa = table["pressure_kpa"]
    rest = table["length_mm"] + 20.0
    assert notes_of(tmp_path, table.assign(length_mm=rest - 0.04 * kpa), load_kg=2.0) == []
    notes = notes_of(tmp_path, table.assign(length_mm=40.0 + 0.04 * kpa), load_kg=2.0)
    assert any("the length grows with the pressure in 3 of 3 trials" in note for note in notes)


def test_an_import_tells_it_before_anything_is_diagnosed(tmp_path: Path) -> None:
    table = steps(_psi)
    table[table["trial"] == "t1"].to_csv(tmp_path / "run.csv", index=False)
    (made,) = imported(
        tmp_path,
        f"""
[source]
files = "run.csv"
[time]
column = "time_s"
unit = "s"
[channels.pressure_kpa]
column = "pressure_kpa"
unit = "kPa"
reference = "gauge"
[channels.length_mm]
column = "length_mm"
unit = "mm"
[channels.force_n]
column = "force_n"
unit = "N"
[bench]
{BENCH}""",
        dry=True,
    )
    assert any("pressures in psi read as kPa" in note for note in made.notes)


@pytest.mark.parametrize("table", ["c01", "c03", "c04", "c06"])
def test_the_tables_of_the_thesis_have_none(table: str) -> None:
    assert remarks(thesis_set(table)) == []
