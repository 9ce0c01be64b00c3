"""Findings of a dynamic test: gain and phase over frequency, with coherence."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import with_u
from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_POINT,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    records,
)
from analysis.layouts.muscle import dynamic_layout
from analysis.reduction.muscle.energy import State, cycle_energy, stated_air
from analysis.reduction.muscle.response import (
    GAIN_UNITS,
    PRESSURE_FORCE,
    PRESSURE_LENGTH,
    SET_PRESSURE,
    reduce_dynamic,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

NARROW = 5.0
"""A logarithmic axis whose ends differ by less gets evenly spaced labels."""
FEW_SINES = 6
"""So many frequencies stand at a short axis, each with its number."""
HALF_POWER = 10.0 ** (-3.0 / 20.0)
METHOD: tuple[str, ...] = (
    "Input and output are cut into segments of whole periods (of a chirp: sweeps). The response is"
    " the mean cross spectrum over that of the input (H1, Welch without overlap); the coherence is"
    " 1 where all of the output follows from the input. The uncertainty of gain and phase follows"
    " from coherence and number of segments (Bendat and Piersol 2010, chapter 9), with the gains of"
    " the calibrations, and 3 ms between the clocks of two instruments. The delay of the instrument"
    " that reads force or length is part of the phase.",
    "A distortion that is the same in every period does not lower the coherence of a sine; the"
    " harmonics show it: root of the power of harmonics 2 to 5 over that of the first.",
)


STROKE_WORDS = (
    "The stroke is that of the mean period: the counted periods as a sum of harmonics, up to the"
    " fifth where the readings are fast enough. The air of a cycle is taken between the highest and"
    " the lowest pressure of that period."
)
NO_WORK = "The length is held: no work is done over a cycle."
NO_LENGTH = (
    "No length was read while the load moved (that needs a length_source in the rig file), so no"
    " work is given."
)


def dynamic_findings(run: Run, reduction: Reduction) -> Findings:
    """One Bode figure and one table for each pair of signals."""
    table = reduction.table
    if not len(table):
        return Findings(NO_POINT)
    sections: list[Section] = []
    for pair in (SET_PRESSURE, PRESSURE_FORCE, PRESSURE_LENGTH):
        part = table[table["pair"] == pair]
        if not len(part):
            continue
        sections.append(
            Section(
                f"Frequency response, {pair}",
                figure=partial(_bode, part, GAIN_UNITS[pair]),
                caption=f"Circles: sines; lines: sweeps. {BARS}",
            )
        )
        columns: list[tuple[str, str]] = [
            ("slot", "excitation"), ("repeat", "repeat"), ("shape", "by"),
            ("frequency_hz", "frequency, Hz"), ("gain", f"gain, {GAIN_UNITS[pair]}"),
            ("phase_deg", "phase, °"), ("coherence", "coherence"), ("segments", "segments"),
        ]  # fmt: skip
        if pair == SET_PRESSURE:
            columns.append(("harmonics_percent", "harmonics, %"))
        shown = part.assign(
            frequency_hz=part["frequency_hz"].map(lambda f: float(f"{f:.4g}")),
            segments=part["segments"].astype(int), coherence=part["coherence"].round(5),
            harmonics_percent=part["harmonics_percent"].round(2),
        )  # fmt: skip
        words = METHOD if pair == SET_PRESSURE else ()
        title = f"Gain and phase, {pair}"
        sections.append(Section(title, words, shown, tuple(columns), caption=f"{EXPANDED}."))
    bands = _bands(table)
    stopped = [
        {key: event.get(key) for key in ("order", "low_hz", "gain", "at_end")}
        for event in run.events
        if event.get("kind") == "saturated"
    ]
    if bands:
        import pandas as pd

        words = (
            "Where the gain falls to 0.708 of that at the lowest frequency, between two sines on a"
            " logarithmic scale.",
        )
        columns_3db = (
            ("slot", "excitation"), ("repeat", "repeat"), ("bandwidth_hz", "−3 dB at, Hz"),
            ("phase_deg", "phase there, °"),
        )  # fmt: skip
        frame = pd.DataFrame(bands)
        caption = f"{EXPANDED}."
        sections.append(
            Section("Bandwidth of the pressure", words, frame, columns_3db, caption=caption)
        )
    work, energies = _work(run, table)
    sections.append(work)
    data = {
        "responses": records(table), "bandwidths": bands, "saturated": stopped, "energy": energies,
    }  # fmt: skip
    return Findings(_headline(table, bands, stopped), tuple(sections), data)


def _work(run: Run, table: pd.DataFrame) -> tuple[Section, list[dict[str, Any]]]:
    """Work of the stroke, exergy of the air and efficiency of each sine under a load."""
    import pandas as pd

    from analysis.findings.muscle.energy import ENERGY_COLUMNS, ENERGY_WORDS, NOT_KNOWN

    title = "Work and efficiency"
    parameters = run.manifest.get("parameters") or {}
    if not parameters.get("mass_kg"):
        return Section(title, (NO_WORK,)), []
    lifted = table[table["stroke_mm"].notna()]
    if not len(lifted):
        return Section(title, (NO_LENGTH,)), []
    air = stated_air(parameters)
    pressure, length = run.calibration("pressure_kpa"), run.calibration("length_mm")
    rows: list[dict[str, Any]] = []
    for row in lifted.to_dict("records"):
        high, low = (
            State(kpa, float(pressure.u(kpa)), mm, float(length.u(mm)))
            for kpa, mm in (
                (float(row[f"pressure_{end}_kpa"]), float(row[f"length_{end}_mm"]))
                for end in ("high", "low")
            )
        )
        made = cycle_energy(float(row["work_j"]), float(row["u_work_j"]), high, low, air)
        named = {key: row[key] for key in ("slot", "repeat", "stroke_mm", "u_stroke_mm")}
        rows.append({**named, "frequency_hz": float(f"{row['frequency_hz']:.4g}"), **vars(made)})
    words = (STROKE_WORDS, *ENERGY_WORDS, *(() if air is not None else (NOT_KNOWN,)))
    columns = (
        ("slot", "excitation"), ("repeat", "repeat"), ("frequency_hz", "frequency, Hz"),
        ("stroke_mm", "stroke, mm"), *ENERGY_COLUMNS,
    )  # fmt: skip
    return Section(title, words, pd.DataFrame(rows), columns, caption=f"{EXPANDED}."), rows


def _bands(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Frequency of half the power, of set-point to pressure, of each trial with sines."""
    own = table[(table["pair"] == SET_PRESSURE) & (table["shape"] == "sine")]
    out = []
    for (slot, repeat), part in own.groupby(["slot", "repeat"], sort=False):
        rows = part.sort_values("frequency_hz")
        f, gain = rows["frequency_hz"].to_numpy(float), rows["gain"].to_numpy(float)
        u = rows["u_gain"].to_numpy(float)
        below = np.flatnonzero(gain < HALF_POWER * gain[0])
        if not len(below) or below[0] == 0:
            continue
        k = int(below[0])
        x, y = np.log(f[k - 1 : k + 1]), np.log(gain[k - 1 : k + 1])
        slope = float((y[1] - y[0]) / (x[1] - x[0]))
        at = float(x[0] + (math.log(HALF_POWER * gain[0]) - y[0]) / slope)
        share = (at - x[0]) / (x[1] - x[0])
        u_log = math.hypot(
            (1 - share) * u[k - 1] / gain[k - 1], share * u[k] / gain[k], u[0] / gain[0]
        )
        phase = np.unwrap(np.radians(rows["phase_deg"].to_numpy(float)))[k - 1 : k + 1]
        out.append(
            {
                "slot": str(slot), "repeat": int(str(repeat)), "bandwidth_hz": math.exp(at),
                "u_bandwidth_hz": math.exp(at) * u_log / abs(slope),
                "phase_deg": round(math.degrees(float(np.interp(at, x, phase))), 1),
            }
        )  # fmt: skip
    return out


