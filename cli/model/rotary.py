"""`pamrig models rotary`."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer

from cli.options import JsonOption, bounded
from daq.errors import ConfigError

ANGLES = 9
"""Angles of the table if none are given, spread over the range of the geometry."""
INSIDE = 0.99
"""The largest of them, as a share of the angle at which the sleeve lies flat."""
MOST_VALUES = 10_000


def rotary(
    radius_mm: Annotated[float, typer.Option(help="Radius of the cylinder.")] = 15.0,
    length_mm: Annotated[float, typer.Option(help="Length between the ends of the sleeve.")] = 40.0,
    fibre_mm: Annotated[float, typer.Option(help="Length of a fibre; above --length-mm.")] = 50.0,
    pressures: Annotated[
        str, typer.Option("--pressures-kpa", "--pressures", help="Gauge pressures in kPa.")
    ] = "100,300,500",
    angles: Annotated[
        str,
        typer.Option(
            "--angles-deg", "--angles", help="Angles in degrees; default: over the whole range."
        ),
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Torque and volume of the rotary muscle of chapter 3 against angle and pressure."""
    for option, size_mm in (
        ("--radius-mm", radius_mm), ("--length-mm", length_mm), ("--fibre-mm", fibre_mm),
    ):  # fmt: skip
        bounded(option, size_mm, 0.0, 1e5, "mm", above=True)
    kpa = _numbers(pressures, "--pressures-kpa", "100,300,500")
    for value in kpa:
        bounded("--pressures-kpa", value, 0.0, 1e5, "kPa")
    found = _table(radius_mm, length_mm, fibre_mm, kpa, _numbers(angles, "--angles-deg", "0,20,40"))
    if as_json:
        from cli.output import print_json

        print_json(found)
        return
    low, high = found["range_deg"]
    typer.echo(
        f"rotary muscle: radius {radius_mm:g} mm, length {length_mm:g} mm, fibre {fibre_mm:g} mm;"
        f" |angle| from {low:.2f} to below {high:.2f} deg"
    )
    heads = "".join(f"{f'{p:g} kPa, N m':>16}" for p in kpa)
    typer.echo(f"{'angle, deg':>12}{'bulge, ml':>12}{'dV/dangle, ml/rad':>20}{heads}")
    for row in found["rows"]:
        torques = "".join(f"{torque:16.5f}" for torque in row["torque_n_m"])
        typer.echo(
            f"{row['angle_deg']:12.3f}{row['bulge_ml']:12.4f}{row['dvolume_ml_per_rad']:20.5f}"
            + torques
        )


def _table(
    radius_mm: float, length_mm: float, fibre_mm: float, kpa: list[float], angles: list[float]
) -> dict[str, Any]:
    """Geometry, range and one row per angle. Raises `PlantError` where there is no geometry."""
    import numpy as np

    from plant.physics.rotary import RotaryMuscle

    muscle = RotaryMuscle(radius_mm * 1e-3, length_mm * 1e-3, fibre_mm * 1e-3)
    low, high = muscle.range_rad
    theta = np.radians(angles) if angles else np.linspace(low, low + INSIDE * (high - low), ANGLES)
    torque = muscle.torque_n_m(np.array(kpa)[None, :] * 1e3, theta[:, None])
    volume, slope = muscle.bulge_volume(theta), muscle.dvolume_dtheta(theta)
    return {
        "radius_mm": radius_mm, "length_mm": length_mm, "fibre_mm": fibre_mm,
        "range_deg": [math.degrees(low), math.degrees(high)],
        "pressures_kpa": kpa,
        "rows": [
            {
                "angle_deg": math.degrees(float(theta[k])),
                "bulge_ml": float(volume[k]) * 1e6,
                "dvolume_ml_per_rad": float(slope[k]) * 1e6 + 0.0,
                "torque_n_m": [float(value) for value in torque[k]],
            }
            for k in range(len(theta))
        ],
    }  # fmt: skip


def _numbers(text: str, option: str, example: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)) or len(numbers) > MOST_VALUES:
        raise ConfigError(
            option, f"{text[:60]!r} is not a list of numbers", f"write it as {example}"
        )
    return numbers
