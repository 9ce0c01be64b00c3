"""Results of a test: means of repeated points with expanded uncertainty, and their acceptance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import decimals_of, fixed, significant
from analysis.findings.findings import ResultColumns
from analysis.reduction.muscle.response import GAIN_UNITS
from analysis.statistics.conformity import NOT_MEASURED, decide, overall
from analysis.statistics.repeats import RepeatMean, repeat_mean

if TYPE_CHECKING:
    import pandas as pd

    from analysis.reduction.points import Reduction

Setting = float | str
At = tuple[tuple[str, Setting], ...]

QUANTITIES = {
    "force_n": ("force", "N"), "length_mm": ("length", "mm"),
    "velocity_m_s": ("air velocity", "m/s"),
    "on_ms": ("on-delay", "ms"), "off_ms": ("off-delay", "ms"),
    "on_v": ("switch-on voltage", "V"), "off_v": ("switch-off voltage", "V"),
    "rise_s": ("rise time", "s"), "overshoot_kpa": ("overshoot", "kPa"),
    "overshoot_deg": ("overshoot", "°"), "settle_s": ("settling time", "s"),
    "reach_s": ("time to the switch", "s"), "drift_kpa": ("drift while held", "kPa"),
    "angle_deg": ("angle", "°"), "torque_n_m": ("torque", "N m"), "gain": ("gain", ""),
    "phase_deg": ("phase", "°"),
}  # fmt: skip
"""Name and unit of a column of results."""
SETTINGS = {
    "set_temperature_c": ("temperature", "°C"), "set_length_mm": ("length", "mm"),
    "mass_kg": ("load", "kg"), "cycle_max_kpa": ("cycle to", "kPa"),
    "set_pressure_kpa": ("pressure", "kPa"), "direction": ("pressure is", ""),
    "valve": ("valve", ""), "scheme": ("scheme", ""), "switch": ("switch", ""),
    "from_kpa": ("from", "kPa"), "state": ("joint", ""), "set_angle_deg": ("angle", "°"),
    "common_kpa": ("common pressure", "kPa"), "difference_kpa": ("difference", "kPa"),
    "slot": ("setting", ""), "to_s": ("held until", "s"), "pair": ("response", ""),
    "frequency_hz": ("frequency", "Hz"),
}  # fmt: skip
"""Name and unit of a column of settings."""
WORDS = {"up": "rising", "down": "falling", "single": "held"}
MOST = 16
"""Results on page one of a report; all are in its details."""


@dataclass(frozen=True)
class Result:
    """The mean of repeated points.

    Attributes:
        quantity: column of the table of points.
        at: (setting, value) pairs that the repeats have in common.
        mean: mean, standard deviation, number and expanded uncertainty.
        mountings: number of mountings.
    """

    quantity: str
    at: At
    mean: RepeatMean
    mountings: int

    @property
    def name(self) -> str:
        """The quantity in words."""
        return QUANTITIES.get(self.quantity, (self.quantity, ""))[0]

    @property
    def unit(self) -> str:
        """Its unit; that of a gain by its pair of signals."""
        if self.quantity == "gain":
            return GAIN_UNITS.get(str(dict(self.at).get("pair")), "")
        return QUANTITIES.get(self.quantity, ("", ""))[1]

    @property
    def where(self) -> str:
        """The settings in words: "60 mm, 400 kPa, rising"."""
        return ", ".join(setting_text(name, value) for name, value in self.at)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for --json."""
        mean = self.mean
        return {
            "quantity": self.quantity, "unit": self.unit, "at": dict(self.at), "mean": mean.mean,
            "sd": mean.sd, "n": mean.n, "mountings": self.mountings, "u": mean.u,
            "dof": mean.dof, "k": mean.k, "expanded": mean.expanded,
        }  # fmt: skip


