"""Audit of the quasi-static and valve regressions, hysteresis, valve times, ranks and best fits."""

from __future__ import annotations

import math

import numpy as np

from plant.arrays import Array
from plant.audit.printed import Row, listing, printed_rows, same, verdict
from plant.audit.temperature import compare_regression
from plant.fitting.table43 import coefficients
from plant.fitting.tables import FullRegression, best_subsets, full_regression
from plant.fitting.thesis_points import thesis_points
from plant.thesis import array

MEAN_FROM_KPA = 200.0
"""Lowest pressure in the means of C-5; they also omit the turning point (A23)."""


def full_regression_c8() -> FullRegression:
    """Quasi-static, 0 to 125 kPa: force on length and pressure."""
    points = thesis_points("c01")
    use = points.pressure_pa <= 125e3
    columns = {"d": points.length_m[use] * 1e3, "P": points.pressure_pa[use] / 1e3}
    return full_regression("force", points.force_n[use], columns)


def full_regression_c9() -> FullRegression:
    """Quasi-static, 150 to 600 kPa: force on P L and P - 125."""
    points = thesis_points("c01")
    use = points.pressure_pa >= 150e3
    p, d = points.pressure_pa[use] / 1e3, points.length_m[use] * 1e3
    return full_regression("force", points.force_n[use], {"p*d": p * d, "(p-125)": p - 125.0})


def full_regression_d1() -> FullRegression:
    """Valve: pressure on the square of the air velocity, Table D-5."""
    columns = array("d05_air_velocity")
    return full_regression("P", columns["pressure_kpa"], {"V^2": columns["air_velocity_m_s"] ** 2})


def audit() -> list[Row]:
    """Audit of everything except the black boxes."""
    return [
        _regression("C-8", full_regression_c8(), "C-1 at 21 °C, 0 to 125 kPa, with 51.45 mm",
                    ("A01", "A65")),
        _regression("C-9", full_regression_c9(), "C-1 at 21 °C, 150 to 600 kPa", ("A66", "A67")),
        _valve(),
        _isometric_hysteresis(),
        _isotonic_hysteresis(),
        _table_4_5(),
        _d3(),
        _ranks_high(),
        _ranks_low(),
        _best_fit_c10(),
        *_best_fits(),
    ]  # fmt: skip


def _regression(name: str, found: FullRegression, source: str, anomalies: tuple[str, ...]) -> Row:
    good, bad = compare_regression(name, found)
    sse = found.anova[1].ss
    return Row(
        f"Full-regression {name}", f"{good + len(bad)} numbers",
        f"{good} of {good + len(bad)} the same; SSE {sse:.2f}, R-sq {found.r2_percent:.1f} %",
        verdict(not bad, len(bad) <= 2),
        f"from {source}" + (f"; {listing(bad)}" if bad else ""), anomalies,
    )  # fmt: skip


def _valve() -> Row:
    found = full_regression_d1()
    good, bad = compare_regression("D-1", found)
    e = coefficients("5-9", "P")
    ok = same("-5.29", found.predictors[0].coef) and same("0.131", found.predictors[1].coef)
    return Row(
        "Full-regression D-1, Equation 5-9", f"P = {e['1']:g} + {e['V^2']:g} V^2",
        f"{found.predictors[0].coef:.3f}, {found.predictors[1].coef:.6f}, s {found.s:.2f}; "
        f"{good} of {good + len(bad)} numbers the same", verdict(not bad and ok, ok),
        f"from Table D-5; the constant is not significant (p = {found.predictors[0].p:.3f})"
        + (f"; {listing(bad)}" if bad else ""), ("A91",),
    )  # fmt: skip


def _isometric_hysteresis() -> Row:
    rows = array("c05_isometric_hysteresis_difference")
    table_4_4 = {
        (r["length_mm"], r["cycle_max_kpa"]): r["mean_force_difference_n"]
        for r in printed_rows("t4_4_isometric_hysteresis_mean")
    }
    bad, whole = [], 0
    printed = printed_rows("c05_isometric_hysteresis_difference_mean")
    for row in printed:
        turn = float(row["cycle_max_kpa"])
        here = (rows["length_mm"] == float(row["length_mm"])) & (rows["cycle_max_kpa"] == turn)
        p, d = rows["pressure_kpa"][here], rows["force_difference_n"][here]
        mean = float(np.mean(d[(p >= MEAN_FROM_KPA) & (p < turn)]))
        whole += same(row["mean_as_printed"], float(np.mean(d)))
        again = table_4_4[row["length_mm"], row["cycle_max_kpa"]]
        if not same(row["mean_as_printed"], mean) or float(again) != float(row["mean_as_printed"]):
            bad.append(f"{row['length_mm']} mm {row['cycle_max_kpa']} kPa {mean:.3f}")
    return Row(
        "Means of Table C-5, Table 4-4", f"{len(printed)} means",
        f"{len(printed) - len(bad)} of {len(printed)} the same in both", verdict(not bad),
        f"means from {MEAN_FROM_KPA:g} kPa to one step below the turning point; the whole columns "
        f"would give {whole} of them" + (f"; {listing(bad)}" if bad else ""), ("A22", "A23"),
    )  # fmt: skip


