"""A campaign: sealed before diagnosis, taken up again where it stopped, every use booked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from blind.seal import opened
from gap.check.campaign import (
    RESULTS,
    SEALS,
    Plan,
    on_pool,
    parse_numbers,
    read_results,
    run_campaign,
)
from gap.check.examine import Task
from gap.check.ledger import enter, used_before
from gap.check.page import write_page
from gap.errors import CheckError

NOMINAL = (0, 1, 5)


def plan(
    out: Path, engine: str = "quiet", numbers: tuple[int, ...] = NOMINAL, jobs: int = 1
) -> Plan:
    return Plan("smoke", numbers, out, f"gap_check_stub:{engine}", baselines=False, small=True,
                jobs=jobs, quiet=True)  # fmt: skip


def test_every_answer_matches_the_seal_published_before_the_diagnosis(tmp_path: Path) -> None:
    entries = run_campaign(plan(tmp_path))
    seals = {
        line["number"]: line["seal"]
        for line in map(json.loads, (tmp_path / SEALS).read_text().splitlines())
    }
    for entry in entries:
        assert seals[entry["number"]] == entry["seal"]
        assert opened(entry["envelope"], entry["seal"])["number"] == entry["number"]


def test_the_seal_is_on_disk_while_the_diagnosis_runs(tmp_path: Path, monkeypatch) -> None:
    import gap_check_stub

    seen: list[int] = []

    def looking(folder: Path, without: tuple[str, ...] = ()) -> dict[str, object]:
        seen.append(len((tmp_path / SEALS).read_text().splitlines()))
        assert not list(folder.parent.rglob("*answer*"))
        return gap_check_stub.quiet(folder)

    monkeypatch.setattr(gap_check_stub, "looking", looking, raising=False)
    run_campaign(plan(tmp_path, "looking", (0, 1)))
    assert seen == [1, 2]


def test_a_stopped_campaign_goes_on_without_losing_or_repeating(tmp_path: Path) -> None:
    run_campaign(plan(tmp_path, numbers=(0,)))
    results = tmp_path / RESULTS
    first = results.read_text()
    results.write_text(first + '{"stream": "smoke", "numb')  # killed while writing
    assert [e["number"] for e in read_results(results)] == [0]
    results.write_text(first)
    entries = run_campaign(plan(tmp_path, "broken"))
    assert sorted(e["number"] for e in entries) == list(NOMINAL)
    assert results.read_text().startswith(first)


def test_a_diagnosis_that_falls_over_is_a_result_too(tmp_path: Path) -> None:
    (entry,) = run_campaign(plan(tmp_path, "broken", (0,)))
    assert entry["verdict"]["status"] == "crashed"
    assert "ZeroDivisionError: no floor (gap_check_stub.py" in entry["verdict"]["reason"]
    assert entry["score"]["crashed"]


def test_a_pool_gives_what_one_process_gives_and_compiles_before_it_spreads(
    tmp_path: Path,
) -> None:
    """Two that warmed numba's cache at once have ended in a segmentation fault."""
    alone = run_campaign(plan(tmp_path / "a"))
    engine, seals = "gap_check_stub:quiet", tmp_path / "seals"
    tasks = [Task("smoke", n, True, str(seals), engine, False) for n in NOMINAL]
    outcomes = on_pool(2, tasks)
    pooled = [next(outcomes)]
    assert len(seals.read_text().splitlines()) == 1
    pooled += outcomes

    def scores(entries):
        rows = [{k: v for k, v in e["score"].items() if k != "seconds"} for e in entries]
        return sorted(rows, key=lambda r: r["number"])

    assert scores(pooled) == scores(alone)


def test_a_cluster_that_is_not_there_is_said_plainly(tmp_path: Path) -> None:
    with pytest.raises(CheckError, match="--scheduler"):
        list(run_campaign(Plan("smoke", (0,), tmp_path, scheduler="tcp://127.0.0.1:1", quiet=True)))


def test_numbers_and_their_mistakes() -> None:
    assert parse_numbers("0-2,7") == (0, 1, 2, 7)
    with pytest.raises(CheckError, match="0-59"):
        parse_numbers("a-b")


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    (tmp_path / RESULTS).write_text('{"stream": \n{"stream": "smoke", "number": 1}\n')
    with pytest.raises(CheckError, match="line 1"):
        read_results(tmp_path / RESULTS)


def test_reserved_sets_are_booked_before_use(tmp_path: Path) -> None:
    ledger = tmp_path / "ledger.csv"
    enter(ledger, range(300), "0.1.0", "first release")
    assert used_before(ledger, (299, 300))[0]["purpose"] == "first release"
    assert used_before(ledger, (300, 301)) == []


def test_the_page_is_written_from_totals(tmp_path: Path) -> None:
    from gap.check.scoring.totals import summary

    entries = run_campaign(plan(tmp_path / "run", numbers=(0, 1, 2)))
    found = {"stream": "smoke", "first": 0, "last": 2, **summary(entries)}
    write_page(tmp_path / "page.md", json.loads(json.dumps(found, allow_nan=False)))
    text = (tmp_path / "page.md").read_text()
    assert "| false alarm at nominal | <= 0.02 | 0.0 % [0.0, " in text
    for name in ("reliability", "sizes", "confusion", "limits"):
        assert (tmp_path / "images" / f"gap-check-{name}.png").stat().st_size > 5000


def test_a_wrong_stream_is_one_line_and_status_2(tmp_path: Path) -> None:
    import typer

    from cli.gap.commands import check

    app = typer.Typer()
    app.command()(check)
    done = CliRunner().invoke(app, ["--stream", "secret", "--out", str(tmp_path)])
    assert isinstance(done.exception, CheckError)
    assert "practice, reserved, smoke" in str(done.exception)
