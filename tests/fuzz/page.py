"""The page of a fuzzing campaign, from its journals."""

from __future__ import annotations

import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests import campaign_page

from .guard import HANG_S, HOUSE, MORE_MB
from .shares import SHARES

HEAD = """\
# Fuzzing of inputs

`make fuzz` (`python -m tests.fuzz --page docs/evidence/fuzz.md`) writes this page. Everything that
reads bytes from an instrument, a file or a folder of unknown origin gets mutated valid inputs. An
input that takes a new branch is kept and mutated further (`tests/fuzz/cover.py` marks the branches,
so every input is monitored). Half of the inputs in a format with checksums get valid ones, so that
they reach the code behind the check. Each target runs in its own process. A *finding* is an
exception that is not the documented error, the end of the process, more than {hang:g} s of
processor time for one input, or more than {more:g} MB above the memory that the valid inputs took.
"""


def page(totals: list[dict[str, Any]], seed: int) -> str:
    """The whole text but for what was written by hand."""
    count = sum(t["inputs"] for t in totals)
    found = sum(len(t["found"]) for t in totals)
    seconds = sum(t["seconds"] for t in totals)
    names = ("numpy", "numba", "pandas", "pyarrow", "opencv-python-headless")
    versions = ", ".join(f"{n} {version(n)}" for n in names)
    out = [
        HEAD.format(hang=HANG_S, more=MORE_MB),
        f"**{count:,} inputs, {found} finding{'' if found == 1 else 's'}**;"
        f" {datetime.now(UTC):%Y-%m-%d}, seed {seed}, "
        f"{seconds / 60:.0f} min on one core; revision {_revision()}, Python "
        f"{platform.python_version()}, {versions}, {platform.system()}.\n",
        "| Target | Reads | Inputs | Refused | Kept | Branches | us per input | Slowest, s | "
        "MB more | Findings |",
        "|--|--|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for t in totals:
        each = 1e6 * t["seconds"] / t["inputs"] if t["inputs"] else 0.0
        refused = t["refused"] / t["inputs"] if t["inputs"] else 0.0
        out.append(
            f"| {t['name']} | {t['reads']} | {t['inputs']:,} | {refused:.0%} | {t['kept']:,} | "
            f"{t['branches']:,} | {each:.0f} | {t['slowest_s']:.2f} | {max(t['more_mb'], 0):.0f} | "
            f"{len(t['found'])} |"
        )
    out += [
        "",
        "*Refused*: rejected with the documented error. The others were read, or were bytes on a "
        "line that are not a message and are skipped. *Kept*: inputs that took a new branch. "
        "*Branches*: taken in the marked modules, including start-up. *MB more*: growth of the "
        "peak resident size after the valid inputs.",
    ]
    if len(totals) < len(SHARES):
        missing = [n for n in SHARES if n not in {t["name"] for t in totals}]
        out += ["", f"Not run: {', '.join(missing)}."]
    if found:
        out += ["", "Findings:", ""]
        out += [f"- {t['name']}: {what}" for t in totals for what in t["found"]]
    return "\n".join(out) + "\n"


def write_page(totals: list[dict[str, Any]], seed: int, path: Path) -> None:
    """Replace what the command makes; what stands below the mark stays."""
    campaign_page.write_page(path, page(totals, seed))


def _revision() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"],
        cwd=HOUSE, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.stdout.strip() or "unknown"
