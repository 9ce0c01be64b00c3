"""`python -m tests.fatigue_day`: a fatigue test over days on the virtual clock, stopped and killed.

The commands of a user in processes of their own: `pamrig fatigue`, after a third of the cycles
Ctrl-C, `pamrig continue`, after two thirds a kill (SIGKILL), `pamrig continue` to the end. Then the
joined table is checked: every cycle once, every record sound. `--page` writes the result into the
page between two marks.
"""

from __future__ import annotations

import argparse
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from analysis.run_table import chain_of, reduce_run
from daq.errors import PamrigError
from daq.store.run import open_run
from daq.store.store import list_runs
from daq.store.verify import verify
from rigs.rigfile.toml_reader import find_config

LOOK_S = 2.0
BEGIN, END = "<!-- fatigue-day -->", "<!-- end -->"


def protocol(folder: Path, hours: float, rate_hz: float) -> tuple[Path, int]:
    """The shipped file with as many cycles as fill the time; its path and their number."""
    cycles = max(30, round(hours * 3600.0 * rate_hz))
    text = find_config("fatigue", "protocols")[0]
    text = re.sub(r"^cycles = 100000.*$", f"cycles = {cycles}", text, flags=re.MULTILINE)
    text = re.sub(r"^rate_hz = .*$", f"rate_hz = {rate_hz:g}", text, flags=re.MULTILINE)
    text = text.replace("every = 1000 ", f"every = {max(10, cycles // 40)} ")
    path = folder / "fatigue-day.toml"
    path.write_text(text, "utf-8")
    return path, cycles


def made(runs: Path) -> int:
    """Number of the last cycle whose row is in a record; 0 before the first."""
    with_cycles = [info.folder for info in list_runs(runs)]
    try:
        rows = open_run(with_cycles[-1]).samples("cycles")["cycle"] if with_cycles else ()
    except (PamrigError, KeyError):
        return 0
    return int(rows[-1]) if len(rows) else 0


def part(words: list[str], runs: Path, until: int, how: signal.Signals | None) -> dict[str, Any]:
    """One command, ended by a signal from a cycle on; what it took."""
    begin_s = time.monotonic()
    program = subprocess.Popen(
        [sys.executable, "-m", "cli.main", *words], stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    process = psutil.Process(program.pid)
    peak_mb = cpu_s = 0.0
    sent = 0
    while program.poll() is None:
        time.sleep(LOOK_S)
        try:
            peak_mb = max(peak_mb, process.memory_info().rss / 1e6)
            cpu_s = process.cpu_times().user + process.cpu_times().system
        except psutil.Error:
            break
        if how is not None and not sent and (seen := made(runs)) >= until:
            program.send_signal(how)
            sent = seen
    _, said = program.communicate()
    return {
        "status": program.returncode, "sent": sent, "cpu_s": cpu_s, "peak_mb": peak_mb,
        "wall_s": time.monotonic() - begin_s, "said": said, "last": made(runs),
    }  # fmt: skip


def campaign(folder: Path, hours: float, rate_hz: float) -> dict[str, Any]:
    """Three parts, then the checks; plain values."""
    path, cycles = protocol(folder, hours, rate_hz)
    runs = folder / "runs"
    begin = ["fatigue", "--protocol", str(path), "--rig", "virtual", "--out", str(runs)]
    more = ["continue", "last", "--runs", str(runs)]
    parts = [
        part(begin, runs, cycles // 3, signal.SIGINT),
        part(more, runs, 2 * cycles // 3, signal.SIGKILL),
        part(more, runs, cycles, None),
    ]
    last = open_run(list_runs(runs)[-1].folder)
    table = reduce_run(last).table
    order = table["order"].to_numpy()
    chain = chain_of(last)
    size = sum(file.stat().st_size for file in runs.rglob("*") if file.is_file()) / 1e6
    high = table["force_range_n"].to_numpy(np.float64)
    return {
        "hours": hours, "rate_hz": rate_hz, "cycles": cycles, "parts": parts,
        "outcomes": [run.outcome for run in reversed(chain)],
        "findings": [finding for run in chain for finding in verify(run)],
        "missing": int(cycles - len(np.unique(order))), "twice": int(len(order) - len(set(order))),
        "size_mb": size, "first_n": float(high[5:10].mean()), "last_n": float(high[-10:].mean()),
    }  # fmt: skip


def words_of(found: dict[str, Any]) -> str:
    """The result as a paragraph."""
    parts = found["parts"]
    took = sum(part["wall_s"] for part in parts) / 60.0
    cpu = sum(part["cpu_s"] for part in parts)
    stop, kill = parts[0], parts[1]
    return (
        f"`python -m tests.fatigue_day --hours {found['hours']:g} --rate {found['rate_hz']:g}`:"
        f" {found['cycles']} cycles on the virtual clock in three parts"
        f" ({', '.join(found['outcomes'])}).\nCtrl-C came in cycle {stop['sent']} or after, the"
        f" last row of that part is cycle {stop['last']}; the kill came in cycle {kill['sent']} or"
        f" after, its last row is {kill['last']}.\nMissing cycles: {found['missing']}, double:"
        f" {found['twice']}, findings of `verify`: {len(found['findings'])}. The force range was"
        f" {found['first_n']:.2f} N in cycles 6 to 10 and {found['last_n']:.2f} N in the last"
        f" ten.\nThe records take {found['size_mb']:.0f} MB, the program at most"
        f" {max(part['peak_mb'] for part in parts):.0f} MB of memory, {cpu:.0f} s of processor"
        f" time, {took:.0f} min."
    )


def main() -> int:
    """Command line; 1 where a cycle is missing or double, or a record is not sound."""
    parser = argparse.ArgumentParser(description="A fatigue test over days, stopped and killed.")
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--rate", type=float, default=0.5, help="cycles per second")
    parser.add_argument("--folder", type=Path, help="keep the runs here")
    parser.add_argument("--page", type=Path, help="page to write the result into")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        found = campaign(folder, given.hours, given.rate)
    text = words_of(found)
    print(text)
    for finding in found["findings"]:
        print(finding)
    bad = found["missing"] or found["twice"] or found["findings"]
    bad = bad or found["outcomes"] != ["stopped", "interrupted", "clean"]
    if bad:
        for one in found["parts"]:
            print(one)
    if given.page is not None:
        page = given.page.read_text("utf-8")
        head, _, rest = page.partition(BEGIN)
        given.page.write_text(f"{head}{BEGIN}\n\n{text}\n\n{END}{rest.partition(END)[2]}", "utf-8")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
