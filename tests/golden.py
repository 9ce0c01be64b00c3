"""Golden outputs: what the program says today, to be held against what it says after a change.

`python -m tests.golden make FOLDER` runs short tests on the virtual benches, the thesis's tables
and practice sets of the blind bench through the command line alone, and keeps of each item what
came out, without paths, run ids, dates and the like. A stopped `make` goes on where it ended; what
was made by other sources is made anew. `compare OLD NEW` holds folders or packed files of outputs
against each other, `compare NEW` against `tests/golden.json.gz`, key by key, and ends with status 1
where they differ. `pack FOLDER` writes `tests/golden.json.gz`.

A processor of another kind gives other last digits, and a search may then end at another
explanation. To see what a change does, make OLD on the same computer by the sources before it.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from llvmlite.binding import get_host_cpu_name

ROOT = Path(__file__).resolve().parent.parent
PACKED = ROOT / "tests" / "golden.json.gz"
DIGITS = 13
LONG = 200  # numbers in a list beyond which only some of them and what they amount to are kept
PICKED = 40
PROCESSOR = "processor"
"""Key in a packed file, beside the items: the kind of processor that they were made on."""

FIXED = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "PYTHONHASHSEED": "0",
}
"""How a sum is split among threads decides its last digit, and that which of two equals leads."""

FORGOTTEN = re.compile(
    r"(run_id|boot|boots|(\w+_)?utc|(\w+_)?host_ns|monotonic_ns|start_s|elapsed\w*|wall\w*"
    r"|processor\w*|times_real_time|seal|pamrig|version|versions|software|revision|platform|python|crc(32)?|(\w+_)?sha256|bytes"
    r"|digest)"
)
"""Keys that differ from run to run, or from version to version, whatever the program does."""

SPEED = re.compile(r"\b[\d.]+ times real time")
RUN_ID = re.compile(r"\d{8}T\d{6}Z_[\w-]+")
DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?( UTC)?")


# -- what is made --------------------------------------------------------------------------------


class Desk:
    """A scratch folder in which commands are given, and from which their output is read."""

    def __init__(self, folder: Path, shelf: Path) -> None:
        self.folder, self.shelf = folder, shelf

    def pamrig(self, *words: str) -> Any:
        """What `pamrig WORDS --json` prints, and its exit status where that is not 0."""
        done = self._pamrig(*words, "--json")
        value = json.loads(done.stdout) if done.stdout.strip() else {"said": done.stderr}
        return {"status": done.returncode, "value": value} if done.returncode else value

    def practice(self, number: int) -> list[str]:
        """Lay a practice set into the folder `set`; which effects are struck from its catalogue.

        Sets are kept on the shelf: they change with the blind bench alone.
        """
        kept = self.shelf / f"{number}-{digest_of([ROOT / 'blind'])[:12]}"
        if not kept.exists():
            done = self._run("-m", "blind", "make", "--practice", str(number), "--out", "set")
            if done.returncode:
                raise RuntimeError(done.stderr)
            struck = self.folder / "set" / "without.json"
            struck.write_text(json.dumps(json.loads(done.stdout)["without"]), encoding="utf-8")
            self.shelf.mkdir(parents=True, exist_ok=True)
            (self.folder / "set").replace(kept)
        shutil.copytree(kept, self.folder / "set")
        struck = self.folder / "set" / "without.json"
        names = list(json.loads(struck.read_text(encoding="utf-8")))
        struck.unlink()
        return names

    def run(self, command: str, *words: str) -> dict[str, Any]:
        """Make a run: its report as JSON, its table, and what its samples amount to."""
        before = self.runs()
        done = self._pamrig(*command.split(), *words, "--out", "runs")
        new = [folder for folder in self.runs() if folder not in before]
        out: dict[str, Any] = {"status": done.returncode, "runs": len(new)}
        if not new:
            return {**out, "said": done.stderr}
        derived = new[0] / "derived"
        out["report"] = self.pamrig("report", str(new[0]))
        if (derived / "table.csv").exists():
            out["table"] = columns(pd.read_csv(derived / "table.csv"))
        if (derived / "samples.parquet").exists():
            out["samples"] = columns(pd.read_parquet(derived / "samples.parquet"))
        return out

    def runs(self) -> list[Path]:
        """The runs made here, oldest first."""
        return sorted(path.parent for path in (self.folder / "runs").glob("*/run.json"))

    def _pamrig(self, *words: str) -> subprocess.CompletedProcess[str]:
        with (ROOT / "pyproject.toml").open("rb") as file:
            module, _, function = tomllib.load(file)["project"]["scripts"]["pamrig"].partition(":")
        program = f"import sys; sys.argv[0] = 'pamrig'; from {module} import {function} as f; f()"
        return self._run("-c", program, *words)

    def _run(self, *words: str) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        around = {**os.environ, **FIXED, "PYTHONPATH": path}
        return subprocess.run(
            [sys.executable, *words], cwd=self.folder, env=around,
            capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip


@dataclass(frozen=True)
class Item:
    """Something to make: how, and to how many relative parts its numbers are compared."""

    make: Callable[[Desk], Any]
    verdict: bool = False


def columns(table: pd.DataFrame) -> dict[str, list[Any]]:
    """A table as JSON, column by column."""
    return {
        str(name): [None if pd.isna(value) else value for value in table[name].tolist()]
        for name in table
    }


def recorded(command: str) -> Item:
    """A command that makes a run."""
    return Item(lambda desk: desk.run(command))


def short(protocol: str, rig: str = "") -> Item:
    """The short template of a protocol on a virtual rig, the default one where none is named."""
    words = ["--rig", rig] if rig else []
    return Item(lambda desk: desk.run(protocol, "--protocol", f"{protocol}-short", *words))


def asked(command: str, verdict: bool = False) -> Item:
    """A command that prints JSON."""
    return Item(lambda desk: desk.pamrig(*command.split()), verdict)


def diagnosed(number: int, further: tuple[str, ...] = ()) -> Item:
    """A practice set of the blind bench and what the diagnosis says of it."""

    def make(desk: Desk) -> Any:
        struck = desk.practice(number)
        words = ["--without", ",".join(struck)] if struck else []
        return {w: desk.pamrig("gap", w, "set", *words) for w in ("diagnose", *further)}

    return Item(make, verdict=True)


def exported(protocol: str) -> Item:
    """A short test on four benches written as one data set, and the diagnosis of that."""

    def make(desk: Desk) -> Any:
        for seed in range(1, 5):
            words = ("--protocol", f"{protocol}-short", "--seed", str(seed), "--out", "runs")
            desk.pamrig(protocol, *words)
        runs = [str(folder) for folder in desk.runs()]
        said = desk.pamrig("gap", "export", *runs, "--out", "set")
        trials = columns(pd.read_csv(desk.folder / "set" / "trials.csv"))
        return {
            "export": said, "trials": trials, "diagnose": desk.pamrig("gap", "diagnose", "set"),
        }  # fmt: skip

    return Item(make, verdict=True)


MUSCLE = ("isometric", "isobaric", "isotonic", "hysteresis")
OTHER = ("isothermal", "switching-time", "switching-voltage", "flow", "step", "ram")
TABLES = ("c01", "c02", "c03", "c04", "c06", "d01", "d04", "d05")
PRACTICE = range(9100, 9140)
FURTHER = (9100, 9107, 9114, 9121, 9128, 9135)


SCENARIOS = ("spring-return", "held-steps", "hung-two-position", "antagonists", "finger", "ram")
SAID: dict[str, tuple[str, bool]] = {
    "fit": ("fit c01 --model black-box", False),
    "fit-robust": ("fit c03 --model sarosi --robust", True),
    "models": ("models list", False),
    "models-compare": ("models compare c01", True),
    "models-audit": ("models audit-thesis", True),
    "effects": ("gap effects", False),
    "study-delay": ("study delay", False),
}
"""Commands that need nothing: words, and whether an optimiser had a hand in their numbers."""


def items() -> dict[str, Item]:
    """Everything there is to make, by name; a name begins with its kind."""
    out = {f"test/{name}": short(name) for name in MUSCLE + OTHER}
    out |= {f"test/{name}@virtual-thesis": short(name, "virtual-thesis") for name in MUSCLE}
    out |= {f"thesis/{name}": recorded(f"import thesis {name}") for name in TABLES}
    out |= {f"said/{name}": asked(*said) for name, said in SAID.items()}
    out |= {f"simulated/{name}": recorded(f"simulate {name}") for name in SCENARIOS}
    out["thesis/gap"] = asked("gap thesis", verdict=True)
    out["exported/static"] = exported("isometric")
    out["exported/loop"] = exported("step")
    for number in PRACTICE:
        further = ("where", "shrink", "next") if number in FURTHER else ()
        out[f"blind/{number}"] = diagnosed(number, further)
    return out


# -- what is kept of it --------------------------------------------------------------------------


def kept(value: Any, folder: Path) -> Any:
    """A JSON value without what differs from run to run; numbers rounded, long lists shortened."""
    if isinstance(value, dict):
        return {
            kept(str(key), folder): kept(inner, folder)
            for key, inner in value.items()
            if not FORGOTTEN.fullmatch(str(key))
        }
    if isinstance(value, list):
        if len(value) > LONG and all(number(inner) or inner is None for inner in value):
            return shortened(value)
        return [kept(inner, folder) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else str(value)
    if isinstance(value, str):
        for path, name in ((folder.resolve(), "DESK"), (ROOT, "ROOT")):
            value = value.replace(str(path), name)
        return SPEED.sub("SPEED", DATE.sub("DATE", RUN_ID.sub("RUN", value)))
    return value


def number(value: Any) -> bool:
    """A number, which a truth value is not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def shortened(values: list[float | None]) -> list[Any]:
    """How many numbers, how many of them missing, their mean and rms, and some of them."""
    there = [float(value) for value in values if value is not None]
    count = max(len(there), 1)
    amounts = [math.fsum(there) / count, math.sqrt(math.fsum(v * v for v in there) / count)]
    step = (len(values) - 1) / (PICKED - 1)
    picked = [values[round(step * index)] for index in range(PICKED)]
    return [
        {"of": len(values), "missing": len(values) - len(there)},
        *(value if value is None else float(f"{value:.{DIGITS}g}") for value in amounts + picked),
    ]


