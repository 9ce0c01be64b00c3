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
    from plant.fitting.fit import Estimate, Fit
    from plant.fitting.misfit import Misfit
    from plant.fitting.scale import Scaling
    from plant.models.model import Model


WITHOUT_INTERVAL = {
    "fixed": "held at this value",
    "dead": "none: no point depends on it",
    "flat": "none: the data do not determine it",
}
"""What stands in place of an interval; see `plant.fitting.fit.Estimate`."""
DIGITS = 2
"""Significant digits of half an interval; value and limits have the same last decimal place."""
UNCERTAIN_DIGITS = 4
"""Significant digits of a value without an interval."""
LEAST_EXPONENT, MOST_EXPONENT = -4, 5
"""Powers of ten that are written out; beyond them numbers have an exponent."""
NEGLIGIBLE = 0.05
"""A systematic error below this share of the noise is not given as a number."""


def fit_text(found: Fit, points: Points) -> str:
    """The result of a fit as text: every value rounded to the digits of its interval."""
    lines = [f"{found.model.name} fitted to {points.source}, {len(points)} points", ""]
    rows = [("parameter", "value", "unit", "95 % interval")]
    rows += [_estimate_row(e) for e in found.estimates]
    wide, value, unit = (max(len(row[k]) for row in rows) for k in range(3))
    lines += [f"{n:{wide}}  {v:>{value}}  {u:{unit}}  {i}" for n, v, u, i in rows]
    lines += ["", f"Residuals (measured less model): rms {found.rmse_n:.3g} N."]
    if math.isfinite(found.noise_scale):
        lines.append(
            "The residuals are larger than the stated noise of the sensors: for the intervals, "
            f"that noise was multiplied by {found.noise_scale:.3g}."
            if found.noise_scale > 1.0
            else "The residuals are not larger than the stated noise of the sensors."
        )
        lines.append("The intervals contain noise, zero error and gain error of the sensors.")
    else:
        lines.append(
            "The data state no sensor errors. The intervals come from the residuals alone, so "
            "they are too narrow."
        )
    lines += found.identifiability.lines()
    return "\n".join(lines)


def _estimate_row(estimate: Estimate) -> tuple[str, str, str, str]:
    """Name, value, unit and interval of a parameter as text."""
    e = estimate
    unit = "" if e.unit == "1" else e.unit
    if e.state in WITHOUT_INTERVAL:
        return e.name, f"{e.value:.{UNCERTAIN_DIGITS}g}", unit, WITHOUT_INTERVAL[e.state]
    value, low, high = to_interval((e.value, e.low, e.high))
    mark = ", at the limit of its range" if e.state == "at bound" else ""
    return e.name, value, unit, f"{low} to {high}{mark}"


def to_interval(numbers: tuple[float, float, float]) -> tuple[str, str, str]:
    """Value and limits with the same last decimal place, that of two digits of half the interval.

    Args:
        numbers: value, lower and upper limit, in one unit. An interval without width or without
            an end gives `UNCERTAIN_DIGITS` digits.
    """
    half = (numbers[2] - numbers[1]) / 2.0
    if not (math.isfinite(half) and half > 0.0):
        value, low, high = (f"{x:.{UNCERTAIN_DIGITS}g}" for x in numbers)
        return value, low, high
    place = math.floor(math.log10(half)) - (DIGITS - 1)
    largest = max(abs(x) for x in numbers)
    exponent = math.floor(math.log10(largest))
    if LEAST_EXPONENT <= exponent <= MOST_EXPONENT:
        decimals = max(-place, 0)
        value, low, high = (f"{round(x, -place):z.{decimals}f}" for x in numbers)
        return value, low, high
    decimals = max(exponent - place, 0)
    value, low, high = (f"{x / 10.0**exponent:z.{decimals}f}e{exponent:+03d}" for x in numbers)
    return value, low, high


NOISE_FROM = {
    "repeats": "from the scatter of repeated points",
    "roughness": "from the roughness of the residuals along the pressure",
    "scatter": "from the residuals of the fit; this is an upper limit",
}
ERROR_FROM = {
    "held-out pressures": "from the errors at pressures that were left out of the fit",
    "residuals": "from the residuals",
}
ACROSS = ("turns", "radius", "diameter", "diameter_at_90")
"""Parameters that look like dimensions across the muscle."""


def misfit_text(sizes: Misfit, model: Model) -> str:
    """Noise, systematic error, and what the fit says about the gas volume."""
    apart = sizes.noise_from != "scatter"
    less = "; the noise is subtracted" if apart else "; this is an upper limit"
    below = sizes.model_error_n < NEGLIGIBLE * sizes.noise_n
    size = "not larger than the noise" if below and apart else f"{sizes.model_error_n:.2g} N"
    lines = [
        f"Noise of one force reading (1 standard deviation): {sizes.noise_n:.2g} N, "
        f"{NOISE_FROM[sizes.noise_from]}.",
        f"Systematic error of the model (rms): {size}, {ERROR_FROM[sizes.error_from]}{less}.",
    ]
    across = [p.name for p in model.parameters if p.name in ACROSS]
    if across:
        state = (
            "" if model.geometry else " For a gas volume, state --rest-length-mm and --diameter-mm."
        )
        lines.append(
            f"A fit to force does not give the gas volume: do not calculate it from "
            f"{' and '.join(across)}.{state}"
        )
    if model.pulls_only:
        lines.append("The model only pulls: where the law gives a negative force, the force is 0.")
    if model.geometry is not None:
        g = model.geometry
        lines.append(
            f"Gas volume: {g.volume_m3 * 1e6:.4g} ml at {g.rest_length_mm:g} mm, from the stated "
            f"diameter of {g.diameter_mm:g} mm."
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
    lines = [
        "Start values and bounds were scaled to this muscle: it is "
        f"{s.length:.3g} times as long and {force} times as strong as the muscle of the shipped "
        "values."
    ]
    if s.rest_length_mm is not None:
        why = "as stated" if s.stated else "the longest length of the data; see --rest-length-mm"
        lines.append(f"Rest length: {s.rest_length_mm:g} mm ({why}).")
    return lines


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
