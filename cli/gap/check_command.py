"""The blind check as one call: run what is missing, total it, print it, write the page."""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import typer

from gap.check.campaign import Plan, parse_numbers, run_campaign
from gap.check.ledger import enter, used_before
from gap.check.scoring.totals import summary
from gap.errors import CheckError

STREAMS = ("practice", "reserved", "smoke")


def check_command(
    *,
    stream: str,
    sets: str,
    out: Path,
    jobs: int,
    scheduler: str | None,
    baselines: bool,
    page: Path | None,
    purpose: str,
    ledger: Path,
    as_json: bool,
) -> None:
    """Run, total and print; see `pamrig gap check --help`."""
    if stream not in STREAMS:
        raise CheckError("--stream", f"expected one of {', '.join(STREAMS)}, got {stream!r}")
    numbers = parse_numbers(sets)
    if stream == "reserved":
        earlier = used_before(ledger, numbers)
        if earlier and not (out / "results.jsonl").exists():
            typer.echo(
                f"note: sets {earlier[0]['first']}-{earlier[0]['last']} were used on "
                f"{earlier[0]['date']} ({earlier[0]['purpose']}); they are no longer blind",
                err=True,
            )
        if not (out / "results.jsonl").exists():
            enter(ledger, numbers, version("pamrig"), purpose or "check")
    plan = Plan(stream, numbers, out, baselines=baselines, jobs=jobs, scheduler=scheduler)
    try:
        entries = run_campaign(plan)
    except KeyboardInterrupt:
        typer.echo(f"\nstopped; finished sets are in {out}; the same command goes on", err=True)
        sys.exit(130)
    found = {"stream": stream, "first": numbers[0], "last": numbers[-1], **summary(entries)}
    (out / "totals.json").write_text(
        json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    if page is not None:
        from gap.check.page import write_page

        write_page(page, found)
    if as_json:
        typer.echo(json.dumps(found, indent=1, allow_nan=False))
    else:
        print_table(found)


def print_table(found: dict[str, Any]) -> None:
    """The headline table on the terminal."""
    typer.echo(f"{found['sets']} blind sets, {found['changed']} under changed conditions")
    for line in found["headline"]:
        if line["value"] is None:
            value = "-"
        elif line["hits"] is None:
            value = f"{line['value']:.3g} (of {line['of']})"
        else:
            value = (
                f"{100 * line['value']:.1f} % [{100 * line['low']:.1f}, {100 * line['high']:.1f}]"
                f" ({line['hits']}/{line['of']})"
            )
        met = {True: "met", False: "MISSED", None: ""}[line["met"]]
        typer.echo(f"{line['figure']:40s} {line['target'] or '':>10s}  {value:32s} {met}")
