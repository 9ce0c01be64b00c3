"""The parts of the test: which jobs they are, what is kept of them, and their limits."""

from __future__ import annotations

import concurrent.futures
import hashlib
import json
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from valvefw import config, core, wire
from valvefw.safety import _LIMITS
from valvefw.schemes.scheme import HOLD_US

from . import image, node

FULL_SECONDS = 60.0  # of each scheme
FULL_TRIALS = 1000  # of each kind
SCHEMES = ("two", "duty_in", "duty", "slide", "ram", "pwm", "burst", "open", "idle")
INPUTS = ("set bridge 5", "set encoder_ms 20", "set second_ms 100", "set third_ms 100")
TRIALS = {  # kind: share of the trials asked for
    "over": 1.0,
    "silent": 1.0,
    "garbage": 0.03,
    "rail": 0.03,
    "constant": 0.03,
    "zero": 0.03,
    "hung": 0.03,
}
FEWEST_TRIALS = 8
CHUNK = 100  # trials of a job: what is lost where the test is stopped
WIDTHS_US = (5, 995, 2345, 12345)
PLACES = ("TICKS", "WANT_INLET", "RUNNING", "FAULTS")
HOOKS = {"gc_alloc", "gc_collect"}
SCRIPTS = Path(__file__).parent / "scripts"


@dataclass(frozen=True)
class Setting:
    """What is tested, and how much of it."""

    image: Path
    bootrom: Path
    elf: Path | None
    seconds: float
    trials: int
    work: Path


@dataclass(frozen=True)
class Job:
    """One emulated board; ``files`` is the name of its file system."""

    name: str
    part: str
    files: str
    words: dict[str, Any]


def jobs(setting: Setting, wanted: Iterable[str]) -> list[Job]:
    """The jobs of the parts asked for; no part asked for is all of them.

    Raises:
        Unusable: there is no such part.
    """
    every = _every(setting)
    chosen: list[Job] = []
    for name in wanted:
        some = [j for j in every if name in (j.part, j.name, j.name.rpartition(":")[0])]
        if not some:
            parts = sorted({j.part for j in every})
            raise image.Unusable(f"no part {name}; parts are {', '.join(parts)}")
        chosen += [j for j in some if j not in chosen]
    return chosen or every


