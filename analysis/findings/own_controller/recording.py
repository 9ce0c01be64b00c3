"""A recording of a controller of one's own: what it printed, at what rate, and how well timed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, ResultColumns, Section, records
from analysis.layouts.recording import LABELS, UNITS, recording_layout
from analysis.reduction.columns import points_frame
from analysis.reduction.points import Reduction
from daq.store.rowtimes import Rows, recorded_rows

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.calibration import Calibration
    from daq.store.run import Run

GAP = 3.0
"""A gap is a time between two rows above so many times the median."""
MOST_GAPS = 20
NO_ROW = "No whole line came, so nothing was recorded."
NO_POINTS = "a recording has no settled points; its rows are in recording.csv"
METHODS = {
    "own time": "fitted from the time that the controller prints",
    "arrival": "arrival of the lines, because the controller prints no time",
}


def reduce_recording(run: Run) -> Reduction:
    """No points: the rows are the result, see :func:`recording_findings`."""
    return Reduction(points_frame([]), (NO_POINTS,), run.calibrations)


def recording_findings(run: Run, reduction: Reduction) -> Findings:
    """Rate, gaps, uncertainty of time, and each channel over time."""
    del reduction
    rows = recorded_rows(run)
    safety = (str(run.manifest.get("safety") or ""), *_vented(run))
    if not len(rows.time_s):
        return Findings(NO_ROW, (Section("Safety", safety),))
    time, gaps = _time_facts(rows), gaps_of(rows)
    channels = _channels(rows, run.calibrations)
    rejected = _rejected(run)
    rate = f"{time['rate_hz']:.4g} rows a second" if time["rate_hz"] else "one row"
    headline = (
        f"{time['rows']} rows in {rows.time_s[-1]:.1f} s ({rate}); gaps: {len(gaps)}; "
        f"lines that are no rows: {sum(rejected.values())}."
    )
    sections = (
        Section("Safety", safety),
        Section(
            "Channels over time",
            figure=partial(_figure, run, rows, gaps),
            caption="Bands: expanded uncertainty of the calibration, k = 2. Grey: gaps.",
        ),
        Section(
            "Channels", (), channels,
            (("channel", "channel"), ("unit", "unit"), ("low", "lowest"), ("mean", "mean"),
             ("high", "highest"), ("u_at_mean", "standard uncertainty at the mean")),
            caption="The uncertainty is that of the calibration, as the description states it.",
        ),
        Section("Time", _time_words(rows, time, len(gaps)), *_gap_table(gaps)),
        Section("Lines that are no rows", (_rejected_words(rejected),)),
    )  # fmt: skip
    data = {
        "time": time, "gaps": records(gaps), "channels": records(channels), "rejected": rejected,
    }  # fmt: skip
    return Findings(headline, sections, data)


def _vented(run: Run) -> tuple[str, ...]:
    """Whether the set-point 0 was sent at the end, of a controller that was set."""
    vented = ((run.final or {}).get("recording") or {}).get("vented")
    if vented is None:
        return ()
    return (f"Set-point 0 at the end: {'sent' if vented else 'NOT TAKEN; vent by hand'}.",)


def gaps_of(rows: Rows) -> pd.DataFrame:
    """Gaps between rows: ``from_s``, ``to_s`` and ``seconds``, in order of time."""
    import pandas as pd

    step = np.diff(rows.time_s)
    at = np.flatnonzero(step > GAP * np.median(step)) if len(step) else np.zeros(0, dtype=int)
    return pd.DataFrame(
        {"from_s": rows.time_s[at], "to_s": rows.time_s[at + 1], "seconds": step[at]}
    )


def _time_facts(rows: Rows) -> dict[str, Any]:
    step = np.diff(rows.time_s)
    middle = float(np.median(step)) if len(step) else 0.0
    return {
        "rows": len(rows.time_s),
        "duration_s": float(rows.time_s[-1]),
        "rate_hz": 1.0 / middle if middle > 0.0 else None,
        "interval_median_s": middle if len(step) else None,
        "interval_longest_s": float(step.max()) if len(step) else None,
        **rows.times.as_dict(),
    }


def _time_words(rows: Rows, time: Mapping[str, Any], gaps: int) -> tuple[str, ...]:
    found = rows.times
    words = [
        f"The time of a row is {METHODS[found.method]}. Standard uncertainty of the time between "
        f"two rows: {_seconds(found.u_between_s)}; of a time on the computer's clock: "
        f"{_seconds(found.u_host_s)}."
    ]
    if time["interval_longest_s"] is not None:
        words.append(
            f"Between two rows the median is {_seconds(time['interval_median_s'])}, the longest "
            f"{_seconds(time['interval_longest_s'])}. A gap is a time above {GAP:g} times the "
            "median."
        )
    if gaps > MOST_GAPS:
        words.append(f"Of {gaps} gaps, the {MOST_GAPS} longest:")
    if math.isfinite(found.drift_ppm):
        words.insert(
            1,
            f"The controller's clock runs {found.drift_ppm:+.1f} ppm against the computer's; 99 % "
            f"of the lines came within {found.delay_s * 1e3:.1f} ms after the fastest.",
        )
    return tuple(words)


def _seconds(value: float) -> str:
    return f"{value * 1e3:.3g} ms" if value < 1.0 else f"{value:.3g} s"


def _gap_table(gaps: pd.DataFrame) -> tuple[pd.DataFrame | None, tuple[tuple[str, str], ...]]:
    if not len(gaps):
        return None, ()
    columns = (("from_s", "gap from, s"), ("to_s", "to, s"), ("seconds", "length, s"))
    return gaps.nlargest(MOST_GAPS, "seconds").sort_values("from_s"), columns


def _channels(rows: Rows, calibrations: Mapping[str, Calibration]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame(
        {
            "channel": LABELS[name], "unit": UNITS[name], "low": float(values.min()),
            "mean": float(values.mean()), "high": float(values.max()),
            "u_at_mean": float(_u(calibrations[name], values.mean())),
        }
        for name, values in rows.quantities.items()
    )  # fmt: skip


def _u(calibration: Calibration, values: Any) -> Any:
    """Standard uncertainty of readings by their calibration, in its unit."""
    return np.hypot(calibration.u_offset, calibration.u_gain * np.abs(values))


def _rejected(run: Run) -> dict[str, int]:
    counters = ((run.final or {}).get("counters") or {}).get("recorder") or {}
    return {str(k): int(n) for k, n in counters.items() if k != "rows"}


def _rejected_words(rejected: Mapping[str, int]) -> str:
    if not rejected:
        return "None: every line that came was whole."
    counts = ", ".join(f"{n} {kind}" for kind, n in rejected.items())
    return f"{counts}. They were counted and are no rows."


def _figure(run: Run, rows: Rows, gaps: pd.DataFrame) -> Figure:
    from analysis.figures.drawing import COVERAGE, MEASURED, QUIET, SET, new_figure, style
    from analysis.figures.timeline import min_max

    names = list(rows.quantities)
    with style():
        figure, made = new_figure(7.2, 1.0 + 1.9 * len(names), rows=len(names), sharex=True)
        panels = np.atleast_1d(made)
        for axes, name in zip(panels, names, strict=True):
            calibration = run.calibrations[name]
            x, y = min_max(rows.time_s, rows.quantities[name])
            wide = COVERAGE * _u(calibration, y)
            axes.fill_between(x, y - wide, y + wide, color=MEASURED, alpha=0.2, linewidth=0.0)
            axes.plot(x, y, color=MEASURED, linewidth=0.8, label="recorded")
            for gap in gaps.itertuples():
                axes.axvspan(gap.from_s, gap.to_s, color=QUIET, alpha=0.4, linewidth=0.0)
            axes.set_ylabel(f"{LABELS[name]} ({UNITS[name]})")
            sent = _set_points(run, rows) if name == "pressure_kpa" else []
            if sent:
                at_s, kpa = zip(*sent, (float(rows.time_s[-1]), sent[-1][1]), strict=True)
                axes.step(at_s, kpa, where="post", color=SET, linewidth=1.2, label="set-point sent")
                axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8)
        panels[-1].set_xlabel("time since the first row (s)")
        figure.align_ylabels(list(panels))
    return figure


def _set_points(run: Run, rows: Rows) -> list[tuple[float, float]]:
    """Time since the first row in s, and set-point in kPa, of everything that was sent."""
    end_s = float(rows.time_s[-1])
    return [
        (min(event["t_ns"] * 1e-9 - rows.first_s, end_s), float(event["pressure_kpa"]))
        for event in run.events
        if event.get("kind") == "command" and "pressure_kpa" in event
    ]


# ------------------------------------------------------------------------- derived files


def write_recording(run: Run, folder: Path) -> None:
    """Write ``recording.csv``, ``recording.md`` and ``recording.json`` of a run into a folder."""
    import pandas as pd

    rows = recorded_rows(run)
    table = {"time_s": rows.time_s, "earlier_by_s": rows.times.bound_s, **rows.quantities}
    pd.DataFrame(table).to_csv(folder / "recording.csv", index=False, lineterminator="\n")
    (folder / "recording.md").write_text(_text(run, rows), encoding="utf-8")
    ended = (run.final or {}).get("recording") or {}
    about = {
        "reason": ended.get("reason", ""), "times": rows.times.as_dict(),
        "vented": ended.get("vented"), "safety": run.manifest.get("safety", ""),
    }  # fmt: skip
    (folder / "recording.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")


def _text(run: Run, rows: Rows) -> str:
    """The report in plain text."""
    ended = (run.final or {}).get("recording") or {}
    found, reason, vented = rows.times, ended.get("reason"), ended.get("vented")
    lines = [
        f"# Recording of {run.manifest.get('recorder', 'a controller')}", "",
        f"**{run.manifest.get('safety', '')}**", "",
        f"- outcome: {run.outcome}" + (f" ({reason})" if reason else ""),
        f"- rows: {len(rows.time_s)}; not rows: {_rejected(run) or 'none'}",
        f"- time: {METHODS[found.method]}",
        f"- standard uncertainty of the time between two rows: {found.u_between_s:.2g} s",
        f"- standard uncertainty of a time on the computer's clock: {found.u_host_s:.2g} s",
    ]  # fmt: skip
    if math.isfinite(found.drift_ppm):
        lines.append(
            f"- its clock runs {found.drift_ppm:+.1f} ppm against the computer's; 99 % of the "
            f"lines came within {found.delay_s * 1e3:.1f} ms after the fastest"
        )
    if vented is not None:
        lines.append(f"- set-point 0 at the end: {'sent' if vented else 'NOT TAKEN: vent'}")
    return "\n".join(lines) + "\n"


RECORDING = Analysis(
    "record",
    "Recording of a controller of one's own",
    reduce_recording,
    recording_layout,
    recording_findings,
    ResultColumns(quantities=()),
    write_recording,
)
ANALYSES = (RECORDING,)
