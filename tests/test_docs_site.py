"""The documentation site leads to every page, and every link within the pages to something."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from docs.make.site.pages import listings, navigation, sections

HOUSE = Path(__file__).resolve().parent.parent
DOCS = HOUSE / "docs"
FRONT = (DOCS / "README.md").read_text("utf-8")
PAGES = sorted(
    path.relative_to(DOCS).as_posix()
    for path in [*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]
    if path.relative_to(DOCS).parts[0] not in ("make", "examples") and path.name != "README.md"
)


def words(page: str) -> str:
    """The Markdown of a page, without blocks of code."""
    text = (DOCS / page).read_text("utf-8")
    if page.endswith(".ipynb"):
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def anchors(page: str) -> set[str]:
    """Anchors of the headings, as repository browsers and the site make them."""
    found = re.findall(r"^#{1,6} (.+)$", words(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", h.lower()).strip().replace(" ", "-") for h in found}


def test_the_front_page_lists_every_page_once() -> None:
    listed = [page for _, pages in sections(FRONT) for page in pages]
    assert sorted(listed) == PAGES
    titles = [title for title, _ in sections(FRONT)]
    assert titles == ["Start", "Tutorials", "Use", "Reference", "Explanation", "Evidence"]


@pytest.mark.parametrize("page", ["README.md", *PAGES])
def test_every_link_within_the_pages_leads_somewhere(page: str) -> None:
    for target in re.findall(r"\]\(((?!https?:|mailto:)[^)\s]+)\)", words(page)):
        file, _, anchor = target.partition("#")
        path = (DOCS / page).parent / file if file else DOCS / page
        assert path.exists(), f"{page}: {target}"
        if anchor and path.suffix == ".md" and path.is_relative_to(DOCS):
            assert anchor in anchors(path.resolve().relative_to(DOCS).as_posix()), target


def test_a_link_to_a_folder_leads_to_its_listing(tmp_path: Path) -> None:
    (tmp_path / "docs" / "examples" / "a").mkdir(parents=True)
    (tmp_path / "docs" / "examples" / "a" / "x.py").write_text("x = 1\n", "utf-8")
    app = SimpleNamespace(srcdir=str(tmp_path / "docs"), outdir=str(tmp_path / "out"))
    source = ["see [files](../examples/a) and [page](other.md)"]
    (tmp_path / "docs" / "use").mkdir()
    navigation(app, "use/page", source)
    link = re.search(r'href="([^"]+)"', source[0])
    assert link is not None
    (tmp_path / "out" / "use").mkdir(parents=True)
    listings(app, None)
    target = tmp_path / "out" / "use" / link[1]
    assert target.exists()
    assert 'href="x.py"' in target.read_text("utf-8")
    assert "[page](other.md)" in source[0]


def test_the_sidebar_has_the_tables_of_the_front_page() -> None:
    source = [FRONT]
    navigation(SimpleNamespace(srcdir=str(DOCS)), "README", source)
    assert source[0].startswith(FRONT.rstrip()[:2000])
    assert source[0].count("```{toctree}") == 6
    assert "\nreference/files.md\n" in source[0].partition(":caption: Reference")[2]


def test_what_the_site_needs_is_an_extra_and_not_in_the_wheel() -> None:
    project = tomllib.loads((HOUSE / "pyproject.toml").read_text("utf-8"))
    extra = project["project"]["optional-dependencies"]["docs"]
    assert {"sphinx", "myst-nb", "furo"} <= {re.split("[<>=]", one)[0] for one in extra}
    packages = project["tool"]["setuptools"]["packages"]["find"]["include"]
    assert not any(name.startswith("docs") for name in packages)
