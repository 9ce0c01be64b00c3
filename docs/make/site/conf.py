"""The documentation site: `make docs`. Pages are those of docs/, as they stand."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
HOUSE = HERE.parents[2]
sys.path.insert(0, str(HOUSE))

from daq.version import version as current  # noqa: E402
from docs.make.site.pages import listings, navigation  # noqa: E402

logging.getLogger("traitlets").setLevel(logging.WARNING)  # one line for each notebook
project = "pamrig"
author = "The pamrig developers"
version = release = current()
copyright = author
extensions = ["myst_nb"]
root_doc = "README"
exclude_patterns = ["make/**", "examples/**"]
language = "en"

html_theme = "furo"
html_title = f"pamrig {version}"
html_static_path = [str(HERE / "static")]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # a browser reads no other file of a site on disk
html_theme_options: dict[str, Any] = {"sidebar_hide_name": False}

myst_heading_anchors = 3
myst_enable_extensions = ["attrs_inline"]
nb_execution_mode = "force"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_merge_streams = True
nb_ipywidgets_js: dict[str, Any] = {}
"""A page fetches nothing from another computer."""


def setup(app: Any) -> None:
    """Add what the pages lack on a site: the contents, and files that are no pages of it."""
    app.connect("source-read", navigation)
    app.connect("build-finished", listings)