def sources() -> str:
    """A digest of all that may change an output: the packages, and what this file makes of them."""
    here = Path(__file__).read_text(encoding="utf-8").partition("# -- how two")[0]
    packages = sorted(path.parent for path in ROOT.glob("*/__init__.py"))
    held = digest_of([path for path in packages if path.name not in ("tests", "benchmarks")])
    return hashlib.sha256((here + held).encode()).hexdigest()


def digest_of(folders: list[Path]) -> str:
    """A digest of the programs, settings and numbers in folders."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in folder.rglob("*")):
        if path.suffix in (".py", ".toml", ".csv", ".npz"):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def make(folder: Path, names: list[str], jobs: int) -> int:
    """Make items in a folder, those that are there by the same sources excepted.

    What an item could not be made for is said, and the others are made; how many could not be.
    """
    stamp = sources()
    chosen = items()
    todo = [name for name in names if not made(folder, name, stamp)]
    print(f"{len(names) - len(todo)} of {len(names)} are there", flush=True)

    def one(name: str) -> str:
        began = time.monotonic()
        desk = (folder / "desk" / name).resolve()  # commands run in it
        shutil.rmtree(desk, ignore_errors=True)
        desk.mkdir(parents=True)
        try:
            value = kept(chosen[name].make(Desk(desk, (folder / "sets").resolve())), desk)
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            return f"{name} FAILED: {error}"
        path = folder / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".part")
        unfinished.write_text(json.dumps({"sources": stamp, "value": value}), encoding="utf-8")
        unfinished.replace(path)
        shutil.rmtree(desk)
        return f"{name}: {time.monotonic() - began:.0f} s"

    failed = 0
    with ThreadPoolExecutor(jobs) as pool:
        for count, said in enumerate(pool.map(one, todo), start=1):
            failed += "FAILED" in said
            print(f"{count}/{len(todo)} {said}", flush=True)
    return failed


def made(folder: Path, name: str, stamp: str) -> bool:
    """Whether an item is there, by these sources."""
    path = folder / f"{name}.json"
    return path.exists() and json.loads(path.read_text(encoding="utf-8"))["sources"] == stamp


def outputs(place: Path) -> dict[str, Any]:
    """All items of a packed file, or those of a folder that were made by the last sources."""
    if place.is_file():
        return {name: item for name, item in packed(place).items() if name != PROCESSOR}
    paths = sorted(place.glob("*/*.json"), key=lambda path: path.stat().st_mtime_ns)
    found = {path.relative_to(place).with_suffix("").as_posix(): json.loads(path.read_text("utf-8"))
             for path in paths}  # fmt: skip
    last = next(reversed(found.values()), {"sources": ""})["sources"]
    stale = [name for name, item in found.items() if item["sources"] != last]
    if stale:
        print(f"{place.name}: left out, since made by older sources: {', '.join(sorted(stale))}")
    return {name: found[name]["value"] for name in sorted(found) if name not in stale}


def packed(file: Path) -> dict[str, Any]:
    """What a packed file holds."""
    return dict(json.loads(gzip.decompress(file.read_bytes())))


def made_on(place: Path) -> str:
    """The kind of processor that a packed file was made on; of a folder that of this computer."""
    return str(packed(place).get(PROCESSOR, "")) if place.is_file() else get_host_cpu_name()


def pack(folder: Path, target: Path) -> None:
    """Write all items of a folder as one file, the same bytes for the same items.

    Nothing of a folder says where it was made: it is packed on the computer that made it.
    """
    items = outputs(folder) | {PROCESSOR: made_on(folder)}
    text = json.dumps(items, separators=(",", ":"), sort_keys=True, ensure_ascii=False)
    target.write_bytes(gzip.compress(text.encode(), 9, mtime=0))
    print(f"{target.name}: {target.stat().st_size / 1e3:.0f} kB")


# -- how two of them are compared ----------------------------------------------------------------


@dataclass(frozen=True)
class Measure:
    """How closely numbers have to agree, and whether sentences have to."""

    relative: float
    allow_text: bool = False

    def differences(self, old: Any, new: Any) -> Iterator[tuple[str, Any, Any]]:
        """Key, old and new value of all that differs.

        A number near zero is held against the largest one under the same key: a thousandth of
        the relative part of that is no difference.
        """
        largest: dict[str, float] = {}
        for value in (old, new):
            for key, size in sizes(value, ""):
                largest[key] = max(largest.get(key, 0.0), size)
        yield from self._walk(old, new, "", "", largest)

    def _walk(
        self, old: Any, new: Any, where: str, key: str, largest: dict[str, float]
    ) -> Iterator[tuple[str, Any, Any]]:
        if isinstance(old, dict) and isinstance(new, dict):
            for name in list(old) + [name for name in new if name not in old]:
                inner = f"{where}.{name}" if where else name
                if name not in old or name not in new:
                    yield inner, old.get(name, "(nothing)"), new.get(name, "(nothing)")
                else:
                    yield from self._walk(old[name], new[name], inner, name, largest)
        elif isinstance(old, list) and isinstance(new, list):
            if len(old) != len(new):
                yield f"{where}.length", len(old), len(new)
            for index, pair in enumerate(zip(old, new, strict=False)):
                yield from self._walk(*pair, f"{where}[{index}]", key, largest)
        elif number(old) and number(new):
            close = self.relative * max(abs(old), abs(new), 1e-3 * largest[key])
            whole = isinstance(old, int) and isinstance(new, int)
            if old != new if whole else abs(old - new) > close:
                yield where, old, new
        elif self.allow_text and text(old) and text(new):
            return
        elif old != new or isinstance(old, bool) is not isinstance(new, bool):
            yield where, old, new


def sizes(value: Any, key: str) -> Iterator[tuple[str, float]]:
    """Size of each number, with the key it stands under."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from sizes(inner, name)
    elif isinstance(value, list):
        for inner in value:
            yield from sizes(inner, key)
    elif number(value):
        yield key, abs(value)


