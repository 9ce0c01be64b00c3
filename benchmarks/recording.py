"""1 kHz x 8 channels recorded durably: pamrig, PyMeasure, QCoDeS, Bluesky, each by its own means.

    python -m benchmarks recording

Every tool runs in a process of its own (``benchmarks/recorders``) and gets the same numbers. *Flat
out*: a second of feeding as fast as the tool takes it, closing included; rounds take turns. *At
1 kHz*: processor time while rows come one by one (in blocks of 50 to the ways that take blocks).
*Killed*: SIGKILL at a random moment while 1 kHz comes in; what the tool's own reader finds is
counted against the clock, so that lateness counts as loss too. `PAMRIG_BENCH_PYTHON` names another
Python that has the peers, where they are not to stand beside pamrig's own packages.
"""

from __future__ import annotations

import json
import math
import os
import random
import signal
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


WAYS = {
    "pamrig": Way("pamrig", "pamrig", "each row", "1 s", {"frame": 1}, EQUAL),
    "pamrig-frames": Way(
        "pamrig", "pamrig, frames of 10 as its controller sends", "10 ms", "1 s", {"frame": 10}
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
        {"arrays": True, "write_period_s": 1.0},
    ),
    "qcodes-50ms": Way(
        "qcodes", "QCoDeS, arrays of 50, write period 50 ms", "50 ms", "50 ms",
        {"arrays": True, "write_period_s": 0.05}, EQUAL,
    ),
    "bluesky": Way(
        "bluesky", "Bluesky, events (default)", "each row", "never",
        {"pages": False, "fsync": False},
    ),
    "bluesky-pages": Way(
        "bluesky", "Bluesky, pages of 50, fsync added", "50 ms", "1 s",
        {"pages": True, "fsync": True}, EQUAL,
    ),
}  # fmt: skip
FLAT_ONLY_ONCE = "pamrig-frames"  # flat out it is the same as pamrig


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

    def kill(self) -> int:
        """SIGKILL; the monotonic time of it in ns."""
        killed_ns = time.monotonic_ns()
        self.process.send_signal(signal.SIGKILL)
        self.close()
        return killed_ns

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


def killed(way: Way, folder: Path, after_s: float) -> Path:
    """One recording killed ``after_s`` after its first row; writes when that was."""
    recorder = Recorder(way.tool)
    folder.mkdir()
    recorder.begin({**way.setting, "mode": "paced", "folder": str(folder), "seconds": 60.0})
    end = time.monotonic() + START_S
    while not (folder / "started").exists():
        if time.monotonic() > end or recorder.process.poll() is not None:
            raise RuntimeError(f"{way.title} did not begin")
        time.sleep(0.01)
    begin_ns = int((folder / "started").read_text())
    time.sleep(max(0.0, begin_ns * 1e-9 + after_s - time.monotonic()))
    came = (recorder.kill() - begin_ns) * 1e-9 * RATE_HZ
    (folder / "came").write_text(str(came))
    return folder


def measure(tiny: bool = False) -> dict[str, Any]:
    """Rates, processor time and losses of every way that can run here."""
    count, seconds, paced_s, kills = (1, 0.2, 0.3, 1) if tiny else (5, 1.0, 4.0, 6)
    missing = available()
    ways = {k: w for k, w in WAYS.items() if not missing[w.tool]}
    rng = random.Random(9)
    out: dict[str, Any] = {"missing": {t: why for t, why in missing.items() if why}, "ways": {}}
    with tempfile.TemporaryDirectory() as root:
        place = Path(root)
        out["fsync_ms"] = sync_ms(place, 5 if tiny else 50)
        recorders = {tool: Recorder(tool) for tool, why in missing.items() if not why}
        out["versions"] = {tool: r.version for tool, r in recorders.items()}

        def once(key: str, mode: str, number: int, seconds: float) -> dict[str, Any]:
            folder = place / f"{key}-{mode}-{number}"
            folder.mkdir()
            job = {**ways[key].setting, "folder": str(folder), "seconds": seconds}
            found = recorders[ways[key].tool].ask({**job, "mode": mode})
            back = recorders[ways[key].tool].ask({**job, "mode": "read"})
            if back != {"rows": found["rows"], "wrong": 0}:
                raise RuntimeError(f"{ways[key].title}: gave {found['rows']} rows, read {back}")
            return found

        found: dict[str, dict[str, list[float]]] = {
            k: {"flat_hz": [], "flat_cpu_us": [], "cpu": [], "wall": [], "lost_s": []} for k in ways
        }
        for number in range(-1, count):  # the first round only warms up
            for key in ways:
                if key == FLAT_ONLY_ONCE:
                    continue
                flat = once(key, "flat", number, seconds if number >= 0 else 0.2)
                if number >= 0:
                    found[key]["flat_hz"].append(flat["rows"] / flat["wall_s"])
                    found[key]["flat_cpu_us"].append(flat["cpu_s"] / flat["rows"] * 1e6)
        for number in range(1 if tiny else 3):
            for key in ways:
                paced = once(key, "paced", number, paced_s)
                found[key]["cpu"].append(paced["cpu_s"] / paced_s)
                found[key]["wall"].append(paced["wall_s"] / paced_s)
        for number in range(kills):
            for key, way in ways.items():
                longest = 0.5 if tiny else 7.0 if key == "qcodes" else 3.0
                folder = killed(way, place / f"{key}-kill-{number}", rng.uniform(0.3, longest))
                job = {**way.setting, "mode": "read", "folder": str(folder)}
                back = recorders[way.tool].ask(job)
                if back["wrong"]:
                    raise RuntimeError(f"{way.title}: {back['wrong']} rows are wrong after a kill")
                came = float((folder / "came").read_text())
                lost = max(0, math.floor(came) - back["rows"])  # whole rows that were due
                found[key]["lost_s"].append(lost / RATE_HZ)
        for recorder in recorders.values():
            recorder.close()
    out["ways"] = found
    return out


