"""The blind check as one call: run what is missing, total it, print it, write the page."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from daq.version import version
from gap.check.campaign import BESIDE, HELD_OUT, Plan, parse_numbers, run_campaign
from gap.check.ledger import enter, used_before
from gap.check.scoring.forms import FORMLESS, side_by_side
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
    held_out: bool,
) -> None:
    """Run, total and print; see `pamrig gap check --help`."""
    if held_out:
        plan = Plan("", parse_numbers(sets), out, baselines=False, jobs=jobs, scheduler=scheduler)
        show(compared(plan), out, page, as_json)
        return
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
            enter(ledger, numbers, version(), purpose or "check")
    plan = Plan(stream, numbers, out, baselines=baselines, jobs=jobs, scheduler=scheduler)
    entries = run_or_stop(plan)
    found = {"stream": stream, "first": numbers[0], "last": numbers[-1], **summary(entries)}
    show(found, out, page, as_json)


def run_or_stop(plan: Plan) -> list[dict[str, Any]]:
    """All lines of a plan; status 130 when stopped from the keyboard."""
    try:
        return run_campaign(plan)
    except KeyboardInterrupt:
        typer.echo(
            f"\nstopped; finished sets are in {plan.out}; run the same command again to continue",
            err=True,
        )
        sys.exit(130)


def compared(plan: Plan) -> dict[str, Any]:
    """Totals of forms that practice knows and of forms held out, on the same benches."""
    numbers = plan.numbers
    seen = run_or_stop(replace(plan, stream=BESIDE))
    formed = tuple(e["number"] for e in seen if e["score"]["kind"] not in FORMLESS)
    kept = run_or_stop(replace(plan, stream=HELD_OUT, numbers=formed, held_out=True))
    return {
        "stream": HELD_OUT,
        "first": numbers[0],
        "last": numbers[-1],
        **summary([*seen, *kept]),
        "forms": side_by_side([e["score"] for e in seen], [e["score"] for e in kept]),
    }


def show(found: dict[str, Any], out: Path, page: Path | None, as_json: bool) -> None:
    """Write totals and page, and print."""
    (out / "totals.json").write_text(
        json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    if page is not None:
        from gap.check.page import write_forms_page, write_page

        (write_forms_page if "forms" in found else write_page)(page, found)
    if as_json:
        typer.echo(json.dumps(found, indent=1, allow_nan=False))
    elif "forms" in found:
        print_forms(found["forms"])
    else:
        print_table(found)


def print_forms(found: dict[str, Any]) -> None:
    """Seen and held-out forms side by side on the terminal."""
    typer.echo(
        f"{found['seen_sets']} sets of seen forms, {found['held_out_sets']} of held-out ones"
    )
    for line in found["figures"]:
        seen, kept = written(line["seen"]), written(line["held_out"])
        typer.echo(f"{line['figure']:36s} {seen:34s} {kept}")


def written(line: dict[str, Any]) -> str:
    """A figure with its interval and count."""
    if line["value"] is None:
        return "-"
    if line["hits"] is None:
        return f"{line['value']:.3g} (of {line['of']})"
    return (
        f"{100 * line['value']:.1f} % [{100 * line['low']:.1f}, {100 * line['high']:.1f}]"
        f" ({line['hits']}/{line['of']})"
    )


def print_table(found: dict[str, Any]) -> None:
    """The headline table on the terminal."""
    typer.echo(f"{found['sets']} blind sets, {found['changed']} under changed conditions")
    for line in found["headline"]:
        value = written(line)
        met = {True: "met", False: "MISSED", None: ""}[line["met"]]
        typer.echo(f"{line['figure']:40s} {line['target'] or '':>10s}  {value:32s} {met}")