@dataclass(frozen=True)
class Judged:
    """A result held against its limits; ``result`` is None where it was not measured."""

    quantity: str
    at: At
    result: Result | None
    lower: float | None
    upper: float | None
    guard: float
    verdict: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values for --json."""
        mean = self.result.mean if self.result else None
        return {
            "quantity": self.quantity, "at": dict(self.at), "lower": self.lower,
            "upper": self.upper, "value": mean.mean if mean else None,
            "expanded": mean.expanded if mean else None, "verdict": self.verdict,
        }  # fmt: skip


def setting_text(name: str, value: Setting) -> str:
    """A setting in words: "60 mm"; for the direction "rising"."""
    words, unit = SETTINGS.get(name, (name, ""))
    if isinstance(value, str):
        return WORDS.get(value, f"{words} {value}" if name in ("switch", "scheme") else value)
    prefix = (
        f"{words} " if name in ("cycle_max_kpa", "from_kpa", "common_kpa", "difference_kpa") else ""
    )
    return f"{prefix}{significant(value)} {unit}".strip()


def results_of(reduction: Reduction, columns: ResultColumns) -> list[Result]:
    """The results of a run: one for each quantity and setting, in order of both."""
    found = [
        Result(
            quantity,
            at,
            _mean(part, quantity, quantity in reduction.rounding_only),
            part["mounting"].nunique(),
        )
        for (quantity, at), part in point_groups(reduction, columns).items()
    ]
    return _in_order(found, columns)


def point_groups(
    reduction: Reduction, columns: ResultColumns
) -> dict[tuple[str, At], pd.DataFrame]:
    """The points of a run by quantity and setting: the rows that are repeats of each other."""
    table = reduction.table
    if columns.settled and "settled" in table:
        table = table[table["settled"].astype(bool)]
    settings = [name for name in columns.settings if name in table and _stated(table[name])]
    found: dict[tuple[str, At], list[int]] = {}
    for index, row in enumerate(table.to_dict("records")):
        at: At = tuple(
            (name, value) for name in settings if (value := _setting(row[name])) is not None
        )
        for quantity in columns.quantities:
            if quantity in row and _is_result(row, quantity, columns) and _finite(row[quantity]):
                found.setdefault((quantity, at), []).append(index)
    return {key: table.iloc[rows] for key, rows in found.items()}


def _in_order(results: list[Result], columns: ResultColumns) -> list[Result]:
    """By quantity, then by the settings: numbers ascending, words as they came."""
    words: dict[tuple[str, Setting], int] = {}
    for result in results:
        for pair in result.at:
            words.setdefault(pair, len(words))

    def key(result: Result) -> tuple[Any, ...]:
        at = dict(result.at)
        places = [
            (
                name not in at,
                at[name]
                if isinstance(at.get(name), float)
                else words.get((name, at.get(name, "")), 0),
            )
            for name in columns.settings
        ]
        return (columns.quantities.index(result.quantity), *places)

    return sorted(results, key=key)


def _mean(part: pd.DataFrame, quantity: str, rounding_only: bool) -> RepeatMean:
    values = part[quantity].to_numpy(dtype=np.float64)
    unknown = np.full(len(values), math.nan)
    noise, common, whole = (
        part[name].to_numpy(dtype=np.float64) if name in part else unknown
        for name in (f"u_{quantity}_noise", f"u_{quantity}_cal", f"u_{quantity}")
    )
    if not np.isfinite(noise).any() and not np.isfinite(common).any():
        common = whole  # not split into parts: it may be common to all
    if rounding_only and len(values) == 1:
        noise, common = unknown, unknown  # rounding is no estimate of the uncertainty of a test
    return repeat_mean(values, noise, common, list(part["mounting"]))


def _stated(column: pd.Series) -> bool:
    return bool((column.notna() & (column.astype(str) != "")).any())


def _setting(value: Any) -> Setting | None:
    if isinstance(value, str):
        return value or None
    return float(value) if _finite(value) else None


def _finite(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and math.isfinite(float(value))


def _is_result(row: Mapping[Any, Any], quantity: str, columns: ResultColumns) -> bool:
    if quantity not in columns.only:
        return True
    column, word = columns.only[quantity]
    value = row.get(column)
    return value == word if word else _setting(value) is None


def chosen(results: Sequence[Result], most: int = MOST) -> list[Result]:
    """Not more than ``most`` results that show the range of the settings.

    Falling pressures go first where there are rising ones, then the smaller cycles, then
    levels of the setting that has most of them, evenly, the highest last.
    """
    left = list(results)
    if len(left) > most and any(("direction", "up") in r.at for r in left):
        left = [r for r in left if ("direction", "down") not in r.at]
    levels = _levels(left)
    if len(left) > most and len(levels.get("cycle_max_kpa", ())) > 1:
        top = levels["cycle_max_kpa"][-1]
        left = [r for r in left if dict(r.at).get("cycle_max_kpa", top) == top]
        levels = _levels(left)
    counts = {name: len(values) for name, values in levels.items()}
    kept = left
    while len(kept) > most:
        name = max(counts, key=lambda one: counts[one], default="")
        if not name or counts[name] < 2:
            return kept[:most]
        counts[name] -= 1
        allowed = {each: _even(levels[each], count) for each, count in counts.items()}
        kept = [r for r in left if all(v in allowed.get(n, (v,)) for n, v in r.at)]
    return kept


def _levels(results: Sequence[Result]) -> dict[str, list[float]]:
    found: dict[str, set[float]] = {}
    for result in results:
        for name, value in result.at:
            if isinstance(value, float):
                found.setdefault(name, set()).add(value)
    return {name: sorted(values) for name, values in found.items()}


def _even(values: list[float], count: int) -> list[float]:
    if count == 1:
        return values[-1:]
    at = np.linspace(0, len(values) - 1, count).round().astype(int)
    return [values[i] for i in at]


def judge(results: Sequence[Result], acceptance: Mapping[str, Any] | None) -> list[Judged]:
    """Every result for which the record states limits.

    Args:
        results: of the run.
        acceptance: ``parameters.acceptance`` of run.json; None: no limits.
    """
    if not acceptance:
        return []
    guard = float(acceptance.get("guard", 1.0))
    out = []
    for limit in acceptance.get("limits") or ():
        quantity, wanted = str(limit["quantity"]), dict(limit.get("at") or {})
        lower, upper = limit.get("lower"), limit.get("upper")
        fits = [r for r in results if r.quantity == quantity and matches(dict(r.at), wanted)]
        out += [
            Judged(
                quantity, r.at, r, lower, upper, guard,
                decide(r.mean.mean, r.mean.expanded, lower, upper, guard),
            )
            for r in fits
        ]  # fmt: skip
        if not fits:
            out.append(
                Judged(quantity, tuple(wanted.items()), None, lower, upper, guard, NOT_MEASURED)
            )
    return out


def matches(at: Mapping[str, Setting], wanted: Mapping[str, Any]) -> bool:
    """Whether settings have all wanted values."""

    def same(a: Setting | None, b: Any) -> bool:
        if isinstance(a, float) and isinstance(b, (int, float)):
            return math.isclose(a, float(b), rel_tol=1e-9, abs_tol=1e-9)
        return bool(a == b)

    return all(same(at.get(name), value) for name, value in wanted.items())


def acceptance_json(judged: Sequence[Judged]) -> dict[str, Any] | None:
    """Verdict, rule and every judged result, for --json; None without limits."""
    if not judged:
        return None
    return {
        "verdict": overall([one.verdict for one in judged]),
        "guard": judged[0].guard,
        "rule": rule_text(judged[0].guard),
        "judged": [one.as_dict() for one in judged],
    }


def rule_text(guard: float) -> str:
    """The decision rule in words."""
    if not guard:
        return "simple acceptance (ILAC-G8:09/2019, 4.2.1): the uncertainty is not considered"
    band = (
        "the expanded uncertainty U"
        if guard == 1.0
        else f"{guard:g} times the expanded uncertainty U"
    )
    return (
        f"guard band w = {band} (ILAC-G8:09/2019, JCGM 106:2012): pass within the limits narrowed"
        " by w, fail beyond them by more than w, undecided between"
    )


def rounded(mean: RepeatMean, decimals: int | None = None) -> dict[str, str]:
    """Mean, standard deviation and expanded uncertainty as text.

    Mean and expanded uncertainty have two significant digits of the latter (GUM, 7.2.6). Without
    one the mean has those of the standard deviation, and at most four significant digits; that of a
    single test has ``decimals``, those of its column, if they are given.
    """
    known = _positive(mean.expanded)
    four = decimals_of(abs(mean.mean), 4) if mean.mean else 3
    own = decimals_of(mean.sd) if _positive(mean.sd) else four
    digits = decimals_of(mean.expanded) if known else min(own, four)
    if known or mean.n > 1:
        text = fixed(mean.mean, digits)
    else:
        text = significant(mean.mean) if decimals is None else fixed(mean.mean, decimals)
    return {
        "mean": text,
        "sd": fixed(mean.sd, min(own, digits + 1) if known else own)
        if math.isfinite(mean.sd)
        else "–",
        "n": str(mean.n),
        "expanded": fixed(mean.expanded, digits) if known else "–",
        "k": f"{mean.k:.2f}" if known else "–",
    }


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0.0
