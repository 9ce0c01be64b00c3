"""Audit of the temperature models: Tables 4-1 and 4-2, Equations 4-47 to 4-58."""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.audit.printed import Row, listing, printed_rows, same, truncated, verdict
from plant.fitting.table43 import black_box_t, coefficients
from plant.fitting.tables import FullRegression, full_regression
from plant.fitting.thesis_points import thesis_points

T_HIGH, T_LOW = "t4_1_coefs_150_600", "t4_2_coefs_0_125"
SECOND_STAGE = {
    "C-2": (T_HIGH, "K3_pressure"),
    "C-3": (T_LOW, "K1_length3_pressure"),
    "C-4": (T_LOW, "K2_length_pressure"),
    "C-5": (T_LOW, "K3_pressure"),
    "C-6": (T_LOW, "K4_length"),
    "C-7": (T_LOW, "c_intercept"),
}
"""Full regressions of coefficients on temperature: table and column of each."""


def second_stage(name: str) -> FullRegression:
    """Full-regression C-2 to C-7, recomputed from Table 4-1 or 4-2 as printed."""
    table, column = SECOND_STAGE[name]
    t, y = _columns(table, column)
    return full_regression(column, y, {"temp": t})


def audit() -> list[Row]:
    """Audit of Tables 4-1 and 4-2 and of the equations from them."""
    return [_table_4_1(), *_high_equations(), _eq_4_51(), _table_4_2(), _regressions(), _eq_4_58()]


def _columns(table: str, column: str) -> tuple[Array, Array]:
    rows = printed_rows(table)
    t = np.array([float(r["temperature_c"]) for r in rows])
    return t, np.array([float(r[column]) for r in rows])


def _per_length(
    file: str, table: str, *, mend: dict[str, str] | None = None
) -> tuple[Array, Array, Array]:
    rows = [r for r in printed_rows(file) if r["table"] == table]
    x, g, c = (
        np.array([float((mend or {}).get(r[k], r[k])) for r in rows])
        for k in ("length_mm", "pressure_gradient_coef", "intercept_coef")
    )
    return x, g, c


def first_stage_high() -> dict[str, Array]:
    """K1 and K3, K2 and c of Table 4-1 at seven temperatures, unrounded, from C-9 to C-15."""
    out: dict[str, list[float]] = {n: [] for n in printed_rows(T_HIGH)[0] if n[0] in "Kc"}
    for k in range(7):
        x, g, c = _per_length("c09_c15_per_length_coefs_150_600", f"C-{9 + k}")
        gradient = full_regression("g", g, {"L": x}).predictors
        intercept = full_regression("c", c, {"L": x}).predictors
        values = (gradient[1], intercept[1], gradient[0], intercept[0])
        for name, found in zip(out, values, strict=True):
            out[name].append(found.coef)
    return {name: np.array(values) for name, values in out.items()}


def first_stage_low() -> dict[str, Array]:
    """The five columns of Table 4-2, unrounded, from C-26 to C-32."""
    out: dict[str, list[float]] = {n: [] for n in printed_rows(T_LOW)[0] if n[0] in "Kc"}
    for k in range(7):
        mend = {"0.00657": "0.00457"} if k == 0 else None
        x, g, c = _per_length("c26_c32_per_length_coefs_0_125", f"C-{26 + k}", mend=mend)
        gradient = full_regression("g", g, {"L": x, "L^3": x**3}).predictors
        intercept = full_regression("c", c, {"L": x}).predictors
        values = (gradient[2], gradient[1], gradient[0], intercept[1], intercept[0])
        for name, found in zip(out, values, strict=True):
            out[name].append(found.coef)
    return {name: np.array(values) for name, values in out.items()}


def _matches(table: str, exact: dict[str, Array]) -> tuple[int, int, list[str], list[str]]:
    good, total, cut, bad = 0, 0, [], []
    for k, row in enumerate(printed_rows(table)):
        for name, values in exact.items():
            total += 1
            where = f"{name.split('_')[0]}({row['temperature_c']})"
            if same(row[name], values[k]):
                good += 1
            elif truncated(row[name], values[k]):
                cut.append(where)
            else:
                bad.append(f"{where} {row[name]} for {values[k]:.5g}")
    return good, total, cut, bad


