"""The conditions of a test for its report: instruments, weights, leak check, mountings."""

from __future__ import annotations

import contextlib
import tomllib
from typing import TYPE_CHECKING, Any

from analysis.findings.findings import Section
from analysis.reduction.points import length_source, pressure_sensor
from daq.store.info import on_virtual_bench

if TYPE_CHECKING:
    from analysis.reduction.points import Reduction
    from daq.store.run import Run

SHOWN = ("kind", "name", "serial", "fw", "version", "source", "identity")
"""What a header shows of an instrument; the rest stands under Provenance."""


def simulated(run: Run) -> str:
    """In words, what was simulated; "" for a run on a real bench or an import."""
    manifest = run.manifest
    if manifest.get("imported"):
        return ""
    if manifest.get("simulated"):
        return "a simulation of the whole bench; no muscle was tested"
    if on_virtual_bench(manifest):
        return "a test on the virtual bench; no muscle was tested"
    return ""


def instruments(run: Run, reduction: Reduction) -> list[tuple[str, str]]:
    """The instruments that this test used: name, and what identifies it."""
    devices = run.manifest.get("devices") or {}
    unused = _unused(run, reduction)
    due = {entry.get("device"): entry for entry in calibrations_due(run)}
    out = []
    for name, about in devices.items():
        if name in unused:
            continue
        shown = about if isinstance(about, dict) else {"": about}
        words = [f"{key} {shown[key]}".strip() for key in ("", *SHOWN) if shown.get(key)]
        if name in due:
            words.append(due_sentence(due[name]))
        out.append((name.replace("_", " "), ", ".join(words) or "no identity stated"))
    return out


def calibrations_due(run: Run) -> list[dict[str, Any]]:
    """The calibrations that were due at the start of a run, or soon after, as its record states."""
    given = run.manifest.get("calibrations_due")
    return [entry for entry in given if isinstance(entry, dict)] if isinstance(given, list) else []


def due_sentence(entry: dict[str, Any]) -> str:
    """One of them in words."""
    left = entry.get("days_left")
    late = isinstance(left, int) and left <= 0
    return f"calibration of {entry.get('date')} {'was' if late else 'is'} due on {entry.get('due')}"


def _unused(run: Run, reduction: Reduction) -> set[str]:
    """Instruments of the rig that gave this test nothing."""
    kinds = [(event.get("kind"), event) for event in run.events]
    moved = any(
        (kind == "command" and event.get("device") == "stage")
        or (kind == "manual" and event.get("axis") == "length")
        for kind, event in kinds
    )
    checked = {str(event.get("checked_by")) for _, event in kinds if "checked_by" in event}
    unused = set() if moved else {"stage"}
    if not run.frames:
        unused.add("camera")
    table = reduction.table
    tared = any(kind == "tare" for kind, _ in kinds)
    if len(table) and "force_n" not in table and not tared:
        unused |= {"balance", "load_cell"} - checked
    if len(table) and "velocity_m_s" not in table:
        unused.add("flow")
    # The weight of a hung mass has no part from a calibration of the balance.
    weighed = "force_n" not in table or not len(table) or not _by_mass(table)
    if not weighed and not tared:
        unused |= {"balance", "load_cell"} - checked
    return unused | (_only_recorded(run, table, {str(e.get("device")) for _, e in kinds}) - checked)


def _only_recorded(run: Run, table: Any, commanded: set[str]) -> set[str]:
    """Instruments beside valve, stage, balance and camera whose readings no result contains."""
    manifest = run.manifest
    names = (manifest.get("parameters") or {}).get("instruments") or {}
    used = {pressure_sensor(run), length_source(run), force_device(run), *map(str, names.values())}
    air = (manifest.get("conditions") or {}).get("temperature_source")
    found = set()
    for name, calibration in run.instrument_calibrations.items():
        quantity = calibration.quantity
        if quantity == "temperature_c":
            read = name == air
        else:  # two sensors of one quantity: the table has the readings of one of them
            read = quantity in table and quantity not in run.calibrations
        if name not in used and not read:
            found.add(name)
    counters = (run.final or {}).get("counters") or {}
    silent = {name for name, about in counters.items() if about == {"rows": 0}}
    return found | (silent - commanded)


