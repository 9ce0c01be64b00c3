"""Stumbles of new users that no other test keeps mended."""

from __future__ import annotations

import io
import re
import time
import urllib.request
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.formats.export import write_csv
from analysis.layouts.layouts import isometric_layout
from conftest import HOUSE, PACKAGES
from daq.live.live import LiveView

SPOKEN = (
    "it cannot say who it is", "air's way to the sensor", "one curve a load", "is called so",
    "lowest and highest of each stretch", "did not come to stay", "p of no effect", "boot number",
)  # fmt: skip
"""Phrases that no reader understood."""


def sources() -> list[Path]:
    """Everything that prints, and the pages."""
    folders = [HOUSE / name for name in (*PACKAGES, "docs", "configs")]
    endings = ("*.py", "*.md", "*.j2", "*.toml")
    return [path for folder in folders for ending in endings for path in folder.rglob(ending)]


def test_phrases_that_no_reader_understood_do_not_come_back() -> None:
    texts = {path: " ".join(path.read_text("utf-8").split()).lower() for path in sources()}
    assert len(texts) > 500
    found = [
        (path.name, words) for path, text in texts.items() for words in SPOKEN if words in text
    ]
    assert found == []


def test_the_outlet_s_command_has_one_name() -> None:
    """It was ``vent_cmd``, ``vent_cmd_share`` and ``outlet_cmd``."""
    found = [path for path in sources() if re.search(r"\bvent_cmd\w*", path.read_text("utf-8"))]
    assert found == []


def test_the_page_about_instruments_says_what_each_must_speak() -> None:
    table = (HOUSE / "docs/reference/instruments.md").read_text("utf-8").split("\n\n")[2]
    rows = {line.split("|")[1].strip(): line for line in table.splitlines()[2:]}
    for device, words in (
        ("`[stage]`", "GRBL 1.1"), ("`[balance]` or `[load_cell]`", "MT-SICS"),
        ("`[camera]`", ""), ("`[valve]`", "wire-format.md"),
    ):  # fmt: skip
        assert words in rows[device]
    assert "`uvc:1`" in table


def test_a_live_view_without_a_screen_serves_its_page(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    view = LiveView("no-screen", isometric_layout(), port=0, open_browser=True)
    try:
        assert view.error is None
        assert view.page_error == ""
        with urllib.request.urlopen(view.url, timeout=10.0) as page:
            assert b"<html" in page.read().lower()
        assert opened == []
    finally:
        view.close()


def test_half_a_million_samples_are_written_as_csv_in_a_moment() -> None:
    """It took 18 s for a test of ten minutes; a tenth of that time is still generous here."""
    rng = np.random.default_rng(1)
    table = pd.DataFrame({f"c{k}": rng.normal(size=500_000) for k in range(8)})
    start = time.process_time()
    write_csv(table, io.BytesIO())
    arrow = time.process_time() - start
    start = time.process_time()
    table[:25_000].to_csv(io.BytesIO(), index=False)
    assert arrow < 0.5 * 20 * (time.process_time() - start), "no faster than pandas"
