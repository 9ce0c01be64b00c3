"""The page of results, docs/evidence/faults.md: written by the campaign, from its journal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tests import campaign_page

from .campaign import FINDINGS, bad, versions
from .kinds import KINDS
from .places import CLASSES

Z95 = 1.6449
"""Of a one-sided bound at 95 %."""
TITLE = (
    "# Fault injection campaign",
    "",
    "`make faults` (`python -m tests.faults --page docs/evidence/faults.md`) writes this page. It",
    "makes short runs of every protocol on the virtual clock and injects faults. Each run is",
    "checked against the true state of the virtual bench and against the bytes on disk. First,",
    "each kind of fault is injected alone, early, midway and late in every protocol. Then one to",
    "three layers fail at the same time, with random kind, time, duration and strength. The",
    "number of a run defines protocol, bench and faults: `python -m tests.faults --only NUMBER`",
    "repeats the run and keeps it.",
    "",
)
HEAD = (
    "| Fault | Protocols | Runs | Not reported | Vent late | Unreadable | Wrong value"
    " | Cannot continue | Bound | Slowest command | Slowest emptying |"
)
LEGEND = (
    "*Not reported*: neither record nor message shows that something was wrong. *Vent late*:",
    "later than the deadlines of docs/reference/safety-contract.md, or air that could have left",
    "the muscle is still there 3 s after the end. *Unreadable*: a row that the host had received",
    "before the fault is missing or changed (events and pictures too), or `runs verify` finds",
    "damage. *Wrong value*: a sample or a number in the table differs from the true value at its",
    "time by more than six of its own standard uncertainties plus the change in the meantime.",
    "Switching and step tests are compared with the same bench without a fault. *Cannot",
    "continue*: `pamrig continue` does not complete the table. *Bound*: upper 95 % Wilson bound",
    "of the share of runs with any finding. A run with several faults counts for each of them.",
)
EXEMPT = (
    "These are not findings: a lost heartbeat, command or single reading that was recovered; a",
    "digit flipped into another digit on a line whose protocol has no checksum (MT-SICS), as long",
    "as it causes no wrong value; a supply or valve fault after which every value is right; a",
    "pressure read as 0 because a wire broke while the muscle was empty. A valve or control test",
    "measures the valve: its results for a valve that is stuck, slow or short of air are not",
    "checked.",
)


def wilson_upper(bad: int, runs: int) -> float:
    """Upper bound (95 %, one-sided, Wilson) of a share of which ``bad`` of ``runs`` were seen."""
    if not runs:
        return 1.0
    share, z2 = bad / runs, Z95 * Z95
    middle = share + z2 / (2 * runs)
    spread = Z95 * math.sqrt(share * (1 - share) / runs + z2 / (4 * runs * runs))
    return min(1.0, (middle + spread) / (1 + z2 / runs))


def write_page(results: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the page; what somebody wrote below the mark stays."""
    campaign_page.write_page(path, "\n".join(_lines(results)))


def _lines(results: Sequence[dict[str, Any]]) -> list[str]:
    numbers = [r["number"] for r in results]
    found = [r for r in results if bad(r)]
    hit = [r for r in results if any(f["hits"] for f in r["faults"])]
    several = sum(sum(bool(f["hits"]) for f in r["faults"]) > 1 for r in results)
    ends = Counter(r["outcome"] for r in results)
    cpu_min = sum(r["cpu_s"] for r in results) / 60
    gone_on = sum(r["continued"] for r in results)
    made = Counter(r["revision"] for r in results)
    again = sum("before" in r for r in results)
    mended = sum("before" in r and not bad(r) for r in results)
    about = f"{datetime.now(UTC):%Y-%m-%d}, {versions()}; {cpu_min:.0f} min of CPU"
    lines = [
        *TITLE,
        f"{len(results)} runs, numbers {min(numbers)} to {max(numbers)}. A fault took effect in"
        f" {len(hit)} of them, several faults in {several}. {about}. Outcomes:"
        f" {', '.join(f'{n} {k}' for k, n in ends.most_common())}. {gone_on} incomplete runs"
        " were continued (`pamrig continue`; every second one was tried).",
        "",
        "Source revisions (runs): "
        + ", ".join(f"{k} ({n})" for k, n in made.items())
        + "."
        + (
            f" {again} runs had a finding, in the product or in the checker, and were repeated"
            f" after the correction; {mended} of these have none now."
            if again
            else ""
        ),
        "",
        f"**{len(found)} runs with a finding**; with 95 % confidence fewer than"
        f" {100 * wilson_upper(len(found), len(results)):.2f} % of such runs have one.",
        "",
        HEAD,
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for layer in KINDS:
        for group in ("static", "valve", "control"):
            mine = [r for r in hit if CLASSES[r["protocol"]] == group and _has(r, layer)]
            if mine:
                lines.append(_row(layer, group, mine))
    lines.append(_row("**all**", "all", list(results)))
    lines += ["", *LEGEND, "", "Kinds: " + "; ".join(_kinds(layer, hit) for layer in KINDS) + "."]
    lines += ["", *EXEMPT, ""]
    if found:
        lines += ["Findings:", ""]
        lines += [f"- run {r['number']} ({r['protocol']}): {_first(r)}" for r in found[:40]]
        lines.append("")
    return lines


def _has(result: dict[str, Any], layer: str) -> bool:
    return any(f["layer"] == layer and f["hits"] for f in result["faults"])


def _row(layer: str, group: str, mine: Sequence[dict[str, Any]]) -> str:
    counts = [sum(bool(r[k]) for r in mine) for k in FINDINGS]
    some = sum(bad(r) for r in mine)
    command = max((r["worst_commanded_s"] for r in mine), default=0.0)
    empty = max((r["worst_empty_s"] for r in mine), default=0.0)
    cells = [layer, group, len(mine), *counts, f"{100 * wilson_upper(some, len(mine)):.1f} %"]
    cells += [f"{command * 1e3:.0f} ms", f"{empty:.2f} s"]
    return "| " + " | ".join(map(str, cells)) + " |"


def _kinds(layer: str, hit: Sequence[dict[str, Any]]) -> str:
    counts = Counter(
        f["kind"] for r in hit for f in r["faults"] if f["layer"] == layer and f["hits"]
    )
    return f"{layer} (" + ", ".join(f"{kind} {counts[kind]}" for kind in KINDS[layer]) + ")"


def _first(result: dict[str, Any]) -> str:
    words = [text for k in FINDINGS for text in result[k]] + [result["crashed"]]
    faults = "; ".join(f"{f['layer']}: {f['kind']} {f['device']}".strip() for f in result["faults"])
    return f"{next(w for w in words if w)} ({faults})"
