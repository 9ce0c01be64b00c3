"""The page of all parts, from the figures that were kept."""

from __future__ import annotations

import importlib
import os
import platform
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

HOUSE = Path(__file__).resolve().parent.parent

PARTS = {
    "recording": "recording",
    "marker": "marker",
    "simulation": "simulation",
    "laws": "laws",
    "dynamics": "dynamics",
    "startup": "startup",
    "diagnosis": "gap.diagnosis",
    "growth_samples": "runs.samples",
    "growth_length": "runs.length",
    "growth_diagnosis": "gap.growth",
    "growth_rows": "gap.rows",
    "growth_cores": "gap.cores",
}
"""Parts of the page in their order, and the module of each below ``benchmarks``."""

HEAD = """\
# Benchmarks

Speed compared with other tools, and growth of the cost with size. This command writes the page:

    python -m benchmarks --page docs/evidence/benchmarks.md

(`make bench`); `--only PART` measures one part again. All figures of a part come from one run in
which the tools took turns. A ratio is other tool / pamrig, calculated per round: median (minimum
to maximum). The text states where pamrig is slower.
"""


def machine() -> str:
    """What the figures depend on; no name of it."""
    memory = ""
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        memory = f", {total / 2**30:.0f} GiB"
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores{memory}, "
        f"Python {platform.python_version()}, numpy {version('numpy')}, pamrig {version('pamrig')}"
    )


def revision() -> str:
    """Short name of the commit this is run from, + if files differ from it; "" outside git."""

    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", *words], cwd=HOUSE, capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    head = git("rev-parse", "--short=8", "HEAD")
    changed = git("status", "--porcelain", "--untracked-files=no", "--", "*.py")
    return head + ("+" if head and changed else "")


def page(parts: dict[str, dict[str, Any] | None]) -> str:
    """The whole text; a part without figures says so."""
    out = [HEAD]
    machines = list(dict.fromkeys(p["machine"] for p in parts.values() if p))
    out.append(f"Machine: {'; '.join(machines)}. Other programs sometimes ran at the same ")
    out[-1] += "time; the load at the end of each part is given below it.\n"
    for name, part in parts.items():
        module = importlib.import_module(f"benchmarks.{PARTS[name]}")
        out.append(f"## {module.TITLE}\n")
        if part is None:
            out.append(f"Not measured yet: `python -m benchmarks --only {name}`.\n")
            continue
        if part["tiny"]:
            out.append("**Sizes that show only that it runs; no figure here means anything.**\n")
        out.append("\n".join(module.lines(part["figures"])))
        at = f" at revision {part['revision']}" if part.get("revision") else ""
        load = "" if part["load"] is None else f", load {part['load']:.1f}"
        out.append(
            f"`{name}`, {part['date']}{at}: {part['wall_s']:.0f} s, {part['cpu_s']:.0f} s of "
            f"processor{load}.\n"
        )
    return "\n".join(out)