def best_peer(result: dict[str, Any]) -> str | None:
    """The peer's way of equal durability that pamrig's rate exceeds least."""
    ways = result["ways"]
    times = {
        k: ratios(ways["pamrig"]["flat_hz"], v["flat_hz"]).median
        for k, v in ways.items()
        if WAYS[k].tool != "pamrig" and WAYS[k].level == EQUAL
    }
    return min(times, key=lambda k: times[k]) if times else None


def lost_ms(found: dict[str, list[float]]) -> Spread:
    """Rows lost at each kill as ms of data."""
    return Spread.of([round(1e3 * s) for s in found["lost_s"]])


def losses(ways: dict[str, Any]) -> str:
    """What a kill cost pamrig, and every peer that lost less."""
    ours = lost_ms(ways["pamrig"])
    peers = {k: lost_ms(f) for k, f in ways.items() if WAYS[k].tool != "pamrig"}
    less = [
        f"{WAYS[k].title} ({p.median:.0f}, at most {p.high:.0f} ms)"
        for k, p in peers.items()
        if p.median < ours.median or p.high < ours.high
    ]
    told = f"Killed, pamrig lost {ours.median:.0f} ms ({ours.low:.0f} to {ours.high:.0f}). "
    if not less:
        return told + "No peer lost less, by median or by its worst."
    return f"{told}By median or by its worst, less was lost by {', '.join(less)}. A row is 1 ms."


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    ways = result["ways"]
    rows = []
    for key, found in ways.items():
        way = WAYS[key]
        flat = "" if not found["flat_hz"] else str(Spread.of(found["flat_hz"]))
        times = ""
        if found["flat_hz"] and key != "pamrig":
            times = str(ratios(ways["pamrig"]["flat_hz"], found["flat_hz"]))
        lost = lost_ms(found)
        rows.append([
            way.title, way.system, way.medium, flat, times,
            f"{short(100 * Spread.of(found['cpu']).median)} %",
            f"{lost.median:.0f} ({lost.low:.0f} to {lost.high:.0f})",
        ])  # fmt: skip
    for tool, why in result["missing"].items():
        rows.append([tool, "", "", why, "", "", ""])
    out = table(
        ["tool", "to system", "to medium", "rows/s flat out", "pamrig is ... times",
         "processor at 1 kHz", "lost at kill -9, ms"], rows,
    )  # fmt: skip
    count = len(ways["pamrig"]["flat_hz"])
    kills = len(ways["pamrig"]["lost_s"])
    out.append(
        f"Versions: {', '.join(result['versions'].values())}. A row is a number and eight 64-bit "
        f"channels; {count} rounds of 1 s flat out, {len(ways['pamrig']['cpu'])} of 4 s at 1 kHz, "
        f"{kills} kills a way; an fsync of 4 kB takes "
        f"{Spread.of(result['fsync_ms'])} ms here. All rows were read back by each tool's own "
        "reader and compared. *To system*: when rows survive a kill; *to medium*: a power cut. "
        "PyMeasure takes no blocks. Not tried: Bluesky's Tiled writer, which needs a "
        "server and holds 10,000 events back by default."
    )
    out.append("")
    best = best_peer(result)
    if best is not None:
        ratio = ratios(ways["pamrig"]["flat_hz"], ways[best]["flat_hz"])
        cost = ratios(ways[best]["flat_cpu_us"], ways["pamrig"]["flat_cpu_us"])
        out.append(
            f"At equal durability (to the system within 50 ms, to the medium within 1 s) the best "
            f"peer is {WAYS[best].title}; pamrig's rate is **{ratio}** times its, and a row takes "
            f"its processor {cost} times as long."
        )
        out += ["", losses(ways)]
        cpu = {k: Spread.of(f["cpu"]).median for k, f in ways.items()}
        ahead = [k for k in cpu if WAYS[k].tool != "pamrig" and cpu[k] < cpu["pamrig"]]
        if ahead:
            names = ", ".join(f"{WAYS[k].title} ({short(100 * cpu[k])} %)" for k in ahead)
            out.append("")
            out.append(
                f"Behind: with rows one by one, less processor time at 1 kHz is used by {names}: "
                "pamrig seals each row with a CRC and writes it a second time in its batch. "
                f"In frames of 10 it takes "
                f"{short(100 * cpu['pamrig-frames'])} %."
            )
        out.append("")
    return out


if __name__ == "__main__":
    found = measure()
    print("\n".join(lines(found)))
