"""Results of fits and comparisons as text and as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from plant.fitting.compare import Comparison, PressureComparison
    from plant.fitting.data import Points
    from plant.fitting.fit import Fit
    from plant.fitting.misfit import Misfit
    from plant.fitting.scale import Scaling
    from plant.models.model import Model


def fit_text(found: Fit, points: Points) -> str:
    """The result of a fit as text."""
    lines = [f"{found.model.name} on {points.source}, {len(points)} points"]
    lines.append(f"{'parameter':22}{'value':>13}  {'unit':18}{'95 % interval':>28}")
    for e in found.estimates:
        interval = (
            e.state if e.state in ("fixed", "dead", "flat") else f"{e.low:.6g} to {e.high:.6g}"
        )
        mark = "  at its bound" if e.state == "at bound" else ""
        lines.append(f"{e.name:22}{e.value:>13.6g}  {e.unit:18}{interval:>28}{mark}")
    lines.append(f"rmse {found.rmse_n:.4g} N, s {found.sd_n:.4g} N")
    if math.isfinite(found.noise_scale):
        lines.append(
            f"scatter is {found.noise_scale:.2f} times the stated noise; the intervals include "
            "zero and gain of the sensors"
        )
    else:
        lines.append("no sensor errors are stated: the intervals are from the scatter only")
    lines += found.identifiability.lines()
    return "\n".join(lines)


NOISE_FROM = {
    "repeats": "scatter of repeated points",
    "roughness": "roughness of the residuals along the pressure",
    "scatter": "scatter of the fit, an upper limit",
}
ERROR_FROM = {
    "held-out pressures": "error at held-out pressures",
    "residuals": "residuals",
}
ACROSS = ("turns", "radius", "diameter", "diameter_at_90")
"""Parameters that look like dimensions across the muscle."""


def misfit_text(sizes: Misfit, model: Model) -> str:
    """Noise, systematic error, and what the fit says about the gas volume."""
    apart = sizes.noise_from != "scatter"
    lines = [
        f"noise {sizes.noise_n:.3g} N ({NOISE_FROM[sizes.noise_from]})",
        f"systematic error of the law {sizes.model_error_n:.3g} N ("
        f"{ERROR_FROM[sizes.error_from]}{', less the noise' if apart else ', an upper limit'})",
    ]
    across = [p.name for p in model.parameters if p.name in ACROSS]
    if across:
        lines.append(f"{', '.join(across)}: of the force; a fit to force gives no gas volume")
    if model.pulls_only:
        lines.append("the model pulls only: its force is 0 where the law is negative")
    if model.geometry is not None:
        g = model.geometry
        lines.append(
            f"gas volume {g.volume_m3 * 1e6:.4g} ml at {g.rest_length_mm:g} mm, from the stated "
            f"diameter of {g.diameter_mm:g} mm"
        )
    return "\n".join(lines)


def start_lines(scalings: Iterable[Scaling]) -> list[str]:
    """A line on the start values, if those of some models were scaled to the muscle."""
    changed = [s for s in scalings if s.changed]
    if not changed:
        return []
    s = changed[0]
    low, high = (f(s.force for s in changed) for f in (min, max))
    force = f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
    rest = ""
    if s.rest_length_mm is not None:
        why = "stated" if s.stated else "longest length of the data; see --rest-length-mm"
        rest = f"; rest length {s.rest_length_mm:g} mm ({why})"
    return [
        f"start values and bounds of a muscle {s.length:.3g} times as long and {force} times as "
        f"strong as that of the shipped values{rest}"
    ]


def pressures_text(found: PressureComparison) -> str:
    """The result of a comparison at held-out pressures as text."""
    lines = [
        f"{found.points} points of {found.source}; fitted to {len(found.fitted_kpa)} pressures "
        f"({found.fitted_kpa[0]} to {found.fitted_kpa[-1]}), scored at the "
        f"{len(found.held_out_kpa)} between and beyond",
        f"largest force {found.largest_force_n:g} N; the length is the error of the force over the "
        "stiffness",
        f"{'model':20}{'par':>4}{'rmse N':>9}{'worst N':>9}{'rmse %':>9}{'worst %':>9}"
        f"{'rmse mm':>9}{'worst mm':>10}",
    ]
    for s in found.scores:
        if s.trouble:
            lines.append(f"{s.model:20}{s.parameters:>4}  {s.trouble}")
            continue
        lines.append(
            f"{s.model:20}{s.parameters:>4}{s.rmse_n:>9.3f}{s.worst_n:>9.2f}{s.rmse_percent:>9.2f}"
            f"{s.worst_percent:>9.2f}{s.rmse_mm:>9.3f}{s.worst_mm:>10.2f}"
        )
    return "\n".join(lines)


def comparison_text(found: Comparison) -> str:
    """The result of a comparison as text."""
    regions = list(found.scores[0].regions)
    lines = [
        f"{found.points} points of {found.source}; groups: {len(found.groups)} {found.holdout}s "
        f"({found.groups[0]} to {found.groups[-1]}), each excluded from the fit that it tests",
        f"{'model':20}{'par':>4}{'rmse N':>8}{'95 % interval':>16}{'bias':>7}{'worst':>8}"
        + "".join(f"{r:>13}" for r in regions) + f"{'above best':>18}{'p':>7}",
    ]  # fmt: skip
    for k, s in enumerate(found.scores):
        if not math.isfinite(s.rmse_n):
            lines.append(f"{s.model:20}{s.parameters:>4}  {s.trouble}")
            continue
        line = f"{s.model:20}{s.parameters:>4}{s.rmse_n:>8.3f}"
        line += f"{s.rmse_low_n:>9.2f} to {s.rmse_high_n:.2f}{s.bias_n:>7.2f}{s.worst_n:>8.2f}"
        line += "".join(f"{s.regions[r]:>13.3f}" for r in regions)
        if k:
            line += f"{s.excess_low_n:>10.2f} to {s.excess_high_n:.2f}{s.p:>7.3f}"
            line += "  worse" if s.real else "  not significantly worse"
        lines.append(line)
    f = found.floors
    floor = f"floors: {f.between_lengths_n:.3f} N scatter between neighbouring lengths"
    if math.isfinite(f.repeat_n):
        floor += f"; {f.repeat_n:.3f} N repeatability ({f.repeats} repeats)"
    lines.append(floor)
    if math.isfinite(found.nested_rmse_n):
        chosen = ", ".join(
            f"{n} {found.nested_choices.count(n)} times"
            for n in dict.fromkeys(found.nested_choices)
        )
        lines.append(
            f"model chosen from the training groups only: {found.nested_rmse_n:.3f} N ({chosen})"
        )
    lines.append(
        "'worse': the difference from the best is significant at 5 % (sign permutation test of "
        "the groups' differences, Holm's correction)"
    )
    return "\n".join(lines)


def fit_json(found: Fit, points: Points) -> dict[str, Any]:
    """The result of a fit as JSON; infinite bounds are null."""
    from plant.fitting.fit import CONFIDENCE

    return {
        "model": model_json(found.model),
        "source": points.source,
        "points": len(points),
        "estimates": [dataclasses.asdict(e) for e in found.estimates],
        "free": list(found.free),
        "covariance": found.covariance.tolist(),
        "rmse_n": found.rmse_n,
        "s_n": found.sd_n,
        "noise_scale": found.noise_scale,
        "robust": found.robust,
        "confidence": CONFIDENCE,
        "condition": found.identifiability.condition,
        "identifiability": found.identifiability.lines(),
    }


def comparison_json(found: Comparison | PressureComparison) -> dict[str, Any]:
    """The result of a comparison as JSON."""
    value = dataclasses.asdict(found)
    for score in value["scores"]:
        del score["residual_n"]
    return value


def model_json(model: Model) -> dict[str, Any]:
    """A model as JSON."""
    value = {f.name: getattr(model, f.name) for f in dataclasses.fields(model) if f.name != "law"}
    value["parameters"] = [dataclasses.asdict(p) for p in model.parameters]
    value["domain"] = dataclasses.asdict(model.domain)
    for key in ("geometry", "covariance", "noise_n", "model_error_n", "pulls_only"):
        found = value.pop(key)
        if dataclasses.is_dataclass(found) and not isinstance(found, type):
            value[key] = dataclasses.asdict(found)
        elif found is not None and found is not False:
            value[key] = found
    return value


def emit(value: Any) -> None:
    """Print a value as JSON; infinite numbers and NaN become null."""
    typer.echo(json.dumps(_finite(value), indent=2, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if hasattr(value, "item"):
        return _finite(value.item())
    return value