def _headline(
    table: pd.DataFrame, bands: list[dict[str, Any]], stopped: list[dict[str, Any]]
) -> str:
    low, high = table["frequency_hz"].min(), table["frequency_hz"].max()
    text = f"Responses were measured from {low:.3g} to {high:.3g} Hz"
    if bands:
        least = min(bands, key=lambda band: band["bandwidth_hz"])
        text += (
            "; the pressure follows its set-point (−3 dB) up to"
            f" {with_u(least['bandwidth_hz'], least['u_bandwidth_hz'])} Hz (k = 2; {least['slot']})"
        )
    elif len(own := table[table["pair"] == SET_PRESSURE]):
        last = own.sort_values("frequency_hz").iloc[-1].to_dict()
        text += (
            f"; at {last['frequency_hz']:.3g} Hz the gain from set-point to pressure is"
            f" {with_u(last['gain'], last['u_gain'])} (k = 2; {last['slot']})"
        )
    if stopped:
        text += f"; at {stopped[0]['low_hz']:g} Hz it did not follow any more"
    return text + "."


def _bode(part: pd.DataFrame, unit: str) -> Figure:
    from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

    from analysis.figures.drawing import (
        COVERAGE,
        QUIET,
        marker,
        new_figure,
        plain_decades,
        sequence,
        style,
    )

    groups = list(part.groupby(["slot", "repeat", "shape"], sort=False))
    sines = sorted(set(part.loc[part["shape"] == "sine", "frequency_hz"]))
    settings = list(dict.fromkeys((slot, repeat) for (slot, repeat, _), _ in groups))
    colours = dict(zip(settings, sequence(len(settings)), strict=True))
    with style():
        figure, (top, middle, bottom) = new_figure(7.2, 6.8, rows=3, sharex=True)
        for (slot, repeat, shape), rows in groups:
            rows = rows.sort_values("frequency_hz")
            colour, k = colours[slot, repeat], settings.index((slot, repeat))
            f = rows["frequency_hz"].to_numpy(float)
            phase = np.degrees(np.unwrap(np.radians(rows["phase_deg"].to_numpy(float))))
            sine = shape == "sine"
            look = {
                "color": colour, "fmt": f"{marker(k)}" if sine else "-", "markersize": 4,
                "linewidth": 1.0, "elinewidth": 0.7,
            }  # fmt: skip
            label = f"{slot}, repeat {repeat}, {shape}"
            gain, u_gain = rows["gain"].to_numpy(float), COVERAGE * rows["u_gain"].to_numpy(float)
            # On a logarithmic axis a bar may not reach 0.
            low = np.minimum(u_gain, 0.95 * gain)
            top.errorbar(f, gain, yerr=[low, u_gain], label=label, **look)
            middle.errorbar(f, phase, yerr=COVERAGE * rows["u_phase_deg"], **look)
            bottom.plot(
                f, rows["coherence"], marker=marker(k) if sine else "", markersize=4,
                color=colour, linewidth=0 if sine else 1.0,
            )  # fmt: skip
        top.set_xscale("log")
        top.set_yscale("log")
        for axis in (bottom.xaxis, top.yaxis):
            low, high = axis.get_view_interval()
            if high >= NARROW * low:
                plain_decades(axis)
                continue
            few = axis is bottom.xaxis and len(sines) <= FEW_SINES
            axis.set_major_locator(FixedLocator(sines) if few else MaxNLocator(5))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
        middle.axhline(0.0, color=QUIET, linewidth=0.8)
        top.set_ylabel(f"gain ({unit})")
        middle.set_ylabel("phase (degrees)")
        bottom.set_ylabel("coherence")
        bottom.set_ylim(-0.03, 1.05)
        bottom.set_xlabel("frequency (Hz)")
        top.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
        figure.align_ylabels([top, middle, bottom])
    return figure


DYNAMIC = Analysis(
    "dynamic", "Dynamic test", reduce_dynamic, dynamic_layout, dynamic_findings,
    ResultColumns(("gain", "phase_deg"), ("pair", "slot", "frequency_hz")),
)  # fmt: skip
ANALYSES = (DYNAMIC,)