def _every(setting: Setting) -> list[Job]:
    out = [
        Job(
            f"schemes:{scheme}",
            "schemes",
            "firmware",
            {"kind": "scheme", "scheme": scheme, "seconds": setting.seconds},
        )
        for scheme in SCHEMES
    ]
    out += [
        Job(
            f"inputs:{scheme}",
            "inputs",
            "firmware",
            {"kind": "scheme", "scheme": scheme, "seconds": setting.seconds, "inputs": INPUTS},
        )
        for scheme in ("pwm", "burst")
    ]
    repeats = max(2, min(20, setting.trials // 10))
    spans = max(2, min(20, round(setting.seconds)))
    words: dict[str, Any] = {"kind": "pulses", "widths": WIDTHS_US, "repeats": repeats, "seed": 1}
    out.append(Job("pulses", "pulses", "firmware", words))
    words = {"kind": "memory", "schemes": SCHEMES, "spans": spans}
    out.append(Job("memory", "memory", "memory", words))
    out.append(
        Job("inputs:memory", "inputs", "memory", {**words, "schemes": ("burst",), "inputs": INPUTS})
    )
    for kind, share in TRIALS.items():
        number = max(min(FEWEST_TRIALS, setting.trials), round(setting.trials * share))
        for first in range(0, number, CHUNK):
            words = {
                "kind": "trials",
                "trial": kind,
                "first": first,
                "trials": min(CHUNK, number - first),
                "seed": first + 1000 * list(TRIALS).index(kind),
            }
            out.append(Job(f"trials:{kind}:{first}", "trials", "firmware", words))
    out += [
        Job(f"conformance:{k}", "conformance", "desk", {"kind": "desk", "share": k})
        for k in range(CONFORMANCE_JOBS)
    ]
    return out


CONFORMANCE_JOBS = 2  # the campaign, and the suite


def filesystems(work: Path) -> dict[str, Path]:
    """Write the file systems: the firmware as installed, and with a script in place of main.py.

    Raises:
        Unusable: a package is missing.
    """
    files = image.firmware()
    contents = {"firmware": files}
    for name in ("memory", "desk"):
        contents[name] = {**files, "main.py": (SCRIPTS / f"{name}.py").read_bytes()}
    contents["desk"]["valvefw/deskboard.mpy"] = image.compiled("deskboard.py")
    paths = {}
    for name, content in contents.items():
        paths[name] = work / f"{name}.lfs"
        made = image.filesystem(content)
        if not paths[name].exists() or paths[name].read_bytes() != made:
            paths[name].write_bytes(made)
    return paths


def common(setting: Setting, board: image.Image) -> dict[str, Any]:
    """What every job needs: the chip's contents, and where the core's state shows what."""
    path = setting.work / "image.bin"
    path.write_bytes(board.content)
    values = config.defaults()
    words: dict[str, Any] = {
        "image": str(path),
        "bootrom": str(setting.bootrom),
        "filesystemAt": image.FILES_AT,
        "limits": {place: values[key] * factor for key, place, factor in _LIMITS},
        "words": core.WORDS,
        "places": {name: getattr(core, name) for name in PLACES},
        "hold_us": HOLD_US,
        "guarded": wire.GUARDED,
    }
    if setting.elf is not None:
        words["symbols"] = image.symbols(setting.elf, HOOKS)
    return words


def run(
    setting: Setting,
    wanted: Iterable[str],
    processes: int,
    again: bool,
    tell: Callable[[str], None],
) -> dict[str, dict[str, Any]]:
    """Run the jobs that have no result of the same board yet; results by name.

    Raises:
        Unusable: a file or a package is missing.
    """
    chosen = jobs(setting, wanted)
    setting.work.mkdir(parents=True, exist_ok=True)
    node.install()
    base = common(setting, image.read_image(setting.image))
    image.read_bootrom(setting.bootrom)
    paths = filesystems(setting.work)
    shares: list[list[dict[str, Any]]] = []
    if any(job.part == "conformance" for job in chosen):
        from .conversations import recorded

        shares = recorded(CONFORMANCE_JOBS)
    results: dict[str, dict[str, Any]] = {}
    todo: list[tuple[Job, dict[str, Any], str]] = []
    for job in chosen:
        words = {**base, **job.words, "filesystem": str(paths[job.files])}
        if job.part == "conformance":
            words["conversations"] = shares[job.words["share"]]
        key = _key(words, base, paths[job.files])
        kept = _kept(setting.work / f"{_file(job.name)}.json", key)
        if kept is not None and not again:
            results[job.name] = kept
        else:
            todo.append((job, words, key))
    if results:
        tell(f"{len(results)} of {len(chosen)} kept from an earlier run")

    def one(job: Job, words: dict[str, Any], key: str) -> tuple[str, dict[str, Any]]:
        began = time.monotonic()
        tell(f"{job.name} ...")
        try:
            result = node.run(words, lambda line: tell(f"{job.name}: {line}"))
        except RuntimeError as error:
            result = {"crashed": str(error)}
        else:
            path = setting.work / f"{_file(job.name)}.json"
            path.write_text(json.dumps({"key": key, "result": result}))
        tell(f"{job.name}: {result.get('crashed', 'done')}, {time.monotonic() - began:.0f} s")
        return job.name, result

    with concurrent.futures.ThreadPoolExecutor(processes) as pool:
        running = [pool.submit(one, *what) for what in todo]
        try:
            for done in concurrent.futures.as_completed(running):
                name, result = done.result()
                results[name] = result
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            node.stop_all()
            raise
    return {job.name: results[job.name] for job in chosen}


def _file(name: str) -> str:
    return name.replace(":", "-")


def _key(words: dict[str, Any], base: dict[str, Any], filesystem: Path) -> str:
    """The same for the same board, files, emulator and job."""
    made = hashlib.sha256(json.dumps(words, sort_keys=True).encode())
    for path in (Path(base["image"]), Path(base["bootrom"]), filesystem):
        made.update(path.read_bytes())
    for path in sorted((node.HERE / "chip").glob("*.mjs")):
        made.update(path.read_bytes())
    return made.hexdigest()


def _kept(path: Path, key: str) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        kept = json.loads(path.read_text())
    except ValueError:  # stopped while it was written
        return None
    result: dict[str, Any] = kept["result"]
    return result if kept["key"] == key else None