def text(value: Any) -> bool:
    """Free text: a string of several words, as no id and no cell of numbers is."""
    words = value.split() if isinstance(value, str) else []
    return sum(bool(re.fullmatch(r"\(?[^\W\d_]{2,}[.,;:)]*", word)) for word in words) > 1


def compare(
    old: Path, new: Path, names: list[str], rel: tuple[float, float], allow_text: bool, most: int
) -> int:
    """Print every difference; 1 if there is any, else 0. What only NEW has is none."""
    before, after = outputs(old), outputs(new)
    chosen = items()
    count = differing = compared = 0
    for name in names:
        if name not in before:
            print(f"{name}: not in {old.name}, so nothing to hold it against")
            continue
        if name not in after:
            print(f"{name}: not in {new.name}")
            differing += 1
            continue
        compared += 1
        verdict = name in chosen and chosen[name].verdict
        measure = Measure(rel[1] if verdict else rel[0], allow_text)
        found = list(measure.differences(before[name], after[name]))
        for where, one, other in found[:most]:
            print(f"{name}  {where}  {shown(one)} -> {shown(other)}")
        if len(found) > most:
            print(f"{name}  and {len(found) - most} more")
        count += len(found)
        differing += bool(found)
    print(f"{compared} items compared, {differing} differ, in {count} places")
    if differing and made_on(old) != made_on(new):
        print(
            f"{old.name} was made on another processor ({made_on(old) or 'not said'}) than"
            f" {new.name} ({made_on(new)}): last digits differ, and with them what a search decides"
        )
    return 1 if differing else 0


