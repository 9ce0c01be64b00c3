"""A picture of the first trial of an import: every channel with its unit, over time or rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import CHANNELS, COMMANDS
from gap.errors import GapError

_AXIS = {
    "supply_kpa": "supply / kPa", "pressure_kpa": "pressure / kPa (gauge)",
    "length_mm": "length / mm", "force_n": "force / N", "temperature_c": "temperature / °C",
    "inlet_cmd": "inlet / 0 to 1", "outlet_cmd": "outlet / 0 to 1",
}  # fmt: skip


def check_picture(path: Path) -> None:
    """Refuse a name that ends in no format of a picture. Raises `GapError`."""
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise GapError(str(path), "is not a picture file", "name it .png, .svg or .pdf")


def draw_first_trial(data: DataSet, path: Path) -> None:
    """Draw the channels of the first trial below each other, samples as they are.

    Args:
        data: with at least one trial.
        path: .png, .svg or .pdf.

    Raises:
        GapError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    trial = data.trials[0]
    names = [name for name in (*CHANNELS, *COMMANDS) if name in trial]
    end_s = max((float(trial[name].time_s[-1]) for name in names if len(trial[name])), default=0.0)
    figure = Figure(figsize=(7.0, 1.0 + 1.5 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    for axis, name in zip(axes, names, strict=True):
        channel = trial[name]
        if name in COMMANDS:
            # A command holds after its last change.
            time_s, value = np.r_[channel.time_s, end_s], channel.value[[*range(len(channel)), -1]]
            axis.step(time_s, value, where="post", lw=1.0)
        elif trial.settled:
            axis.plot(channel.time_s + 1.0, channel.value, "o", ms=3)
        else:
            axis.plot(channel.time_s, channel.value, ".-", ms=2, lw=0.6)
        axis.set_ylabel(_AXIS[name])
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("row of the table (no time)" if trial.settled else "time / s")
    axes[0].set_title(f"trial {trial.name}, slot {trial.slot}", fontsize=10)
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise GapError(str(path), f"cannot be written: {error.strerror}") from None
