"""A report as PDF, from its own HTML page, by WeasyPrint (extra ``pdf``)."""

from __future__ import annotations

from pathlib import Path

from daq.errors import PamrigError
from daq.wholefile import write_whole

BROWSER = "or print the HTML page to PDF in a browser"


def page_to_pdf(html: str) -> bytes:
    """A self-contained HTML page as PDF, laid out as it is printed.

    Args:
        html: the page; nothing that it names is fetched, only ``data:`` addresses are used.

    Raises:
        PamrigError: WeasyPrint, or the library Pango that it needs, is not installed.
    """
    try:
        import weasyprint
    except ImportError:
        raise PamrigError(
            "--pdf", "needs the package weasyprint", f"pip install 'pamrig[pdf]', {BROWSER}"
        ) from None
    except OSError as error:
        raise PamrigError(
            "--pdf", f"needs the library Pango, which weasyprint does not find ({error})",
            f"install it (Debian: libpango-1.0-0 libpangoft2-1.0-0; macOS: brew install pango;"
            f" Windows: see docs/use/report.md), {BROWSER}",
        ) from None  # fmt: skip

    fetcher = weasyprint.URLFetcher(allowed_protocols=("data",))
    page = weasyprint.HTML(string=html, url_fetcher=fetcher)
    document: bytes = page.write_pdf()
    return document


def write_pdf(html: str, out: Path) -> None:
    """Write a page as PDF; errors as for :func:`page_to_pdf`, and `OSError`."""
    document = page_to_pdf(html)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, document)