def shown(value: Any) -> str:
    """A value on part of a line."""
    out = json.dumps(value, ensure_ascii=False)
    return out if len(out) <= 120 else out[:117] + "..."


def among(wanted: list[str], names: list[str]) -> list[str]:
    """The names that are wanted, or begin with what is; all where nothing is."""
    chosen = [name for name in names if not wanted or name.startswith(tuple(wanted))]
    if not chosen:
        raise SystemExit(f"no item begins with {', '.join(wanted)}: there are {', '.join(names)}")
    return chosen


def main(arguments: list[str] | None = None) -> int:
    """Make, pack or compare."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.golden", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make", help="make the outputs in a folder")
    making.add_argument("folder", type=Path)
    making.add_argument("--jobs", type=int, default=1, help="items at a time")
    packing = commands.add_parser("pack", help="write a folder's outputs as one file")
    packing.add_argument("folder", type=Path)
    packing.add_argument("--to", type=Path, default=PACKED)
    comparing = commands.add_parser("compare", help="list every difference")
    comparing.add_argument("places", type=Path, nargs="+", help="[OLD] NEW: folders or files")
    comparing.add_argument("--rel-table", type=float, default=1e-9, help="tables and reports")
    comparing.add_argument("--rel-verdict", type=float, default=1e-6, help="diagnoses")
    comparing.add_argument("--allow-text", action="store_true", help="sentences may differ")
    comparing.add_argument("--most", type=int, default=20, help="differences listed an item")
    for command in (making, comparing):
        command.add_argument("--only", nargs="+", default=[], help="beginnings of items' names")
    given = parser.parse_args(arguments)
    if given.command == "make":
        return min(1, make(given.folder, among(given.only, list(items())), given.jobs))
    if given.command == "pack":
        pack(given.folder, given.to)
        return 0
    old, new = given.places if len(given.places) > 1 else (PACKED, given.places[0])
    names = among(given.only, sorted({*outputs(old), *outputs(new)}))
    rel = (given.rel_table, given.rel_verdict)
    return compare(old, new, names, rel, given.allow_text, given.most)


if __name__ == "__main__":
    sys.exit(main())
