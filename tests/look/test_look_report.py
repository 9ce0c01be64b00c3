"""What a technician prints: no table or figure is cut off on A4. Run by ``make look``."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from pypdf import PdfReader

from analysis.formats.importer import import_thesis
from analysis.reporting.derived import derive_all
from daq.clock import RealClock
from protocol_runs import run_short
from rigs.execution.session import run_protocol
from rigs.protocols.names import PROTOCOLS, default_rig
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config
from tests.look.browser import find_browser
from tests.look.report import look_at_report, print_to_pdf

pytestmark = [
    pytest.mark.look,
    pytest.mark.skipif(find_browser() is None, reason="no Chromium; set PAMRIG_BROWSER"),
]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_report_fits_on_paper(name: str, tmp_path: Path) -> None:
    _, run, _ = run_short(name, tmp_path)
    page = derive_all(run.folder).folder / "derived" / "report.html"
    assert look_at_report(page, tmp_path / "paper.png", paper=True) == []
    check_first_page(page)


def check_first_page(page: Path) -> None:
    """Page one, as the browser prints it, ends with the sign-off; page two has the figures."""
    printed = PdfReader(io.BytesIO(print_to_pdf(page))).pages
    pages = [re.sub(r"page \d+ of \d+", "", p.extract_text()).strip() for p in printed]
    assert "Checked by" in pages[0]
    assert pages[1].startswith(("Figures", "Details"))
    assert not re.search(r"[−-]0(\.0+)?(?![\d.])\s", "".join(pages)), "zero has no sign"


@pytest.mark.parametrize("name", ["isometric", "hysteresis", "switching-time", "joint-static"])
def test_page_one_of_a_default_test_is_one_page(name: str, tmp_path: Path) -> None:
    """With the lengths, pressures and repeats of a whole test, and with limits on every result."""
    kind = procedure(name)
    config = load_rig(default_rig(name))
    quantity = kind.analysis.results.quantities[0]
    path = tmp_path / f"{name}.toml"
    limits = f'\n[[acceptance.limits]]\nquantity = "{quantity}"\nupper = 20.0\n'
    path.write_text(find_config(name, "protocols")[0] + limits, "utf-8")
    plan = kind.read(str(path), config)
    result = run_protocol(kind, config, plan, tmp_path, operator="A. Tester", note="whole test")
    page = derive_all(result.folder).folder / "derived" / "report.html"
    check_first_page(page)


@pytest.mark.parametrize("table", ["c01", "c03", "c06", "d01", "d04", "d05"])
def test_the_report_of_a_thesis_table_fits_on_paper(table: str, tmp_path: Path) -> None:
    page = derive_all(import_thesis(table, tmp_path, RealClock())).folder / "derived/report.html"
    assert look_at_report(page, tmp_path / "paper.png", paper=True) == []