def _table_4_1() -> Row:
    good, total, cut, bad = _matches(T_HIGH, first_stage_high())
    return Row(
        "Table 4-1", f"{total} values", f"{good} of {total} the same, {len(cut)} truncated",
        verdict(not bad),
        f"from Tables C-9 to C-15; truncated instead of rounded: {listing(cut) or 'none'}"
        + (f"; other: {listing(bad)}" if bad else "")
        + "; its headings number K1 to K3 differently from Equation 4-46", ("A42", "A43"),
    )  # fmt: skip


def _high_equations() -> list[Row]:
    exact = first_stage_high()
    t, k1 = _columns(T_HIGH, "K1_length_pressure")
    unrounded = full_regression("K1", exact["K1_length_pressure"], {"T": t}).predictors
    rounded = full_regression("K1", k1, {"T": t}).predictors
    e47, e49 = coefficients("4-47", "K1"), coefficients("4-49", "K3")
    k2 = float(np.mean(_columns(T_HIGH, "K2_length")[1]))
    c = float(np.mean(_columns(T_HIGH, "c_intercept")[1]))
    with_043 = c + (0.43 - 0.043) / 7
    k3 = second_stage("C-2").predictors
    return [
        Row(
            "Equation 4-47", f"{e47['T']:g} T + {e47['1']:g}",
            f"{unrounded[1].coef:.7f} T + {unrounded[0].coef:.5f} from unrounded K1; "
            f"{rounded[1].coef:.6f}, {rounded[0].coef:.4f} from Table 4-1",
            verdict(same("0.00012", unrounded[1].coef) and same("0.0062", unrounded[0].coef)),
            "from K1 before truncation for Table 4-1", ("A43",),
        ),
        Row(
            "Equations 4-48, 4-50", "-0.18429, -0.16286", f"{k2:.5f}, {c:.5f}",
            verdict(same("-0.18429", k2) and same("-0.16286", c)),
            f"means of the columns of Table 4-1; 4-50 needs -0.43 at 21 °C (-0.043 would give "
            f"{with_043:.5f})", ("A44",),
        ),
        Row(
            "Equation 4-49", f"{e49['T']:g} T {e49['1']:+g}",
            f"{k3[1].coef:.7f} T {k3[0].coef:+.5f}",
            verdict(same("-0.0058", k3[1].coef) and same("-0.3", k3[0].coef),
                    truncated("-0.0058", k3[1].coef) and same("-0.3", k3[0].coef)),
            "truncated or mistyped for -0.0059 and -0.304, an effect of "
            f"{_eq_4_49_effect():.1f} N at 300 kPa and 21 °C", ("A59",),
        ),
    ]  # fmt: skip


def _eq_4_49_effect() -> float:
    return 300.0 * abs((-0.0058 * 21 - 0.3) - (-0.0059 * 21 - 0.304))


def _eq_4_51() -> Row:
    points = thesis_points("c02", warm=True)
    use = points.pressure_pa >= 150e3
    p, x = points.pressure_pa[use] / 1e3, points.length_m[use] * 1e3
    t, force = points.temperature_c[use], points.force_n[use]
    e = coefficients("4-51", "Force")
    parts = {
        "P*L*T": coefficients("4-47", "K1")["T"], "P*L": coefficients("4-47", "K1")["1"],
        "L": coefficients("4-48", "K2")["1"], "P*T": coefficients("4-49", "K3")["T"],
        "P": coefficients("4-49", "K3")["1"], "1": coefficients("4-50", "c")["1"],
    }  # fmt: skip

    def rmse(pt: float, p1: float) -> float:
        model = e["P*L*T"] * p * x * t + e["P*L"] * p * x + e["L"] * x + (pt * t + p1) * p + e["1"]
        return float(np.sqrt(np.mean((force - model) ** 2)))

    return Row(
        "Equation 4-51", "combination of 4-47 to 4-50",
        f"rmse on C-2 {rmse(e['P*T'], e['P']):.2f} N as printed, {rmse(-0.0059, -0.304):.2f} N "
        "with -0.0059 and -0.304", verdict(e == parts), "each coefficient equals that of its part",
        ("A59",),
    )  # fmt: skip


