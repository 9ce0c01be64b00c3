"""Pictures of reports, as on a screen or as on paper, and what is cut off on paper.

python -m tests.look.report RUN --out docs/images/report-step.png
python -m tests.look.report RUN --out out/paper.png --paper
"""

from __future__ import annotations

import argparse
import base64
import json
from pathlib import Path
from typing import Any

from tests.look.browser import Browser
from tests.look.live import shrink

WIDTH, HEIGHT = 740, 1250
PAPER = 680  # pixels of 96 to the inch between the margins of A4
BEYOND = """JSON.stringify([...document.querySelectorAll('table, img')]
  .map(e => [e.tagName, Math.round(e.getBoundingClientRect().right - innerWidth)])
  .filter(e => e[1] > 1))"""


def look_at_report(
    page: Path, out: Path, paper: bool = False, height: int = HEIGHT
) -> list[list[Any]]:
    """Photograph the top of a report; tables and figures that reach beyond it on the right.

    Args:
        page: ``report.html``.
        out: the picture.
        paper: as it is printed, between the margins of A4.
        height: of the picture, in pixels; 0 for all of it.
    """
    width = PAPER if paper else WIDTH
    with Browser(width, height or HEIGHT) as browser:
        browser.call("Emulation.setEmulatedMedia", media="print" if paper else "")
        browser.open(page.resolve().as_uri())
        if not height:
            height = int(browser.evaluate("document.documentElement.scrollHeight"))
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            browser.call("Emulation.setDeviceMetricsOverride", **size)
        beyond: list[list[Any]] = json.loads(browser.evaluate(BEYOND))
        browser.picture(out)
    shrink(out)
    return beyond


def print_to_pdf(page: Path) -> bytes:
    """A page as the browser prints it on the paper that its style asks for."""
    with Browser(PAPER, HEIGHT) as browser:
        browser.open(page.resolve().as_uri())
        made = browser.call("Page.printToPDF", preferCSSPageSize=True, printBackground=True)
    return base64.b64decode(made["data"])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Pictures of a run's report.")
    parser.add_argument("run", type=Path, help="a run folder, or a report.html")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--paper", action="store_true", help="as it is printed")
    parser.add_argument("--height", type=int, default=HEIGHT, help="0: the whole page")
    given = parser.parse_args()
    page = given.run if given.run.is_file() else given.run / "derived" / "report.html"
    beyond = look_at_report(page, given.out, given.paper, given.height)
    cut = "".join(f"; {what} {by} px beyond the edge" for what, by in beyond)
    print(f"{given.out}: {given.out.stat().st_size / 1000:.0f} kB{cut}")


if __name__ == "__main__":
    main()
