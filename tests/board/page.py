"""docs/evidence/board.md from the results."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from valvefw import wire

from . import judge
from .parts import FULL_SECONDS, FULL_TRIALS, INPUTS

LAST_FULL = "2026-11-23 with revision d23b4954"  # set anew after a run of the full size
HOUSE = Path(__file__).resolve().parent.parent.parent
HEAD = """\
# Firmware on an emulated RP2040

`make board IMAGE=RPI_PICO.uf2 BOOTROM=bootrom.bin` (`python -m tests.board`) writes this page. It
starts MicroPython's image for the board on an emulated RP2040. The file system holds the files that
`pamrig firmware install` copies. The test program takes the place of everything around the board:
the host at the other end of the UART, the pressure sensor, and a chamber with two valves. Its
commands name a session, as those of `pamrig` do. Times are emulated times, measured outside the
firmware.

**{verdict}**; {date}, revision {revision}; MicroPython {micropython} (`{image}`), boot ROM
{bootrom}, processor at {mhz:g} MHz, flash at {flash:g} MHz, {emulator}.

Size: {size}.

What the emulation cannot show: it models one chip; the second core, the USB port and a reset by
the watchdog are missing; supply voltage, temperature and noise have no effect. Its flash cache is
pessimistic: every miss is a separate read. A real board must confirm the results.
"""
KINDS = {
    "over": "over-pressure: from the third reading above the limit",
    "silent": "host silent: from the last byte of the last heartbeat",
    "garbage": "the same in noise on the line at full rate",
    "rail": "sensor at 4095 counts",
    "constant": "constant reading",
    "zero": "reading 0 under pressure",
    "hung": "the loop stands still",
}


def write_page(whole: dict[str, Any], path: Path) -> None:
    """Write the page; only parts with results appear."""
    path.write_text("\n".join(_lines(whole)).rstrip() + "\n")


def _lines(whole: dict[str, Any]) -> Iterator[str]:
    parts = {name: part for name, part in whole["parts"].items() if "crashed" not in part}
    missed = whole["misses"]
    chip = next((p for p in parts.values() if "flash_divider" in p), None)
    hertz = chip["clock_hz"] if chip else 125e6
    yield HEAD.format(
        **whole["about"],
        verdict=_verdict(len(missed)),
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        revision=_revision(),
        mhz=hertz / 1e6,
        flash=hertz / (chip["flash_divider"] if chip else 2) / 1e6,
        size=_size(whole["about"]),
    )
    yield from _schemes([p for name, p in parts.items() if name.startswith("schemes:")])
    yield from _requests([p for name, p in parts.items() if name.startswith("schemes:")])
    yield from _inputs([p for name, p in parts.items() if name.startswith("inputs:")])
    yield from _trials([p for name, p in parts.items() if name.startswith("trials:")])
    if "pulses" in parts:
        yield from _pulses(parts["pulses"])
    if "memory" in parts:
        yield from _memory(parts["memory"])
    yield from _conformance([p for name, p in parts.items() if name.startswith("conformance:")])
    if missed:
        yield "## Outside the limits\n"
        for line in missed:
            yield f"- {line}"


def _schemes(rows: list[dict[str, Any]]) -> Iterator[str]:
    if not rows:
        return
    yield (
        f"## Schemes\n\n{rows[0]['seconds']:g} s each, with a heartbeat every 100 ms, a change of "
        "the set-point (`open`: of the pulse train) every 500 ms, and 10 samples a frame.\n"
    )
    yield from _scheme_table(rows)
    yield (
        "\nLimits: p99.9 (the value that 99.9 % do not exceed) of the interval between samples "
        f"within {judge.SAMPLING_US:g} us of 1 ms, no sample lost, safety core "
        f"{judge.STEP_US:g} us, busy {judge.BUSY:.0%}, no pulse cut, no gap. *Safety "
        "core*: from entry to return of its interrupt. *Busy*: time in which the processor does "
        "not wait. *Loop late*: time "
        "from a step of the core to the pass of the main loop that uses its reading. *Missed*: "
        "readings that the scheme does not see, because the pass before took longer than 1 ms; the "
        "safety core checks every reading. *Cut*: inlet "
        "pulses that ended before the scheme or the host ended them. *Gaps*: in the numbers of the "
        "samples at the host. *Heartbeat*: from the first byte of the request to the last byte of "
        "its reply.\n"
    )


def _scheme_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield (
        "| Scheme | Interval less 1 ms, us: p99.9 | max | Lost | Safety core, us: mean | p99 | max "
        "| Busy | Loop late, us: p99 | max | Missed | Inlet pulses | Cut | Gaps "
        "| Heartbeat, ms: mean | max |"
    )
    yield "|--|" + "--:|" * 15
    for r in rows:
        off, step, loop, beat = (r[k] for k in ("deviation_us", "step_us", "loop_us", "trips"))
        beat = beat["hb"]
        yield (
            f"| {r['scheme']} | {off['p999']:.0f} | {off['max']:.0f} | {r['lost']} | "
            f"{step['mean']:.0f} | {step['p99']:.0f} | {step['max']:.0f} | {r['busy']:.0%} | "
            f"{loop['p99']:.0f} | {loop['max']:.0f} | {1 - loop['n'] / step['n']:.1%} | "
            f"{r['pulses']} | {r['cut']} | {r['gaps']} | {beat['mean']:.1f} | {beat['max']:.1f} |"
        )


def _inputs(rows: list[dict[str, Any]]) -> Iterator[str]:
    """The schemes with the further inputs switched on; memory with them is one of the rows."""
    schemes = [r for r in rows if "spans" not in r]
    if schemes:
        yield (
            f"## With further inputs\n\n{schemes[0]['seconds']:g} s each. On are the bridge at 80 "
            "conversions a second, the encoder every 20 ms and both analogue inputs every 100 ms "
            f"({', '.join(f'`{text}`' for text in INPUTS)}). The bridge is silent until the "
            "measurement starts; from then on its words are put where its state machine would have "
            "read them. The ADS1115 is missing: the emulation has no device on the I2C bus.\n"
        )
        yield from _scheme_table(schemes)
        readings = "; ".join(
            f"{r['scheme']}: {_readings(r['inputs'])}, beside {r['samples']:,} samples of pressure"
            for r in schemes
        )
        yield f"\nThe same limits. Readings at the host: {readings}.\n"
    for r in rows:
        if "spans" in r:
            yield f"Bytes allocated per tick with them: {_spans(r)}.\n"


def _readings(inputs: dict[str, int]) -> str:
    """Readings by input and state; the host names them `input:state`, both as numbers."""
    out = []
    for name, number in sorted(inputs.items()):
        which, state = (int(part) for part in name.split(":"))
        text = wire.INPUTS[which]
        out.append(f"{number:,} {text}" + (f" ({wire.STATES[state]})" if state else ""))
    return ", ".join(out) or "none"


def _requests(rows: list[dict[str, Any]]) -> Iterator[str]:
    if not rows:
        return
    yield "## Requests that are answered in Python\n"
    yield "| Request | Reply, ms | Loop late, us |"
    yield "|--|--:|--:|"
    for text in rows[0]["slow"]:
        worst = [r["slow"][text] for r in rows]
        yield (
            f"| `{text}` | {max(w['ms'] for w in worst):.1f} | "
            f"{max(w['late_us'] for w in worst):.0f} |"
        )
    yield "\nThe largest values of all schemes. Sampling and checks go on while a reply is made.\n"


def _trials(rows: list[dict[str, Any]]) -> Iterator[str]:
    if not rows:
        return
    yield "## Vents\n"
    yield "Time from a cause to the vent command.\n"
    yield (
        "| Cause, and from when | Trials | Vent command, ms: least | mean | most | Limits "
        "| Reported |"
    )
    yield "|--|--:|--:|--:|--:|--|--|"
    for kind, text in KINDS.items():
        of = [row for r in rows if r["trial"] == kind for row in r["rows"]]
        times = [row["ms"] for row in of if row["ms"] is not None]
        if not times:
            continue
        low, high = judge.TRIAL_MS[kind]
        causes = ", ".join(sorted({str(row["cause"]) for row in of}))
        yield (
            f"| {text} | {len(of)} | {min(times):.2f} | {sum(times) / len(times):.2f} | "
            f"{max(times):.2f} | {low:g} to {high:g} | {causes} |"
        )
    yield (
        "\nAt random moments relative to ticks, frames and other requests, in all schemes. *Vent "
        "command*: time until the firmware has commanded inlet shut and outlet open.\n"
    )


def _pulses(r: dict[str, Any]) -> Iterator[str]:
    yield "## Pulse programs\n"
    yield "| Pulse, us | Pulses | At the pin, us: least | mean | most |"
    yield "|--|--:|--:|--:|--:|"
    for name, f in r["widths_us"].items():
        if f:
            yield f"| {name} | {f['n']} | {f['min']:.1f} | {f['mean']:.1f} | {f['max']:.1f} |"
    released = [
        f"{name}: {f['max']:.1f} ms" if f else f"{name}: never"
        for name, f in r["released_ms"].items()
    ]
    yield (
        "\nThe PIO programs are executed instruction by instruction. Pulses with other edges than "
        f"two: {len(r['spoiled'])}. Edges while held: {sum(r['held_edges'].values())}. Both coils "
        f"de-energised at most after: {'; '.join(released)}.\n"
    )


def _memory(r: dict[str, Any]) -> Iterator[str]:
    spans = max(len(span["bytes"]) for span in r["spans"].values())
    yield (
        "## Memory\n\nBytes allocated per tick while armed, with heartbeats, set-points and "
        f"telemetry (`gc.mem_alloc()` around {spans} spans of 0.2 s): {_spans(r)}. "
        f"{r['heap_used']} bytes of the heap are in use.\n"
    )


def _spans(r: dict[str, Any]) -> str:
    return ", ".join(f"{name} {span['per_tick']:g}" for name, span in r["spans"].items())


def _conformance(rows: list[dict[str, Any]]) -> Iterator[str]:
    if not rows:
        yield (
            "## Conformance\n\nNot part of this run (`--parts conformance`); last run on "
            f"{LAST_FULL}.\n"
        )
        return
    total = {key: sum(r[key] for r in rows) for key in ("conversations", "bytes", "ticks")}
    wrong = sum(len(r["wrong"]) for r in rows)
    yield (
        "## Conformance\n\nThe simulated board of the firmware under this chip's MicroPython "
        f"repeated {total['conversations']} conversations of the conformance tests "
        f"({total['ticks']:,} ticks): {total['bytes']:,} bytes compared with those of CPython, "
        f"{wrong} conversations differ.\n"
    )


def _verdict(missed: int) -> str:
    if not missed:
        return "All limits are met"
    return (
        f"{missed} figures are outside their limits (at the end)"
        if missed > 1
        else "One figure is outside its limit (at the end)"
    )


def _size(about: dict[str, Any]) -> str:
    seconds, trials = about["seconds"], about["trials"]
    text = f"{seconds:g} s a scheme and {trials} trials of each frequent cause of a vent"
    if (seconds, trials) == (FULL_SECONDS, FULL_TRIALS):
        return f"{text} (the full size)"
    return (
        f"{text}, smaller than the full size of {FULL_SECONDS:g} s and {FULL_TRIALS} trials, which "
        f"last ran on {LAST_FULL}"
    )


def _revision() -> str:
    words = ["git", "describe", "--always", "--dirty", "--abbrev=8"]
    done = subprocess.run(words, cwd=HOUSE, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"
