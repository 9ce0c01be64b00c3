"""Audit of the coefficient tables: C-9 to C-15, C-26 to C-32, C-37, and Equations 4-34 to 4-45."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from plant.arrays import Array
from plant.audit.printed import Row, listing, printed_rows, same, unit_in_last_place, verdict
from plant.fitting.data import Points
from plant.fitting.table43 import coefficients
from plant.fitting.tables import full_regression
from plant.fitting.thesis_points import thesis_points

HIGH, LOW = (150.0, 600.0), (0.0, 125.0)
Pairs = dict[float, tuple[float, float]]


def lines_by_length(points: Points, region: tuple[float, float], temperature: float) -> Pairs:
    """Gradient (N/kPa) and intercept (N) of force against pressure at each length (4-32)."""
    return _lines(points.length_m * 1e3, points.pressure_pa / 1e3, points, region, temperature)


def lines_by_pressure(points: Points) -> Pairs:
    """Gradient (N/mm) and intercept (N) of force against length at each pressure (4-42)."""
    return _lines(points.pressure_pa / 1e3, points.length_m * 1e3, points, HIGH, 21.0)


def _lines(
    held: Array, moved: Array, points: Points, region: tuple[float, float], temperature: float
) -> Pairs:
    p = points.pressure_pa / 1e3
    use = (p >= region[0]) & (p <= region[1]) & (points.temperature_c == temperature)
    found: Pairs = {}
    for at in np.unique(held[use]):
        here = use & (held == at)
        fit = full_regression("force", points.force_n[here], {"x": moved[here]})
        found[round(float(at), 3)] = (fit.predictors[1].coef, fit.predictors[0].coef)
    return found


def audit() -> list[Row]:
    """Nineteen tables and ten equations."""
    c1, c2 = thesis_points("c01", warm=True), thesis_points("c02", warm=True)
    high, low = "c09_c15_per_length_coefs_150_600", "c26_c32_per_length_coefs_0_125"
    return [
        _one_temperature(c1, c2, "C-9", high, HIGH),
        _warm(c1, c2, "C-10 to C-15", high, HIGH, "C-9"),
        _one_temperature(c1, c2, "C-26", low, LOW),
        _warm(c1, c2, "C-27 to C-32", low, LOW, "C-26"),
        *_high_equations(),
        *_low_equations(c1),
        *_isobaric(c1, c2),
    ]


def _pairs(table: str, file: str) -> dict[float, tuple[str, str]]:
    return {
        float(r["length_mm"]): (r["pressure_gradient_coef"], r["intercept_coef"])
        for r in printed_rows(file)
        if r["table"] == table
    }


def _one_temperature(
    c1: Points, c2: Points, table: str, file: str, region: tuple[float, float]
) -> Row:
    printed = _pairs(table, file)
    found = lines_by_length(c1, region, 21.0)
    slips, worst = [], [0.0, 0.0]
    for length, pair in printed.items():
        for k, (text, value) in enumerate(zip(pair, found[length], strict=True)):
            if same(text, value):
                worst[k] = max(worst[k], abs(float(text) - value))
            else:
                digits = int(-np.log10(unit_in_last_place(text)) + 0.5)
                word = ("gradient", "intercept")[k]
                slips.append(f"{word} at {length:g} mm: {text} for {value:.{digits}f}")
    from_c2 = lines_by_length(c2, region, 21.0)
    off = [max(abs(float(printed[x][k]) - from_c2[x][k]) for x in printed) for k in (0, 1)]
    reason = f"from C-1 to rounding (at most {worst[0]:.2g} N/kPa and {worst[1]:.2g} N off)"
    if slips:
        reason = f"from C-1 except misprints: {listing(slips)}"
    reason += f"; from C-2 off by up to {off[0]:.2g} N/kPa and {off[1]:.2g} N"
    total = 2 * len(printed)
    return Row(
        f"Table {table} (21 °C)", f"{len(printed)} pairs",
        f"{total - len(slips)} of {total} numbers the same", verdict(not slips, len(slips) <= 5),
        reason, ("A01", "A31") if table == "C-9" else ("A36", "A37", "A38"),
    )  # fmt: skip


def _warm(
    c1: Points, c2: Points, title: str, file: str, region: tuple[float, float], base: str
) -> Row:
    first = int(base[2:]) + 1
    tables = [f"C-{first + k}" for k in range(6)]
    temperatures = [24.0 + 3.0 * k for k in range(6)]
    off = {"C-1": [0.0, 0.0], "C-2": [0.0, 0.0]}
    matched = count = 0
    factors = []
    base_pairs = _pairs(base, file)
    for table, temperature in zip(tables, temperatures, strict=True):
        printed = _pairs(table, file)
        for name, points in (("C-1", c1), ("C-2", c2)):
            found = lines_by_length(points, region, temperature)
            for x, pair in printed.items():
                for k in (0, 1):
                    off[name][k] = max(off[name][k], abs(float(pair[k]) - found[x][k]))
                    matched += name == "C-1" and same(pair[k], found[x][k])
                    count += name == "C-1"
        ratios = [[float(printed[x][k]) / float(base_pairs[x][k]) for x in printed] for k in (0, 1)]
        factors.append([float(np.median(r)) for r in ratios])
    copied = _copied_rows(file, tables)
    gradients, intercepts = (", ".join(f"{f[k]:.3f}" for f in factors) for k in (0, 1))
    reason = (
        f"not from C-1 or C-2 but from another data set: relative to {base}, gradients are larger "
        f"by {gradients} and intercepts by {intercepts} (medians over the lengths), but the warm "
        "columns of C-1 change each cell by a different factor"
    )
    if copied:
        reason += f"; rows repeated from another table: {listing(copied)}"
    return Row(
        f"Tables {title}", "84 pairs",
        f"{matched} of {count} numbers the same; off by up to {off['C-1'][0]:.2g} N/kPa and "
        f"{off['C-1'][1]:.2g} N from C-1, {off['C-2'][0]:.2g} and {off['C-2'][1]:.2g} from C-2",
        verdict(matched == count), reason,
        ("A02", "A32", "A33", "A34", "A35") if base == "C-9" else ("A39", "A40", "A55"),
    )  # fmt: skip


def _copied_rows(file: str, tables: list[str]) -> list[str]:
    """Rows that equal a row of the following table at another length."""
    found = []
    for table, following in pairwise(tables):
        here, there = _pairs(table, file), _pairs(following, file)
        for x, pair in here.items():
            found += [
                f"{table} at {x:g} mm = {following} at {y:g} mm"
                for y, other in there.items()
                if pair == other
            ]
    return found


def _line_of(pairs: dict[float, tuple[str, str]], k: int) -> tuple[float, float]:
    """Slope and constant of the printed gradients (k = 0) or intercepts (k = 1) over length."""
    x = np.array(list(pairs))
    y = np.array([float(pair[k]) for pair in pairs.values()])
    fit = full_regression("K", y, {"L": x})
    return fit.predictors[1].coef, fit.predictors[0].coef


def _high_equations() -> list[Row]:
    pairs = _pairs("C-9", "c09_c15_per_length_coefs_150_600")
    slope, constant = _line_of(pairs, 0)
    slope_c, constant_c = _line_of(pairs, 1)
    table_c = printed_rows("t4_1_coefs_150_600")[0]["c_intercept"]
    c1 = thesis_points("c01")
    use = c1.pressure_pa >= 150e3
    p, x, force = c1.pressure_pa[use] / 1e3, c1.length_m[use] * 1e3, c1.force_n[use]

    def bias(by_length: float, last: float) -> float:
        return float(np.mean(force - (0.0087 * p * x - 0.426 * p + by_length * x + last)))

    first, second, mended = bias(-0.043, -0.159), bias(-0.159, -0.043), bias(-0.159, -0.43)
    return [
        Row(
            "Equation 4-34", "0.0087 L - 0.426", f"{slope:.5f} L {constant:+.4f}",
            verdict(same("0.0087", slope) and same("-0.426", constant)),
            "regression of Table C-9's printed gradients on length", ("A31",),
        ),
        Row(
            "Equation 4-35", "-0.043 - 0.159 L", f"{constant_c:.3f} {slope_c:+.4f} L",
            verdict(same("-0.043", constant_c), same("-0.159", slope_c)
                    and same(table_c, constant_c)),
            f"slope as printed; the constant is {table_c} (as in Table 4-1), with a zero too many",
            ("A44", "A56"),
        ),
        Row(
            "Equation 4-36", "printed in two orders",
            f"{slope:.5f} P L {constant:+.3f} P {slope_c:+.3f} L {constant_c:+.2f}",
            verdict(False, abs(mended) < 0.5),
            f"mean error (real - model) {first:.1f} N as in section 4.9.2, {second:.2f} N as in "
            f"4.10.3, {mended:.2f} N with -0.43: the second order with -0.43 is correct",
            ("A44", "A56", "A57"),
        ),
    ]  # fmt: skip


def _low_equations(c1: Points) -> list[Row]:
    printed = _pairs("C-26", "c26_c32_per_length_coefs_0_125")
    exact = lines_by_length(c1, LOW, 21.0)
    used = {x: (g.replace("0.00657", "0.00457"), c) for x, (g, c) in printed.items()}
    slope, constant = _line_of(used, 1)
    mended = {
        x: (g, c if same(c, exact[x][1]) else f"{exact[x][1]:.4f}") for x, (g, c) in used.items()
    }
    slope_m, constant_m = _line_of(mended, 1)
    x = np.array(list(used))
    y = np.array([float(g) for g, _ in used.values()])
    cubic = full_regression("K", y, {"L": x, "L^3": x**3})
    k, by_l, by_cube = (c.coef for c in cubic.predictors)
    points = c1.take((c1.temperature_c == 21.0) & (c1.pressure_pa <= 125e3))
    p, length, force = points.pressure_pa / 1e3, points.length_m * 1e3, points.force_n
    tail = 0.40029 * length - 20.429

    def rmse(a: float, b: float, c: float) -> float:
        model = (a + b * length + c * length**3) * p + tail
        return float(np.sqrt(np.mean((force - model) ** 2)))

    as_printed, full = rmse(0.62, -0.0165, 2e-6), rmse(0.6250, -0.016488, 1.64e-6)
    gradient = same("0.625", k) and same("-0.0165", by_l) and same("0.000002", by_cube)
    return [
        Row(
            "Equation 4-39", "-20.4 + 0.400 L",
            f"{constant_m:.2f} {slope_m:+.3f} L from C-1; {constant:.1f} {slope:+.3f} L from C-26",
            verdict(same("-20.4", constant_m), same("-20.4", constant) and same("0.400", slope)),
            "only with the two misprints of C-26 (0.261 for 0.0261, 5.82 for 6.82)",
            ("A36", "A37"),
        ),
        Row(
            "Equation 4-40", "0.625 - 0.0165 L + 0.000002 L^3",
            f"{k:.4f} {by_l:+.5f} L {by_cube:+.4g} L^3", verdict(gradient),
            "from C-26 with 0.00457 at 65 mm; with one digit for the cube it is unusable: rmse on "
            f"C-1 {rmse(0.625, -0.0165, 2e-6):.1f} N for {full:.2f} N with Table 4-2's digits",
            ("A38", "A58"),
        ),
        Row(
            "Equation 4-41", "(0.62 - 0.0165 L + 0.000002 L^3) P + 0.400 L - 20.4",
            f"{k:.3f} where 0.62 is printed", verdict(same("0.62", k) and as_printed < 1.0),
            f"a missing digit (0.62 for 0.625) and a rounded cube: rmse {as_printed:.1f} N",
            ("A58",),
        ),
    ]  # fmt: skip


def _isobaric(c1: Points, c2: Points) -> list[Row]:
    rows = printed_rows("c37_isobaric_coefs_21c")
    found, other = lines_by_pressure(c1), lines_by_pressure(c2)
    slips, off, off_c2 = [], [0.0, 0.0], 0.0
    for row in rows:
        at = float(row["pressure_kpa"])
        texts = (row["length_gradient_coef"], row["intercept_coef"])
        for k, text in enumerate(texts):
            gap = abs(float(text) - found[at][k])
            if gap > 0.01:
                slips.append(f"{text} at {at:g} kPa for {found[at][k]:.5f}")
            else:
                off[k] = max(off[k], gap)
        off_c2 = max(off_c2, abs(float(texts[1]) - other[at][1]))
    p = np.array([float(r["pressure_kpa"]) for r in rows])
    gradient = np.array([float(r["length_gradient_coef"]) for r in rows])
    intercept = np.array([float(r["intercept_coef"]) for r in rows])
    exact = np.array([found[x][0] for x in p])
    with_slip = full_regression("K", gradient, {"P": p}).predictors
    without = full_regression("K", exact, {"P": p}).predictors
    c4 = full_regression("c", intercept, {"P": p}).predictors
    e = coefficients("4-44", "K_L2")
    c38 = printed_rows("c38_isobaric_equation_21c")[0]
    good = same("0.00878", with_slip[1].coef) and same("-0.2391", with_slip[0].coef)
    return [
        Row(
            "Table C-37", f"{2 * len(rows)} values",
            f"{2 * len(rows) - len(slips)} within {off[0]:.1g} N/mm and {off[1]:.1g} N",
            verdict(not slips, len(slips) == 1),
            f"named isobaric, but a regression of the isometric C-1 (C-2 gives intercepts up to "
            f"{off_c2:.1f} N off), with a missing digit: {listing(slips)}", ("A46", "A47"),
        ),
        Row(
            "Equation 4-44, Table C-38",
            f"{e['P']:.5f} P {e['1']:+.3f}; {c38['length_coef']} in C-38",
            f"{with_slip[1].coef:.5f}, {with_slip[0].coef:.4f} with the misprint of C-37; "
            f"{without[1].coef:.5f}, {without[0].coef:.4f} without",
            verdict(same("-0.231", with_slip[0].coef), good),
            "includes the misprint of C-37, and -0.231 is a second misprint for -0.2391",
            ("A47", "A49"),
        ),
        Row(
            "Equation 4-45", "-0.38 - 0.425 P", f"{c4[0].coef:.3f} {c4[1].coef:+.5f} P",
            verdict(same("-0.38", c4[0].coef) and same("-0.425", c4[1].coef)),
            "regression of the printed intercepts of Table C-37 on pressure, so from C-1", ("A46",),
        ),
    ]  # fmt: skip
