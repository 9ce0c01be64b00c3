"""`pamrig calibrate pressure|force` and `pamrig read`: what the command line does."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import typer

from analysis.regression.calibration_line import Reference
from daq.errors import ConfigError
from daq.interrupt import stop_on_signals
from rigs.bench.rig import open_rig
from rigs.calibration.force import calibrate_force
from rigs.calibration.pressure import calibrate_pressure
from rigs.calibration.run import Calibrated
from rigs.execution.runner import Watch
from rigs.rigfile.calibration_file import write_calibration
from rigs.rigfile.config import load_rig

LONGEST_S = 86400.0


def numbers(text: str, key: str) -> list[float]:
    """Numbers out of "0,100,200".

    Raises:
        ConfigError: names the option.
    """
    try:
        return [float(word) for word in text.split(",") if word.strip()]
    except ValueError:
        raise ConfigError(key, f"{text!r} is no list of numbers", "write it as 0,100,200") from None


def uncertainty(value: float, key: str, relative: bool = False) -> float:
    """A standard uncertainty as given on the command line.

    Raises:
        ConfigError: names the option.
    """
    if not 0.0 <= value < (1.0 if relative else math.inf):
        raise ConfigError(
            key,
            f"{value:g} is no {'relative ' if relative else ''}standard uncertainty",
            "0.001 is 0.1 %" if relative else "give a number from 0 up",
        )
    return value


def pressure_command(
    rig: str,
    out: Path,
    pressures: str,
    gauge: str,
    u_each: float,
    u_zero: float,
    u_gain: float,
    records: Path,
    operator: str,
    replace: bool,
    as_json: bool,
) -> None:
    """Calibrate the pressure sensor and write the file."""
    known = Reference(
        gauge,
        uncertainty(u_each, "--u-each"),
        uncertainty(u_zero, "--u-zero"),
        uncertainty(u_gain, "--u-gain", relative=True),
    )
    _check(out, replace)
    with stop_on_signals() as stop:
        done = calibrate_pressure(
            load_rig(rig), numbers(pressures, "--pressures"), records,
            reference=known if gauge else None, who=operator, stop=stop, watch=_watch(as_json),
        )  # fmt: skip
    _write(done, out, replace, as_json)


def force_command(
    rig: str,
    out: Path,
    masses: str,
    weights: str,
    u_each: float,
    u_gain: float,
    records: Path,
    operator: str,
    replace: bool,
    as_json: bool,
) -> None:
    """Calibrate the source of force and write the file."""
    known = Reference(
        weights,
        u_each=uncertainty(u_each, "--u-each"),
        u_gain=uncertainty(u_gain, "--u-gain", relative=True),
    )
    _check(out, replace)
    with stop_on_signals() as stop:
        done = calibrate_force(
            load_rig(rig), numbers(masses, "--masses"), records, weights=known,
            who=operator, stop=stop, watch=_watch(as_json),
        )  # fmt: skip
    _write(done, out, replace, as_json)


def read_command(rig: str, seconds: float, as_json: bool) -> None:
    """Listen to every instrument of a rig for a while and say what each reads."""
    if not 0.1 <= seconds <= LONGEST_S:
        raise ConfigError("--seconds", f"{seconds:g} s is outside 0.1 to {LONGEST_S:g} s")
    config = load_rig(rig)
    with open_rig(config) as opened:
        opened.valve.progress(seconds + 1.0)
        opened.pump.for_seconds(seconds)
        out = []
        for name, instrument in opened.instruments.items():
            n = max(1, min(instrument.rows, round(seconds * instrument.rate_hz)))
            out.append(
                {
                    "instrument": name,
                    "quantity": instrument.quantity,
                    "value": round(instrument.mean(n), 6),
                    **instrument.counters(),
                }
            )
    if as_json:
        typer.echo(json.dumps(out, indent=2))
        return
    if not out:
        typer.echo(f"{config.source} has no instruments beside valve, balance, stage and camera")
    for row in out:
        faults = {k: v for k, v in row.items() if k not in ("instrument", "quantity", "value")}
        words = ", ".join(f"{v} {k}" for k, v in faults.items())
        typer.echo(f"{row['instrument']:22} {row['quantity']:18} {row['value']:>10.5g}   {words}")


def _check(out: Path, replace: bool) -> None:
    """An hour of weights is not lost for a file that cannot be written."""
    if out.exists() and not replace:
        raise ConfigError(str(out), "exists already", "choose another --out, or add --replace")
    if not out.absolute().parent.is_dir():
        raise ConfigError(str(out), "its folder does not exist", "make it first")


def _watch(as_json: bool) -> Watch:
    if as_json:
        return Watch()

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    return Watch(state=say, log=say)


def _write(done: Calibrated, out: Path, replace: bool, as_json: bool) -> None:
    write_calibration(out, done.file, done.points, replace)
    c = done.file.calibration
    if as_json:
        values = {**c.to_dict(), "linearity": done.file.linearity, "file": str(out),
                  "record": str(done.folder), "points": [list(p) for p in done.points]}  # fmt: skip
        typer.echo(json.dumps(values, indent=2))
        return
    typer.echo(f"{c.raw_unit:>12} {'reference ' + c.unit:>14} {'residual ' + c.unit:>14}")
    for raw, reference, residual in done.points:
        typer.echo(f"{raw:12.5g} {reference:14.5g} {residual:14.3g}")
    typer.echo(
        f"{c.quantity} = {c.offset:.6g} + {c.scale:.8g} * {c.raw_unit}, "
        f"u = {c.u_offset:.3g} {c.unit} + {c.u_gain * 100:.3g} %, "
        f"linear within {done.file.linearity:.3g} {c.unit}, "
        f"{c.domain[0]:g} to {c.domain[1]:g} {c.unit}"
    )
    typer.echo(f"written: {out}   record: {done.folder}")