def force_device(run: Run) -> str:
    """The name of the instrument that reads the force, as the rig file states it."""
    devices = run.manifest.get("devices") or {}
    with contextlib.suppress(tomllib.TOMLDecodeError):
        text = (run.manifest.get("rig") or {}).get("text") or ""
        stated = tomllib.loads(str(text)).get("force_source")
        if isinstance(stated, str) and stated in devices:
            return stated
    return "load_cell" if "load_cell" in devices and "balance" not in devices else "balance"


def _by_mass(table: Any) -> bool:
    return "mass_kg" in table and bool(table["mass_kg"].notna().all())


def conditions(run: Run) -> dict[str, list[dict[str, Any]]]:
    """Weights, leak checks and mountings as recorded, for the JSON report."""
    keys = {
        "load": ("asked_kg", "mass_kg", "checked_by", "checked_kg"),
        "leak": ("pressure_kpa", "loss_kpa_s", "limit_kpa_s", "hold_s", "tight"),
        "mounted": ("mounting", "waited_s", "remark"),
    }
    names = {"load": "weights", "leak": "leak_checks", "mounted": "mountings"}
    return {
        names[kind]: [
            {"t_s": event["t_ns"] / 1e9, **{key: event[key] for key in wanted if key in event}}
            for event in run.events
            if event.get("kind") == kind
        ]
        for kind, wanted in keys.items()
    }


def condition_sections(run: Run) -> list[Section]:
    """Sections on what was hung, how tight the bench was, and how the muscle was mounted."""
    found = conditions(run)
    sections = []
    if any(row.get("mass_kg") for row in found["weights"]):
        sections.append(_weights(run, found["weights"]))
    if found["leak_checks"]:
        words = tuple(
            f"At {row['pressure_kpa']:.0f} kPa with both valves closed for {row['hold_s']:g} s the"
            f" pressure {'fell' if row['loss_kpa_s'] >= 0 else 'rose'} by"
            f" {abs(row['loss_kpa_s']):.3f} kPa/s (limit {row['limit_kpa_s']:g} kPa/s)."
            for row in found["leak_checks"]
        )
        sections.append(Section("Leak check", words))
    mountings = found["mountings"]
    names = (run.manifest.get("parameters") or {}).get("method") or {}
    first = list(names.get("mountings") or [])[:1]
    if mountings:
        again = ", ".join(
            f"{row['mounting']} at {row['t_s']:.0f} s"
            + (f" ({row['remark']})" if row.get("remark") else "")
            for row in mountings
        )
        begun = f"The test began with mounting {first[0]}. " if first else ""
        words = (f"{begun}The muscle was taken off and mounted again: {again}.",)
        sections.append(Section("Mountings", words))
    elif first:
        words = (f"One mounting ({first[0]}); the muscle stayed on the bench.",)
        sections.append(Section("Mountings", words))
    return sections


def _weights(run: Run, rows: list[dict[str, Any]]) -> Section:
    """Weights as requested, as hung (marked), and as the sensor read them."""
    import pandas as pd

    gravity = float((run.manifest.get("conditions") or {}).get("gravity_m_s2", 0.0))
    hung = [row for row in rows if row.get("mass_kg")]
    table = pd.DataFrame(
        {
            "asked": row["asked_kg"],
            "hung": row["mass_kg"],
            "force": f"{row['mass_kg'] * gravity:.4f}",
            "read": f"{row['checked_kg']:.3f}" if "checked_kg" in row else "–",
            "differs": f"{row['checked_kg'] - row['mass_kg']:+z.3f}".replace("-", "−")
            if "checked_kg" in row
            else "–",
            "by": str(row["checked_by"]).replace("_", " "),
        }
        for row in hung
    )
    return Section(
        "Weights",
        ("The table of points uses the marked mass. The sensor only confirms that it hangs.",),
        table,
        (
            ("asked", "requested, kg"), ("hung", "hung (marked), kg"), ("force", "weight, N"),
            ("read", "read, kg"), ("differs", "read − marked, kg"), ("by", "checked by"),
        ),
    )  # fmt: skip
