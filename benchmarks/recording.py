"""1 kHz x 8 channels recorded durably: pamrig, PyMeasure, QCoDeS, Bluesky, each by its own means.

    python -m benchmarks recording

Every tool runs in a process of its own (``benchmarks/recorders``) and gets the same numbers. *Flat
out*: seconds of feeding as fast as the tool takes it, closing included; rounds take turns. *At
1 kHz*: processor time while rows come one by one (in blocks to the ways that take blocks).
*Killed*: SIGKILL at a random moment while 1 kHz comes in. *Lost* is what the tool had been given
(its call had returned: a counter in shared pages says so) and its own reader does not find;
*missing by the clock* is what was due and is not found, lateness included. `PAMRIG_BENCH_PYTHON`
names another Python that has the peers, where they are not to stand beside pamrig's own packages.
"""

from __future__ import annotations

import json
import math
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.paired import Spread, ratios, short, table

TITLE = "Recording 1 kHz x 8 channels"
HERE = Path(__file__).parent / "recorders"
PYTHON = os.environ.get("PAMRIG_BENCH_PYTHON", sys.executable)
RATE_HZ = 1000
START_S = 120.0
EQUAL = "equal"  # to the system within 50 ms or better, to the medium each second or better


@dataclass(frozen=True)
class Way:
    """One tool with one setting."""

    tool: str
    title: str
    system: str
    medium: str
    setting: dict[str, Any]
    level: str = ""
    blocks: bool = False
    flat: bool = True

    @property
    def like(self) -> str:
        """The way of pamrig that is fed alike."""
        return "pamrig-blocks" if self.blocks else "pamrig"


WAYS = {
    "pamrig": Way("pamrig", "pamrig, row by row", "each row", "1 s", {"rows": 1}, EQUAL),
    "pamrig-blocks": Way(
        "pamrig", "pamrig, blocks of 50", "50 ms", "1 s", {"rows": 50}, EQUAL, blocks=True
    ),
    "pamrig-frames": Way(
        "pamrig", "pamrig, frames of 10 as its controller sends", "10 ms", "1 s", {"rows": 10},
        blocks=True, flat=False,
    ),
    "pymeasure": Way("pymeasure", "PyMeasure, default", "each row", "never", {"fsync": False}),
    "pymeasure-fsync": Way(
        "pymeasure", "PyMeasure, fsync added", "each row", "1 s", {"fsync": True}, EQUAL
    ),
    "qcodes": Way(
        "qcodes", "QCoDeS, default", "5 s", "5 s", {"arrays": False, "write_period_s": None}
    ),
    "qcodes-1s": Way(
        "qcodes", "QCoDeS, arrays of 50, write period 1 s", "1 s", "1 s",
        {"arrays": True, "write_period_s": 1.0}, blocks=True,
    ),
    "qcodes-50ms": Way(
        "qcodes", "QCoDeS, arrays of 50, write period 50 ms", "50 ms", "50 ms",
        {"arrays": True, "write_period_s": 0.05}, EQUAL, blocks=True,
    ),
    "bluesky": Way(
        "bluesky", "Bluesky, events (default)", "each row", "never",
        {"pages": False, "fsync": False},
    ),
    "bluesky-pages": Way(
        "bluesky", "Bluesky, pages of 50, fsync added", "50 ms", "1 s",
        {"pages": True, "fsync": True}, EQUAL, blocks=True,
    ),
}  # fmt: skip
FLAT_S, PACED_S, KILLED_S, HOLDS_BACK_S = 2.0, 3.0, 1.5, 7.0