def isotonic_means() -> list[tuple[str, str, str, float]]:
    """Mass, turning pressure, mean as printed, and column mean of Table C-7 in mm."""
    rows = array("c07_isotonic_hysteresis_difference")
    found = []
    for row in printed_rows("c07_isotonic_hysteresis_difference_mean"):
        same_mass = rows["mass_kg"] == float(row["mass_kg"])
        here = same_mass & (rows["cycle_max_kpa"] == float(row["cycle_max_kpa"]))
        mean = float(np.mean(rows["length_difference_mm"][here]))
        found.append((row["mass_kg"], row["cycle_max_kpa"], row["mean_as_printed"], mean))
    return found


def _isotonic_hysteresis() -> Row:
    means = isotonic_means()
    bad = [f"{m} kg {c} kPa {mean:.3f}" for m, c, text, mean in means if not same(text, mean)]
    return Row(
        "Means of Table C-7", f"{len(means)} means",
        f"{len(means) - len(bad)} of {len(means)} the same", verdict(not bad),
        "plain means of the columns" + (f"; {listing(bad)}" if bad else ""), ("A26",),
    )  # fmt: skip


def _table_4_5() -> Row:
    table_4_5 = printed_rows("t4_5_isotonic_hysteresis_mean")
    table_4_4 = printed_rows("t4_4_isometric_hysteresis_mean")
    column = "mean_length_difference_mm_as_printed"
    copied = [r[column] for r in table_4_5] == [r["mean_force_difference_n"] for r in table_4_4]
    means = {(m, c): mean for m, c, _, mean in isotonic_means()}
    found = [means[r["mass_kg"], r["cycle_max_kpa"]] for r in table_4_5]
    good = sum(same(r[column], v) for r, v in zip(table_4_5, found, strict=True))
    return Row(
        "Table 4-5", listing([r[column] for r in table_4_5], 8) + " mm",
        listing([f"{v:.2f}" for v in found], 8) + " mm", verdict(good == len(found)),
        "the same eight numbers as Table 4-4, which are newtons: copied instead of C-7's means"
        if copied else "unexplained", ("A28",),
    )  # fmt: skip


def _d3() -> Row:
    columns = array("d01_d03_switching_times")
    printed = printed_rows("d03_std_row")[0]
    bad, values, within = [], [], []
    for name in ("inlet_on", "inlet_off", "outlet_on", "outlet_off"):
        y: Array = columns[f"{name}_ms"]
        values.append(float(np.std(y)))
        groups = [y[columns["pressure_kpa"] == p] for p in np.unique(columns["pressure_kpa"])]
        pooled = sum(float(np.sum((g - g.mean()) ** 2)) for g in groups)
        within.append(math.sqrt(pooled / (len(y) - len(groups))))
        bad += [] if same(printed[name], values[-1]) else [name]
    return Row(
        'Table D-3, row "std"', ", ".join(printed[n] for n in list(printed)[1:5]),
        ", ".join(f"{v:.4f}" for v in values), verdict(not bad),
        f"population standard deviation of all {len(y)} readings, so mostly the trend over "
        f"pressure; at one pressure it is {', '.join(f'{w:.2f}' for w in within)} ms",
        ("A80", "A83", "A84"),
    )  # fmt: skip


def _functions(p: Array) -> dict[str, Array]:
    return {"P": p, "P^2": p**2, "P^3": p**3, "cos(P)": np.cos(p), "sin(P)": np.sin(p)}


def _ranks(
    table: str, low: float, high: float, temperature: float
) -> tuple[int, list[str], dict[float, dict[str, int]]]:
    """Rows of a rank table that follow from C-1, those that do not, and the printed ranks."""
    points = thesis_points("c01", warm=True)
    p, x = points.pressure_pa / 1e3, points.length_m * 1e3
    printed: dict[float, dict[str, int]] = {}
    for row in printed_rows("best_fit_ranks"):
        if row["table"] == table:
            at = float(row["length_mm_or_pressure_kpa"])
            printed.setdefault(at, {})[row["predictor"]] = int(row["rank"])
    good, bad = 0, []
    for at, ranks in printed.items():
        use = (np.abs(x - at) < 0.01) & (p >= low) & (p <= high)
        use &= points.temperature_c == temperature
        columns = _functions(p[use])
        force = points.force_n[use]
        r2 = {n: float(np.corrcoef(columns[n], force)[0, 1] ** 2) for n in ranks}
        order = sorted(r2, key=lambda n: -r2[n])
        if all(order.index(n) + 1 == rank for n, rank in ranks.items()):
            good += 1
        else:
            bad.append(f"{table} at {at:g} mm")
    return good, bad, printed


