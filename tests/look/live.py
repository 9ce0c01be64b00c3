"""Pictures of the live view and of a run's view file, in headless Chromium.

python -m tests.look.live --out docs/images/live-isometric.png
python -m tests.look.live --run runs/<run> --out out/view.png
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from daq.layout import GREEN, SKY, Colour
from daq.live import LiveView
from daq.run import open_run
from daq.viewfile import open_view
from rigs.liveview import isometric_layout, measured_edges
from tests.look.browser import Browser
from tests.look.synthetic import SyntheticTest

LOAD_S = 120.0  # 43 MB of page, compiled and drawn without a graphics card
DRAWN = 300  # pixels of a colour that must be there before the picture counts as drawn


def pixels_of(picture: npt.NDArray[np.uint8], colour: Colour) -> int:
    """How many pixels of a picture (BGR) have about this colour."""
    near = np.abs(picture.astype(int) - np.array(colour[::-1])).max(axis=2) < 24
    return int(near.sum())


def photograph(browser: Browser, out: Path, still: int = 3) -> npt.NDArray[np.uint8]:
    """Wait until curves are drawn and nothing moves, save; returns the picture (BGR)."""
    end = time.monotonic() + LOAD_S
    last = np.zeros((1, 1, 3), dtype=np.uint8)
    same = 0
    while same < still:
        if time.monotonic() > end:
            said = [line[:300] for line in browser.console if line.startswith("error")]
            raise AssertionError(f"no still picture in {LOAD_S:g} s; see {out}; {said[-3:]}")
        time.sleep(1.5)
        picture = np.asarray(cv2.imread(str(browser.picture(out))), dtype=np.uint8)
        drawn = all(pixels_of(picture, colour) > DRAWN for colour in (SKY, GREEN))
        moved = picture.shape != last.shape or np.mean(picture != last) > 1e-4
        same = same + 1 if drawn and not moved else 0
        last = picture
    shrink(out)
    return last


def shrink(path: Path) -> None:
    """Fewer colours, so that the picture is small enough to live in the documentation."""
    from PIL import Image

    Image.open(path).convert("RGB").quantize(192, dither=Image.Dither.NONE).save(
        path, optimize=True
    )


def look_at_live(out: Path, width: int = 1600, height: int = 1000) -> npt.NDArray[np.uint8]:
    """Feed a synthetic test to a live view and photograph it."""
    view = LiveView("look-isometric", isometric_layout(), port=0, web=True)
    assert view.error is None, view.error
    assert view.web_error is None, view.web_error
    try:
        with Browser(width, height) as browser:
            browser.open(view.web_url)
            test = threading.Thread(target=SyntheticTest(view).run, kwargs={"last_down": 4})
            test.start()
            test.join()
            return photograph(browser, out)
    finally:
        view.close()


def look_at_run(
    folder: Path, out: Path, width: int = 1600, height: int = 1000
) -> npt.NDArray[np.uint8]:
    """Photograph the view of a recorded run."""
    viewer = open_view(open_run(folder), isometric_layout(), measured_edges, web=True, port=0)
    try:
        with Browser(width, height) as browser:
            browser.open(viewer.url)
            return photograph(browser, out)
    finally:
        viewer.close()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Pictures of the live view.")
    parser.add_argument("--out", type=Path, default=Path("docs/images/live-isometric.png"))
    parser.add_argument("--run", type=Path, help="a run folder instead of a synthetic test")
    parser.add_argument("--width", type=int, default=1600)
    parser.add_argument("--height", type=int, default=1000)
    given = parser.parse_args()
    if given.run:
        look_at_run(given.run, given.out, given.width, given.height)
    else:
        look_at_live(given.out, given.width, given.height)
    print(f"{given.out}: {given.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
