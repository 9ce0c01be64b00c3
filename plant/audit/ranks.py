"""Audit of the rank tables of coefficients and of isobaric curves: C-16, C-17, C-33, C-34, C-36."""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.audit.printed import Row, listing, printed_rows, verdict
from plant.fitting.data import Points
from plant.fitting.tables import full_regression
from plant.fitting.thesis_points import thesis_points

Ranks = dict[float, dict[str, int]]
"""Temperature (°C) or pressure (kPa) to the printed rank of each predictor."""

HIGH = "c09_c15_per_length_coefs_150_600", 9
LOW = "c26_c32_per_length_coefs_0_125", 26
COEFFICIENTS = {
    "C-16": (*HIGH, "pressure_gradient_coef"),
    "C-17": (*HIGH, "intercept_coef"),
    "C-33": (*LOW, "pressure_gradient_coef"),
    "C-34": (*LOW, "intercept_coef"),
}
"""For each table: file and number of the table of the coefficients at 21 °C, and their column."""
REMARKS = {
    "C-16": "ranks by R-sq of one predictor each, of the gradients in C-9 to C-15",
    "C-17": "ranks by R-sq of one predictor each, of the intercepts in C-9 to C-15",
    "C-33": "ranks by R-sq, of the gradients in C-26 to C-32; the pair L, L^3 always fits best",
    "C-34": "ranks by R-sq of one predictor each, of the intercepts in C-26 to C-32",
}
ANOMALIES = {
    "C-16": ("A33",), "C-17": ("A33", "A51"), "C-33": ("A39", "A40"), "C-34": ("A36", "A37"),
}  # fmt: skip


def audit() -> list[Row]:
    """One row for each table."""
    return [*(_coefficients(table) for table in COEFFICIENTS), _isobaric()]


def printed_ranks(table: str) -> Ranks:
    """Ranks as printed, by temperature, or by pressure in Table C-36."""
    key = "length_mm_or_pressure_kpa" if table == "C-36" else "temperature_c"
    found: Ranks = {}
    for row in printed_rows("best_fit_ranks"):
        if row["table"] == table:
            found.setdefault(float(row[key]), {})[row["predictor"]] = int(row["rank"])
    return found


def r_squared(predictor: str, x: Array, y: Array) -> float:
    """R-sq in percent of y on a predictor such as "L^3", "cos(d)" or "L and L^3"."""
    columns = {name: _function(name, x) for name in predictor.split(" and ")}
    return full_regression("y", y, columns).r2_percent


def _function(name: str, x: Array) -> Array:
    functions = {"cos": np.cos, "sin": np.sin, "log": np.log}
    call, bracket, _ = name.partition("(")
    if bracket:
        return np.asarray(functions[call](x))
    return x ** int(name.partition("^")[2] or 1)


def compare(printed: dict[str, int], x: Array, y: Array) -> tuple[int, str]:
    """How many places from the best on are as printed; the recomputed order, best first."""
    found = {name: r_squared(name, x, y) for name in printed}
    order = sorted(found, key=lambda name: -found[name])
    places = 0
    while places < len(order) and printed[order[places]] == places + 1:
        places += 1
    return places, ", ".join(order)


def is_permutation(printed: dict[str, int]) -> bool:
    """Whether every rank is there once."""
    return sorted(printed.values()) == list(range(1, len(printed) + 1))


def _coefficients(table: str) -> Row:
    file, first, column = COEFFICIENTS[table]
    printed = printed_ranks(table)
    good, leading, bad, broken = 0, len(next(iter(printed.values()))), [], []
    for temperature, ranks in printed.items():
        source = f"C-{first + round((temperature - 21.0) / 3.0)}"
        rows = [r for r in printed_rows(file) if r["table"] == source]
        x = np.array([float(r["length_mm"]) for r in rows])
        y = np.array([float(r[column]) for r in rows])
        places, order = compare(ranks, x, y)
        good += places == len(ranks)
        leading = min(leading, places)
        if not is_permutation(ranks):
            broken.append(f"{temperature:g}")
        if places < len(ranks):
            bad.append(f"{temperature:g} °C: {order}")
    reason = REMARKS[table]
    if bad:
        reason += (
            f"; the first {leading} places are right in every row; recomputed, best first:"
            f" {listing(bad)}"
        )
    if broken:
        reason += f"; at {', '.join(broken)} °C the printed ranks are not 1 to {len(ranks)}"
    return Row(
        f"Ranks of Table {table}", f"{len(printed)} rows", f"{good} of {len(printed)} the same",
        verdict(not bad), reason, ANOMALIES[table],
    )  # fmt: skip


def isobaric_ranks(points: Points) -> tuple[int, int, list[str]]:
    """Rows of Table C-36 that follow, rows whose first place does, and the other rows."""
    good, first, bad = 0, 0, []
    for pressure, ranks in printed_ranks("C-36").items():
        use = (np.abs(points.pressure_pa / 1e3 - pressure) < 0.01) & (points.temperature_c == 21.0)
        places, order = compare(ranks, points.length_m[use] * 1e3, points.force_n[use])
        good += places == len(ranks)
        first += places > 0
        if places < len(ranks):
            bad.append(f"{pressure:g} kPa: {order}")
    return good, first, bad


def _isobaric() -> Row:
    total = len(printed_ranks("C-36"))
    good, first, bad = isobaric_ranks(thesis_points("c01", warm=True))
    from_c2, *_ = isobaric_ranks(thesis_points("c02", warm=True))
    return Row(
        "Ranks of Table C-36", f"{total} rows", f"{good} of {total} the same from C-1",
        verdict(not bad),
        f"ranks by R-sq of force against length at one pressure; the first place is right in "
        f"{first} of {total} rows; {from_c2} of {total} from C-2; recomputed from C-1, best first: "
        f"{listing(bad)}",
    )  # fmt: skip