def _ranks_high() -> Row:
    good, bad, printed = _ranks("C-8", 150.0, 600.0, 21.0)
    return Row(
        "Ranks of Table C-8", f"{len(printed)} rows", f"{good} of {len(printed)} the same",
        verdict(not bad, len(bad) == 1),
        f"ranks by R-sq of one predictor each, from C-1; different: {listing(bad)} (there P^2 and "
        "P^3 fit better than P: curvature at the shortest lengths)", (),
    )  # fmt: skip


def _ranks_low() -> Row:
    _, _, c8 = _ranks("C-8", 150.0, 600.0, 21.0)
    good = copies = total = 0
    for k in range(7):
        some, _, printed = _ranks(f"C-{19 + k}", 0.0, 125.0, 21.0 + 3 * k)
        good += some
        total += len(printed)
        copies += sum(printed[x] == c8[x] for x in printed)
    return Row(
        "Ranks of Tables C-19 to C-25", f"{total} rows", f"{good} of {total} the same",
        verdict(good == total),
        f"{copies} rows have the same ranks as those of C-8, which is another pressure region; "
        "others are not a permutation of 1 to 5", ("A50", "A51"),
    )  # fmt: skip


def _best_fit_c10() -> Row:
    rows = array("c37_isobaric_coefs_21c")
    p, gradient = rows["pressure_kpa"], rows["length_gradient_coef"]
    exact = gradient.copy()
    exact[p == 300.0] = 2.50579
    printed = [r for r in printed_rows("best_subsets") if r["block"] == "Best-fit C-10"]
    candidates = {"P": p, "P^2": p**2, "P^3": p**3, "log P": np.log(p)}
    found = {n: full_regression("K", gradient, {n: c}) for n, c in candidates.items()}
    without = full_regression("K", exact, {"P": p})
    good = [
        next((n for n, f in found.items()
              if same(r["r2_percent"], f.r2_percent) and same(r["s"], f.s)), "")
        for r in printed
    ]  # fmt: skip
    sizes = {r["s"] for r in printed}
    explained = {r["s"] for r, n in zip(printed, good, strict=True) if n}
    return Row(
        "Best-fit C-10", f"s {printed[0]['s']} for P, R-sq {printed[0]['r2_percent']} %",
        f"s {found['P'].s:.5f} with the misprint of C-37, {without.s:.5f} without",
        verdict(bool(good[0]) and len(explained) >= 2),
        f"needs the misprint of C-37; {len(explained)} of its {len(sizes)} different lines follow "
        f"from {', '.join(sorted({n for n in good if n}))}; one line is printed twice",
        ("A47", "A53"),
    )  # fmt: skip


def _best_fits() -> list[Row]:
    """Best-fit tables of coefficients against temperature, and C-11 against pressure."""
    sources = {
        "Best-fit C-2": ("t4_1_coefs_150_600", "K2_length"),
        "Best-fit C-3": ("t4_1_coefs_150_600", "K3_pressure"),
        "Best-fit C-5": ("t4_2_coefs_0_125", "K1_length3_pressure"),
        "Best-fit C-6": ("t4_2_coefs_0_125", "K2_length_pressure"),
        "Best-fit C-7": ("t4_2_coefs_0_125", "K3_pressure"),
        "Best-fit C-8": ("t4_2_coefs_0_125", "K4_length"),
        "Best-fit C-9": ("t4_2_coefs_0_125", "c_intercept"),
    }
    rows = []
    for block, (table, column) in sources.items():
        data = array(table)
        t = data["temperature_c"]
        candidates = {"T": t, "T^2": t**2, "sin T": np.sin(t), "cos T": np.cos(t)}
        rows.append(_subsets(block, data[column], candidates, f"{column} of {table}"))
    data = array("c37_isobaric_coefs_21c")
    p = data["pressure_kpa"]
    candidates = {"P": p, "P^2": p**2, "sin P": np.sin(p), "cos P": np.cos(p)}
    rows.append(_subsets("Best-fit C-11", data["intercept_coef"], candidates, "C-37's intercepts"))
    return rows


def _subsets(block: str, y: Array, candidates: dict[str, Array], source: str) -> Row:
    printed = [r for r in printed_rows("best_subsets") if r["block"] == block]
    every = best_subsets(y, candidates, per_size=99)
    good = 0
    for line in printed:
        good += any(
            int(line["vars"]) == f.vars and same(line["r2_percent"], f.r2_percent)
            and same(line["s"], f.s) for f in every
        )  # fmt: skip
    top = next(f for f in every if f.vars == 1)
    first = printed[0]
    return Row(
        block, f"{len(printed)} lines, first R-sq {first['r2_percent']} %, s {first['s']}",
        f"{good} of {len(printed)} lines; best single R-sq {top.r2_percent:.1f} %, s {top.s:.5g}",
        verdict(good == len(printed), good >= len(printed) - 1 > 0),
        f"best subsets of {', '.join(candidates)} on {source}",
        ("A52",) if block.endswith("-3") else ("A53",) if block.endswith("11") else (),
    )  # fmt: skip