class Recorder:
    """A recorder's process, which answers jobs."""

    def __init__(self, tool: str) -> None:
        python = sys.executable if tool == "pamrig" else PYTHON
        self.process = subprocess.Popen(
            [python, str(HERE / f"with_{tool}.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"},
        )
        self.version = self._answer()["version"]

    def ask(self, job: dict[str, Any]) -> dict[str, Any]:
        self.begin(job)
        return self._answer()

    def begin(self, job: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("the recorder ended; run its script by hand to see why")
        return json.loads(line)  # type: ignore[no-any-return]

    def close(self) -> None:
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                stream.close()
        self.process.wait()


def available() -> dict[str, str]:
    """Tool: why it cannot run here, or "" if it can."""
    out = {"pamrig": ""}
    for tool in ("pymeasure", "qcodes", "bluesky"):
        done = subprocess.run([PYTHON, "-c", f"import {tool}"], capture_output=True, check=False)
        out[tool] = "" if done.returncode == 0 else "not installed"
    return out


def sync_ms(folder: Path, count: int) -> list[float]:
    """What an fsync of 4 kB takes here."""
    took = []
    with open(folder / "probe", "wb", buffering=0) as out:
        for _ in range(count):
            out.write(bytes(4096))
            begin = time.perf_counter()
            os.fsync(out.fileno())
            took.append((time.perf_counter() - begin) * 1e3)
    return took


def killed(way: Way, recorder: Recorder, folder: Path, after_s: float) -> dict[str, float]:
    """One recording killed ``after_s`` after its first row: seconds lost, and missing."""
    folder.mkdir()
    job = {**way.setting, "folder": str(folder)}
    pid = recorder.ask({**job, "mode": "fork", "seconds": 60.0})["pid"]
    end = time.monotonic() + START_S
    while not (folder / "started").exists():
        if time.monotonic() > end:
            raise RuntimeError(f"{way.title} did not begin")
        time.sleep(0.01)
    begin_ns = int((folder / "started").read_text())
    time.sleep(max(0.0, begin_ns * 1e-9 + after_s - time.monotonic()))
    killed_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    recorder.ask({"mode": "reap", "pid": pid})
    (given,) = struct.unpack("<q", (folder / "given").read_bytes())
    back = recorder.ask({**job, "mode": "read"})
    if back["wrong"]:
        raise RuntimeError(f"{way.title}: {back['wrong']} rows are wrong after a kill")
    due = math.floor((killed_ns - begin_ns) * 1e-9 * RATE_HZ)
    return {
        "lost_s": max(0, given - back["rows"]) / RATE_HZ,
        "missing_s": max(0, due - back["rows"]) / RATE_HZ,
    }


def measure(tiny: bool = False) -> dict[str, Any]:
    """Rates, processor time and losses of every way that can run here."""
    count, paced, kills = (1, 1, 1) if tiny else (4, 3, 8)
    seconds, paced_s = (0.2, 0.3) if tiny else (FLAT_S, PACED_S)
    missing = available()
    ways = {k: w for k, w in WAYS.items() if not missing[w.tool]}
    rng = random.Random(9)
    names = ("flat_hz", "flat_cpu_us", "cpu", "lost_s", "missing_s")
    found: dict[str, dict[str, list[float]]] = {k: {n: [] for n in names} for k in ways}
    out: dict[str, Any] = {"missing": {t: why for t, why in missing.items() if why}, "ways": found}
    with tempfile.TemporaryDirectory() as root:
        place = Path(root)
        out["fsync_ms"] = sync_ms(place, 5 if tiny else 50)
        recorders = {tool: Recorder(tool) for tool, why in missing.items() if not why}
        out["versions"] = {tool: r.version for tool, r in recorders.items()}

        def once(key: str, mode: str, number: int, seconds: float) -> dict[str, Any]:
            folder = place / f"{key}-{mode}-{number}"
            folder.mkdir()
            job = {**ways[key].setting, "folder": str(folder), "seconds": seconds}
            gave = recorders[ways[key].tool].ask({**job, "mode": mode})
            back = recorders[ways[key].tool].ask({**job, "mode": "read"})
            shutil.rmtree(folder, ignore_errors=True)
            if back != {"rows": gave["rows"], "wrong": 0}:
                raise RuntimeError(f"{ways[key].title}: gave {gave['rows']} rows, read {back}")
            return gave

        for number in range(-1, count):  # the first round only warms up
            for key in (k for k, w in ways.items() if w.flat):
                gave = once(key, "flat", number, seconds if number >= 0 else 0.2)
                if number >= 0:
                    found[key]["flat_hz"].append(gave["rows"] / gave["wall_s"])
                    found[key]["flat_cpu_us"].append(gave["cpu_s"] / gave["rows"] * 1e6)
        for number in range(paced):
            for key in ways:
                found[key]["cpu"].append(once(key, "paced", number, paced_s)["cpu_s"] / paced_s)
        for recorder in recorders.values():
            recorder.close()
        fresh = {tool: Recorder(tool) for tool in recorders}  # whose threads no fork breaks off
        for number in range(kills):
            for key, way in ways.items():
                longest = 0.5 if tiny else HOLDS_BACK_S if key == "qcodes" else KILLED_S
                folder = place / f"{key}-kill-{number}"
                cost = killed(way, fresh[way.tool], folder, rng.uniform(0.3, longest))
                for name, value in cost.items():
                    found[key][name].append(value)
        for recorder in fresh.values():
            recorder.close()
    return out


def best_peer(result: dict[str, Any]) -> str | None:
    """The peer's way of equal durability that records most rows a second."""
    rates = {
        k: Spread.of(found["flat_hz"]).median
        for k, found in result["ways"].items()
        if WAYS[k].tool != "pamrig" and WAYS[k].level == EQUAL
    }
    return max(rates, key=lambda k: rates[k]) if rates else None


def ms(seconds: list[float]) -> Spread:
    """Of rows at each kill, as ms of data."""
    return Spread.of([round(1e3 * s) for s in seconds])


def span(spread: Spread) -> str:
    """Whole ms."""
    return f"{spread.median:.0f} ({spread.low:.0f} to {spread.high:.0f})"


def losses(ways: dict[str, Any]) -> str:
    """What a kill cost pamrig, and every peer that lost less."""
    ours = ms(ways["pamrig"]["lost_s"])
    peers = {k: ms(f["lost_s"]) for k, f in ways.items() if WAYS[k].tool != "pamrig"}
    less = [
        f"{WAYS[k].title} ({span(p)})"
        for k, p in peers.items()
        if p.median < ours.median or p.high < ours.high
    ]
    told = f"After a kill, pamrig lost {span(ours)} ms of the rows given one by one. "
    if not less:
        return told + "No other tool lost less, by median or maximum."
    return f"{told}Lost less, by median or maximum: {', '.join(less)}."


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    ways = result["ways"]
    rows = []
    for key, found in ways.items():
        way = WAYS[key]
        flat = str(Spread.of(found["flat_hz"])) if found["flat_hz"] else ""
        times = ""
        if found["flat_hz"] and way.tool != "pamrig":
            times = str(ratios(ways[way.like]["flat_hz"], found["flat_hz"]))
        rows.append([
            way.title, way.system, way.medium, flat, times,
            f"{short(100 * Spread.of(found['cpu']).median)} %",
            span(ms(found["lost_s"])), span(ms(found["missing_s"])),
        ])  # fmt: skip
    for tool, why in result["missing"].items():
        rows.append([tool, "", "", why, "", "", "", ""])
    out = table(
        ["tool", "to system", "to medium", "rows/s maximum",
         "pamrig with the same input is ... times", "processor at 1 kHz", "lost at kill -9, ms",
         "missing at the kill, ms"], rows,
    )  # fmt: skip
    first = ways["pamrig"]
    out.append(
        f"Versions: {', '.join(result['versions'].values())}. A row is a number and eight 64-bit "
        f"channels; {len(first['flat_hz'])} rounds of {FLAT_S:g} s at maximum rate, closing "
        f"included, {len(first['cpu'])} of {PACED_S:g} s at 1 kHz, {len(first['lost_s'])} kills "
        f"per tool; an fsync of 4 kB takes {Spread.of(result['fsync_ms'])} ms here. All rows were "
        "read back by each tool's own reader and compared. *To system*: time after which rows "
        "survive a kill; *to medium*: a power failure. *Lost*: the call returned, but the row is "
        "missing. *Missing at the kill*: due by the clock and missing, including the wake-up "
        "delay. PyMeasure does not accept blocks. Not tested: Bluesky's Tiled writer, which needs "
        "a server and by default delays 10,000 events."
    )
    out.append("")
    best = best_peer(result)
    if best is not None:
        peer = ways[best]
        ratio, rows_ratio = (
            ratios(ways[k]["flat_hz"], peer["flat_hz"]) for k in ("pamrig-blocks", "pamrig")
        )
        cost, rows_cost = (
            ratios(peer["flat_cpu_us"], ways[k]["flat_cpu_us"]) for k in ("pamrig-blocks", "pamrig")
        )
        out += [
            "At equal durability (to the system within 50 ms, to the medium within 1 s) the best "
            f"other tool is {WAYS[best].title}. With blocks of 50, as drivers deliver them, "
            f"pamrig records **{ratio}** times as many rows per second, row by row {rows_ratio} "
            f"times. The other tool needs {cost} times the processor time per row, row by row "
            f"{rows_cost} times.",
            "",
            losses(ways),
            "",
        ]
        out += behind(ways)
    return out


def behind(ways: dict[str, Any]) -> list[str]:
    """Peers that take less processor time at 1 kHz than pamrig fed alike."""
    cpu = {k: Spread.of(f["cpu"]).median for k, f in ways.items()}
    less = [
        f"{WAYS[k].title} ({short(100 * share)} %)"
        for k, share in cpu.items()
        if WAYS[k].tool != "pamrig" and share < cpu[WAYS[k].like]
    ]
    if not less:
        return ["No other tool with the same input needs less processor time at 1 kHz.", ""]
    return [f"Less processor time than pamrig at 1 kHz: {', '.join(less)}.", ""]


if __name__ == "__main__":
    found = measure()
    print("\n".join(lines(found)))
