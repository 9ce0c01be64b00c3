"""Data as other programs leave it, for the tests of `pamrig import data` and for its docs page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from gap.mapping.mapping import read_mapping
from gap.mapping.write import Imported, import_data

HOUSE = Path(__file__).resolve().parent.parent
PAGE = HOUSE / "docs" / "use" / "import-data.md"


def imported(folder: Path, text: str, dry: bool = False) -> list[Imported]:
    """Carry out a mapping given as text; the data set goes to folder/"out"."""
    mapping = folder / "mapping.toml"
    mapping.write_text(text, encoding="utf-8")
    return import_data(mapping, folder / "out", dry=dry)


def understood(folder: Path, text: str) -> Any:
    """The mapping that a text gives."""
    mapping = folder / "mapping.toml"
    mapping.write_text(text, encoding="utf-8")
    return read_mapping(mapping)


def strokes(cycles: int = 3, rate_hz: float = 50.0, low: float = 60.0, high: float = 68.0) -> Any:
    """A length that goes up and down: times in s, lengths in mm; one cycle takes two seconds."""
    time_s = np.arange(round(2.0 * cycles * rate_hz) + 1) / rate_hz
    phase = np.abs((time_s + 1.0) % 2.0 - 1.0)
    return time_s, low + (high - low) * phase


def page_mappings() -> dict[str, str]:
    """The mapping files that the docs page shows, by their names."""
    blocks = re.findall(r"```toml\n# (\S+\.toml)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    return dict(blocks)


def prepare_page(folder: Path) -> None:
    """Everything that the commands of the docs page need."""
    for name, text in page_mappings().items():
        (folder / name).write_text(text, encoding="utf-8")
    _logger(folder)
    _tables(folder)
    _rates(folder)
    _spool(folder)
    machine(folder)


def _logger(folder: Path) -> None:
    """A logger's CSV: semicolons, decimal commas, absolute pressure, valves as bits of a state."""
    for run in (1, 2):
        rng = np.random.default_rng(run)
        time_ms = np.arange(0, 4000, 10)
        state = np.where(time_ms % 2000 < 1000, 1, 2)
        state[time_ms < 200] = 0
        kpa = np.zeros(len(time_ms))
        for k in range(1, len(kpa)):
            aim = (400.0 if state[k] == 1 else 0.0) if state[k] else kpa[k - 1]
            kpa[k] = kpa[k - 1] + 0.05 * (aim - kpa[k - 1])
        kpa += rng.normal(0.0, 0.3, len(kpa))
        force_kgf = (0.1 * kpa - 2.0) / 9.80665 + rng.normal(0.0, 0.003, len(kpa))
        lines = ["# logger 4.2", "time;state;pressure;force", "ms;-;bar;kgf"]
        for t, s, p, f in zip(time_ms, state, kpa, force_kgf, strict=True):
            cells = [str(t), str(s), f"{(p + 101.325) / 100.0:.5f}", f"{-f:.5f}"]
            lines.append(";".join(cells).replace(".", ","))
        (folder / f"log-60mm-{run}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _tables(folder: Path) -> None:
    """Settled points of two muscles, contraction in percent of the rest length."""
    for muscle, rest in (("A", 70.0), ("B", 72.0)):
        lines = ["psi,contraction,lbf"]
        for psi in (10, 20, 30, 40, 60):
            for percent in (2.0, 8.0, 14.0):
                lines.append(f"{psi},{percent},{psi * 0.15 * (20.0 - percent) / rest * 4.0:.4f}")
        (folder / f"static-{muscle}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _spool(folder: Path) -> None:
    """A pressure that a spool valve swings, and its voltage."""
    time_s = np.arange(0.0, 3.0, 0.01)
    volts = np.where((time_s > 0.2) & (time_s < 2.5), 5.0 + 3.0 * np.sin(6.0 * time_s), 5.0)
    volts = np.where(time_s > 2.6, 3.0, volts)
    bar = np.maximum(np.cumsum(volts - 5.0) * 0.05, 0.0)
    for run in (1, 2):
        rng = np.random.default_rng(run)
        rows = [
            f"{t:.2f},{u:.6f},{p:.4f}"
            for t, u, p in zip(time_s, volts, bar + rng.normal(0.0, 0.003, len(bar)), strict=True)
        ]
        text = "\n".join(["t,u,p", *rows, ""])
        (folder / f"spool-60mm-{run}.csv").write_text(text, encoding="utf-8")


def _rates(folder: Path) -> None:
    """An HDF5 file with channels of two rates."""
    import h5py

    time_s, length_mm = strokes(cycles=4, rate_hz=50.0)
    fast_s = np.arange(round(time_s[-1] * 400) + 1) / 400.0
    rng = np.random.default_rng(3)
    force = 20.0 + 2.0 * (np.interp(fast_s, time_s, length_mm) - 60.0)
    with h5py.File(folder / "pull.h5", "w") as file:
        file["camera/time"] = time_s
        file["camera/length"] = length_mm * 1e-3
        file["daq/force"] = force + rng.normal(0.0, 0.02, len(force))
        file["daq/pressure"] = 2.0 + rng.normal(0.0, 0.001, len(force))


KINDS = ("instron", "mts", "zwick")
FORCE_N = 0.12
"""Force of the made muscle per kPa, at the length at which it is held."""


def staircase(clock_s: Any, at_s: tuple[float, ...], levels: tuple[float, ...]) -> Any:
    """Pressure in kPa that goes from level to level, each in about 0.2 s."""
    kpa = np.full(len(clock_s), levels[0])
    for begin, before, after in zip(at_s, levels, levels[1:], strict=False):
        kpa += (after - before) * np.clip((clock_s - begin) / 0.2, 0.0, 1.0)
    return kpa


def machine(
    folder: Path,
    kind: str = "instron",
    offset_s: float = 7.31,
    at_s: tuple[float, ...] = (3.0, 6.0, 13.0, 15.5, 22.0),
    levels: tuple[float, ...] = (0.0, 150.0, 400.0, 250.0, 500.0, 0.0),
    seed: int = 1,
    ours_s: float = 26.0,
    theirs_s: tuple[float, float] = (0.0, 40.0),
) -> float:
    """A pull test of a testing machine, and our record of the pressure; returns the offset.

    A time on the machine's clock is that on ours and `offset_s`.
    """
    rng = np.random.default_rng(seed)
    ours = np.arange(0.0, ours_s, 0.01)
    kpa = staircase(ours, at_s, levels) + rng.normal(0.0, 0.5, len(ours))
    rows = [f"{t:.6f},{p:.6f}" for t, p in zip(ours, kpa, strict=True)]
    text = "time_s,pressure_kpa\n" + "\n".join(rows) + "\n"
    (folder / "samples.csv").write_text(text, encoding="utf-8")
    theirs = np.arange(*theirs_s, 0.05)
    force = FORCE_N * staircase(theirs - offset_s, at_s, levels)
    force += rng.normal(0.0, 0.05, len(theirs))
    _EXPORT[kind](folder, theirs, np.full(len(theirs), 2.0), force)
    return offset_s


def _bluehill(folder: Path, time_s: Any, travel_mm: Any, force_n: Any) -> None:
    lines = ['"Specimen label","Muscle A"', '"Results Table 1"', "",
             '"Time","Extension","Load"', '"(s)","(mm)","(N)"']  # fmt: skip
    lines += [f'"{t:.4f}","{x:.5f}","{f:.5f}"'
              for t, x, f in zip(time_s, travel_mm, force_n, strict=True)]  # fmt: skip
    text = "\r\n".join(lines) + "\r\n"
    (folder / "Specimen_RawData_1.csv").write_bytes(text.encode("utf-8"))


def _testsuite(folder: Path, time_s: Any, travel_mm: Any, force_n: Any) -> None:
    lines = ["Test Run Name:\tMuscle A", "Date:\t11/23/2026 10:00:00 AM", "",
             "Crosshead \tLoad \tTime ", "mm\tN\ts"]  # fmt: skip
    lines += [f"{x:.5f}\t{f:.5f}\t{t:.5f}"
              for t, x, f in zip(time_s, travel_mm, force_n, strict=True)]  # fmt: skip
    (folder / "DAQ- Crosshead.txt").write_bytes(("\r\n".join(lines) + "\r\n").encode("utf-8"))


def _testxpert(folder: Path, time_s: Any, travel_mm: Any, force_n: Any) -> None:
    lines = ['"Pr\u00fcfvorschrift";"Zug"', '"Pr\u00fcfer";"M\u00fcller"',
             '"Pr\u00fcfzeit";"Standardweg";"Standardkraft"', '"s";"mm";"N"']  # fmt: skip
    lines += [f"{t:.4f};{x:.5f};{f:.5f}".replace(".", ",")
              for t, x, f in zip(time_s, travel_mm, force_n, strict=True)]  # fmt: skip
    (folder / "Probe 1.TRA").write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))


_EXPORT = {"instron": _bluehill, "mts": _testsuite, "zwick": _testxpert}