def _table_4_2() -> Row:
    good, total, cut, bad = _matches(T_LOW, first_stage_low())
    equal = printed_rows(T_LOW) == printed_rows("c35_coefs_0_125")
    return Row(
        "Table 4-2 = Table C-35", f"{total} values", f"{good + len(cut)} of {total} the same",
        verdict(equal and not bad),
        f"both tables are {'identical' if equal else 'different'}; from C-26 to C-32, the 21 °C "
        "row with the misprints 0.261 and 5.82 of C-26 but with 0.00457"
        + (f"; other: {listing(bad)}" if bad else "")
        + (f"; truncated: {listing(cut)}" if cut else ""),
        ("A36", "A37", "A38", "A45"),
    )  # fmt: skip


def compare_regression(name: str, found: FullRegression) -> tuple[int, list[str]]:
    """Number of reproduced numbers of a printed full regression, and a list of the others."""
    good, bad = 0, []
    lines = [r for r in printed_rows("full_regressions") if r["equation"] == name]
    for line, x in zip(lines, found.predictors, strict=True):
        values = {"coef": x.coef, "stdev": x.stdev, "t": x.t, "p": x.p, "s": found.s,
                  "r2": found.r2_percent, "r2adj": found.r2adj_percent}  # fmt: skip
        for key, value in values.items():
            if line[key]:
                ok = same(line[key], value)
                good += ok
                bad += [] if ok else [f"{key} of {x.name} {line[key]} for {value:.6g}"]
    rows = [r for r in printed_rows("full_regressions_anova") if r["equation"] == name]
    for line, source in zip(rows, found.anova, strict=True):
        for key in ("df", "ss", "ms", "f", "p"):
            if line[key]:
                ok = same(line[key], float(getattr(source, key)))
                good += ok
                bad += [] if ok else [
                    f"{key} of {source.source} {line[key]} for {getattr(source, key):.6g}"
                ]  # fmt: skip
    return good, bad


def _regressions() -> Row:
    good, bad = 0, []
    for name in SECOND_STAGE:
        some, wrong = compare_regression(name, second_stage(name))
        good += some
        bad += [f"{name} {x}" for x in wrong]
    e = coefficients("4-55", "K3")
    k3 = second_stage("C-5").predictors
    swapped = same("0.395", k3[0].coef) and same("0.01", k3[1].coef) and e["T"] == 0.395
    return Row(
        "Equations 4-53 to 4-57, Full-regressions C-2 to C-7", f"{good + len(bad)} numbers",
        f"{good} of {good + len(bad)} the same", verdict(not bad and not swapped, len(bad) <= 1),
        "regressions of Tables 4-1 and 4-2 on temperature; Equation 4-55 has its two coefficients "
        "swapped, 4-56 is labelled K2 for K4, 4-54 prints -0.01041 for -0.010395"
        + (f"; truncated instead of rounded: {listing(bad)}" if bad else ""), ("A60", "A61", "A62"),
    )  # fmt: skip


def _eq_4_58() -> Row:
    points = thesis_points("c01", warm=True)
    use = points.pressure_pa <= 125e3
    p, x = points.pressure_pa[use] / 1e3, points.length_m[use] * 1e3
    t, force = points.temperature_c[use], points.force_n[use]
    e = coefficients("4-58", "Force")
    columns = {
        "P*L^3": p * x**3, "P*L^3*T": p * x**3 * t, "P*L": p * x, "P*L*T": p * x * t, "P": p,
        "P*T": p * t, "L": x, "L*T": x * t, "T": t, "1": np.ones_like(p),
    }  # fmt: skip
    as_printed = force - sum(e[name] * column for name, column in columns.items())
    low = black_box_t().law.force(black_box_t().q, points.pressure_pa[use], points.length_m[use], t)
    k = {n: second_stage(n).predictors for n in ("C-4", "C-5", "C-7")}
    return Row(
        "Equation 4-58", "-0.01, 0.39, -0.38 T",
        f"{k['C-4'][0].coef:.4f}, {k['C-5'][0].coef:.3f}, {k['C-7'][1].coef:.3f} T; rmse on C-1 "
        f"{_rms(as_printed):.2f} N as printed, {_rms(force - low):.2f} N with 4-53 to 4-57",
        verdict(same("-0.01", k["C-4"][0].coef) and same("0.39", k["C-5"][0].coef)
                and same("-0.38", k["C-7"][1].coef)),
        "rounded or truncated to too few digits", ("A60", "A63"),
    )  # fmt: skip


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
