"""Page one of a report: facts, instruments, results, verdict against limits, sign-off."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from analysis.figures.wording import column_decimals, fixed, written_decimals
from analysis.reduction.points import length_source, pressure_sensor
from analysis.reporting.conditions import conditions, force_device, instruments
from analysis.reporting.results import (
    MOST,
    QUANTITIES,
    SETTINGS,
    Judged,
    Result,
    chosen,
    rounded,
    rule_text,
    setting_text,
)
from analysis.statistics.conformity import ORDER, overall

if TYPE_CHECKING:
    from analysis.reduction.points import Reduction
    from daq.calibration import Calibration
    from daq.store.run import Run

JUDGED_MOST = 5
LEAST = 5
ROOM = 38
"""Lines of page one for facts, instruments, results and what else varies."""
FACT_LONG, HEADLINE_LONG = 100, 85
NOTES_MOST = 2
NOTE_LONG = 170
LISTED = 6
"""Values of a list that are named one by one; of longer ones only the ends and the number."""
MEASURED = {"velocity_m_s": "air velocity", "torque_n_m": "torque"}
SETS = {"stage": "(sets the length)"}
"""What an instrument without readings of its own does."""
UNIT_SIGNS = {"degC": "°C"}
SINGLE = {
    "length_mm": ("length", "mm"), "mass_kg": ("load", "kg"), "low_kpa": ("from", "kPa"),
    "high_kpa": ("to", "kPa"), "rate_hz": ("rate", "Hz"), "cycles": ("cycles", ""),
}  # fmt: skip
"""Set values that a method has one of: name and unit."""
UNIT_WORDS = {"kpa": "kPa", "mm": "mm", "kg": "kg", "deg": "°", "c": "°C"}


def page_one(
    run: Run, reduction: Reduction, data: Mapping[str, Any], results: Sequence[Result],
    judged: Sequence[Judged],
) -> dict[str, Any]:  # fmt: skip
    """What the template needs for page one.

    Args:
        run: the run.
        reduction: its reduction.
        data: its JSON report.
        results: all its results.
        judged: those with limits.
    """
    facts, notes = _facts(run, data), _notes(data["notes"])
    used = [] if data["imported"] else instrument_rows(run, reduction)
    lines = [_lines(words, FACT_LONG) for _, words in facts]
    lines += [max(_lines(row["identity"], 36), _lines(row["u"], 20)) for row in used]
    lines += [_lines(note, FACT_LONG) + 1 for note in notes["shown"]]
    lines += [_lines(str(data["headline"]), HEADLINE_LONG), 6 * bool(judged)]
    room = ROOM - sum(lines) - min(len(judged), JUDGED_MOST)
    shown = chosen(results, min(max(room, LEAST), MOST))
    printed = reduction.rounding_only
    return {
        "facts": facts,
        "instruments": used,
        "results": result_table(shown, printed),
        "all_results": len(results),
        "details": result_table(results, printed) if len(shown) < len(results) else None,
        "means": means_text(results, bool(reduction.calibrations), bool(reduction.rounding_only)),
        "acceptance": acceptance_table(judged, JUDGED_MOST),
        "all_judged": acceptance_table(judged) if len(judged) > JUDGED_MOST else None,
        "notes": notes,
    }


def _lines(text: str, wide: int) -> int:
    return max(1, math.ceil(len(text) / wide))


def _notes(notes: Sequence[str]) -> dict[str, Any]:
    """Notes on page one: all where they are few and short, else the number of the others."""
    short = [note for note in notes if len(note) <= NOTE_LONG][:NOTES_MOST]
    return {"shown": short, "more": len(notes) - len(short)}


def _facts(run: Run, data: Mapping[str, Any]) -> list[tuple[str, str]]:
    manifest = run.manifest
    rig = manifest.get("rig") or {}
    facts = [("Specimen", str(data["specimen"] or "–"))]
    source = data.get("source")
    if source:
        table = f" (Table {source['table']}, {source['origin']})" if source.get("table") else ""
        facts.append(("Source", f"{source['title']}{table}"))
    facts.append(("Run", str(data["run_id"])))
    if data["imported"]:
        facts.append(("Imported", _date(data["started_utc"])))
    else:
        duration = data["duration_s"]
        took = f", {duration:.0f} s" if duration is not None else ""
        facts += [
            ("Operator", str(data["operator"] or "not stated")),
            ("Tested", _date(data["started_utc"]) + took),
            ("Method", method_text(manifest)),
            ("Conditions", conditions_text(run)),
            ("Rig", " – ".join(filter(None, (rig.get("name"), rig.get("description")))) or "–"),
        ]
    facts.append(("Points", _points(data)))
    if data["continues"]:
        facts.append(("Continues", f"{data['continues']['run_id']}, from trial"
                      f" {data['continues']['trial']} on"))  # fmt: skip
    if data["note"]:
        facts.append(("Note", str(data["note"])))
    return facts


def _points(data: Mapping[str, Any]) -> str:
    more = f", {len(data['excluded'])} more excluded" if data["excluded"] else ""
    return f"{len(data['points'])}{more}"


def _date(utc: object) -> str:
    """A time of a record as "2026-11-24 02:05 UTC"."""
    text = str(utc or "")
    found = re.match(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d)", text)
    return f"{found[1]} {found[2]} UTC" if found else text or "–"


def method_text(manifest: Mapping[str, Any]) -> str:
    """The method in one line: protocol file, set values, repeats and order."""
    given = dict(manifest.get("parameters") or {})
    method = next((given[key] for key in ("method", "held") if given.get(key)), given)
    words = [f"{manifest.get('protocol') or 'isometric'} ({given.get('source') or 'no file'})"]
    for key, value in given.items():
        name, _, unit = key.rpartition("_")
        numbers = (
            isinstance(value, list)
            and value
            and all(isinstance(one, (int, float)) for one in value)
        )
        if key in SINGLE and isinstance(value, (int, float)) and value:
            words.append(f"{SINGLE[key][0]} {value:g} {SINGLE[key][1]}".strip())
        elif numbers and unit in UNIT_WORDS:
            words.append(f"{name.replace('_', ' ')} {_listed(value)} {UNIT_WORDS[unit]}")
    repeats, names = method.get("repeats"), method.get("mountings") or []
    if repeats is not None:
        words.append(f"{repeats} repeat{'s' if repeats != 1 else ''}")
    if len(names) > 1:
        words.append(f"{len(names)} mountings")
    if method.get("order"):
        words.append(f"order {method['order']}")
    return "; ".join(words)


def _listed(values: Sequence[float]) -> str:
    def text(value: float) -> str:
        return f"{value:g}".replace("-", "−")

    if len(values) <= LISTED:
        return ", ".join(map(text, values))
    return f"{text(min(values))} to {text(max(values))} ({len(values)} values)"


def conditions_text(run: Run) -> str:
    """Temperature, gravity and leak of a test in words; a loss is positive."""
    stated = run.manifest.get("conditions") or {}
    words = []
    set_by_test = (run.manifest.get("parameters") or {}).get("temperatures_c")  # in the method
    if stated.get("temperature_c") is not None and not set_by_test:
        u = stated.get("u_temperature_c")
        spread = f" ± {2.0 * float(u):.1f}" if u is not None else ""
        words.append(f"{fixed(float(stated['temperature_c']), 1)}{spread} °C")
    if stated.get("gravity_m_s2") is not None:
        words.append(f"gravity {float(stated['gravity_m_s2']):g} m/s²")
    leaks = conditions(run)["leak_checks"]
    if leaks:
        worst = max(leaks, key=lambda row: abs(row["loss_kpa_s"]))
        words.append(
            f"loss in the leak check {fixed(worst['loss_kpa_s'], 3)} kPa/s"
            f" at {worst['pressure_kpa']:.0f} kPa (limit {worst['limit_kpa_s']:g})"
        )
    return "; ".join(words) or "–"


def instrument_rows(run: Run, reduction: Reduction) -> list[dict[str, str]]:
    """The instruments of the test, each with what it measured and its calibration."""
    rows = []
    left = dict(reduction.calibrations)
    device_of = {name: _device(run, name) for name in left}
    for name, identity in instruments(run, reduction):
        own = [q for q, device in device_of.items() if device.replace("_", " ") == name]
        for quantity in own:
            rows.append(_calibrated(name, identity, quantity, left.pop(quantity)))
        beside = run.instrument_calibrations.get(name.replace(" ", "_"))
        if not own and beside is not None:
            row = _calibrated(name, identity, beside.quantity, beside)
            rows.append(row | {"date": beside.date or "–"})  # the maker's statement has none
        elif not own:
            rows.append({"name": name, "identity": identity, "quantity": SETS.get(name, ""),
                         "calibration": "", "date": "", "u": ""})  # fmt: skip
    unused = set(run.manifest.get("devices") or {})  # those used are in the table already
    return rows + [
        _calibrated("–", "", name, one)
        for name, one in left.items()
        if device_of[name] not in unused
    ]


def _device(run: Run, quantity: str) -> str:
    """The name of the instrument that read a quantity."""
    names = (run.manifest.get("parameters") or {}).get("instruments") or {}
    return str({
        "pressure_kpa": pressure_sensor(run) or "valve", "pressure_b_kpa": "valve_b",
        "force_n": force_device(run), "length_mm": length_source(run) or "camera",
        "velocity_m_s": "flow",
        "angle_deg": names.get("angle", ""), "torque_n_m": names.get("torque", ""),
    }.get(quantity, ""))  # fmt: skip


def _calibrated(name: str, identity: str, quantity: str, one: Calibration) -> dict[str, str]:
    gain = f", {100.0 * one.u_gain:.3g} % of reading" if one.u_gain else ""
    return {
        "name": name,
        "identity": identity,
        "quantity": quantity_words(quantity),
        "calibration": one.id or "no certificate named",
        "date": one.date or "no date stated",
        "u": f"{one.u_offset:.3g} {UNIT_SIGNS.get(one.unit, one.unit)}{gain}",
    }


def quantity_words(quantity: str) -> str:
    """The name of a calibrated column in words: "pressure" of ``pressure_kpa``."""
    return MEASURED.get(quantity, quantity.rpartition("_")[0].replace("_", " "))


def result_table(results: Sequence[Result], printed: Sequence[str] = ()) -> dict[str, Any]:
    """Columns and rows of a table of results; settings that all share are named once.

    Args:
        results: its rows.
        printed: quantities whose values are shown as their source printed them.
    """
    names = list(dict.fromkeys(name for r in results for name, _ in r.at))
    values = {name: {dict(r.at).get(name) for r in results} for name in names}
    same = [name for name in names if len(values[name]) == 1 and len(results) > 1]
    varied = [name for name in names if name not in same]
    quantities = {r.quantity for r in results}
    heads = [("quantity", "")] if len(quantities) > 1 else []
    heads += [SETTINGS.get(name, (name, "")) for name in varied]
    one = next(iter(quantities), "")
    unit = QUANTITIES.get(one, ("", ""))[1] if len(quantities) == 1 else ""
    heads += [("mean", unit), ("standard deviation", unit), ("tests", ""),
              ("expanded uncertainty", unit), ("k", "")]  # fmt: skip
    decimals = {one: _decimals(results, one, one in printed) for one in quantities}
    places = {name: _places(values[name]) for name in varied}
    rows = []
    for result in results:
        at, text = dict(result.at), rounded(result.mean, decimals[result.quantity])
        cells = [f"{result.name}, {result.unit}".strip(", ")] if len(quantities) > 1 else []
        cells += [_short(name, at[name], places[name]) if name in at else "–" for name in varied]
        rows.append({"settings": cells, "numbers": [text[key] for key in
                     ("mean", "sd", "n", "expanded", "k")]})  # fmt: skip
    title = QUANTITIES.get(one, (one, ""))[0] if len(quantities) == 1 else ""
    common = [(name, next(iter(values[name]))) for name in same]
    shared = ", ".join(
        setting_text(name, value)
        for name, value in common
        if value is not None and (name, value) != ("direction", "single")
    )
    return {"title": title, "shared": shared, "heads": heads, "rows": rows}


def _decimals(results: Sequence[Result], quantity: str, printed: bool) -> int | None:
    """Decimals of the single values of a quantity that have no uncertainty."""
    means = [r.mean for r in results if r.quantity == quantity]
    single = [m.mean for m in means if m.n == 1 and not m.expanded > 0.0]
    if printed:
        return max(map(written_decimals, single), default=0)
    return column_decimals(single)


def _places(values: Iterable[Any]) -> int:
    """Decimals of the numbers of a column of settings: four significant digits, if they differ."""
    numbers = {v for v in values if isinstance(v, float)}
    short = {float(f"{v:.4g}") for v in numbers}
    if len(short) < len(numbers):
        short = {float(f"{v:g}") for v in numbers}
    return max(map(written_decimals, short), default=0)


def _short(name: str, value: float | str, decimals: int) -> str:
    """A setting for a column whose heading has its name and unit."""
    if isinstance(value, str):
        return setting_text(name, value) if name == "direction" else value
    return fixed(value, decimals)


def means_text(
    results: Sequence[Result], calibrated: bool = True, rounding_only: bool = False
) -> str:
    """How mean, deviation and uncertainty were made, in words."""
    if not results:
        return ""
    if all(not math.isfinite(r.mean.expanded) for r in results):
        stated = "; only the rounding of the printed numbers is stated" if rounding_only else ""
        return f"No uncertainty is known for these results{stated}."
    mounted = (
        " With several mountings the random part is from the means of the mountings."
        if any(r.mountings > 1 for r in results) else ""
    )  # fmt: skip
    shared = (
        "from the calibrations, which all tests share" if calibrated
        else "no calibration, because none is known"
    )  # fmt: skip
    return (
        "Expanded uncertainty U = k u for 95.45 %: u from the scatter of the mean (not below the"
        f" noise of the readings) and {shared}; k is Student's t"
        f" for the effective degrees of freedom (GUM, G.4).{mounted}"
    )


def acceptance_table(judged: Sequence[Judged], most: int | None = None) -> dict[str, Any] | None:
    """Verdict, rule and rows of the results with limits; the worst verdicts first."""
    if not judged:
        return None
    verdicts = [one.verdict for one in judged]
    order = sorted(judged, key=lambda one: ORDER.index(one.verdict))
    rows = []
    for one in order[:most]:
        name, unit = QUANTITIES.get(one.quantity, (one.quantity, ""))
        text = rounded(one.result.mean) if one.result else {"mean": "–", "expanded": "–"}
        rows.append({
            "what": ", ".join([name, *(setting_text(k, v) for k, v in one.at)]),
            "limits": limits_text(one.lower, one.upper, unit),
            "value": f"{text['mean']} ± {text['expanded']} {unit}" if one.result else "–",
            "verdict": one.verdict,
        })  # fmt: skip
    return {
        "verdict": overall(verdicts),
        "counts": ", ".join(f"{verdicts.count(v)} {v}" for v in ORDER if v in verdicts),
        "rule": rule_text(judged[0].guard),
        "rows": rows,
        "more": len(judged) - len(rows),
    }


def limits_text(lower: float | None, upper: float | None, unit: str) -> str:
    """Limits in words: "34 to 38 N", "at most 7 N"."""
    if lower is None:
        return f"at most {upper:g} {unit}".replace("-", "−").strip()
    if upper is None:
        return f"at least {lower:g} {unit}".replace("-", "−").strip()
    return f"{lower:g} to {upper:g} {unit}".replace("-", "−").strip()
