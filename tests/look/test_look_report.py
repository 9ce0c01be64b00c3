"""What a technician prints: no table or figure is cut off on A4. Run by ``make look``."""

from __future__ import annotations

from pathlib import Path

import pytest

from analysis.formats.importer import import_thesis
from analysis.reporting.derived import derive_all
from daq.clock import RealClock
from protocol_runs import run_short
from rigs.protocols.names import PROTOCOLS
from tests.look.browser import find_browser
from tests.look.report import look_at_report

pytestmark = [
    pytest.mark.look,
    pytest.mark.skipif(find_browser() is None, reason="no Chromium; set PAMRIG_BROWSER"),
]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_report_fits_on_paper(name: str, tmp_path: Path) -> None:
    _, run, _ = run_short(name, tmp_path)
    page = derive_all(run.folder).folder / "derived" / "report.html"
    assert look_at_report(page, tmp_path / "paper.png", paper=True) == []


@pytest.mark.parametrize("table", ["c01", "c03", "c06", "d01", "d04", "d05"])
def test_the_report_of_a_thesis_table_fits_on_paper(table: str, tmp_path: Path) -> None:
    page = derive_all(import_thesis(table, tmp_path, RealClock())).folder / "derived/report.html"
    assert look_at_report(page, tmp_path / "paper.png", paper=True) == []
