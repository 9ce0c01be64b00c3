"""Pictures of the live view and of a run's view file, in headless Chromium.

python -m tests.look.live --out docs/images/live-isometric.png   (a test on the virtual bench)
python -m tests.look.live --protocol isotonic --points 100 --out docs/images/live-isotonic.png
python -m tests.look.live --protocol creep --at end --out out/end.png      (or at a state: zero)
python -m tests.look.live --run runs/<run> --out out/view.png
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from analysis.layouts.layouts import isometric_layout, measured_edges
from daq.live.layout import SKY, Colour
from daq.live.live import LiveView
from daq.live.viewfile import open_view
from daq.store.run import open_run
from tests.look.browser import Browser
from tests.look.synthetic import SyntheticTest

LOAD_S = 900.0  # 43 MB of page, compiled and drawn without a graphics card
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
        drawn = pixels_of(picture, SKY) > DRAWN  # the measured pressure; not all have a set-point
        moved = picture.shape != last.shape or np.mean(picture != last) > 1e-4
        same = same + 1 if drawn and not moved else 0
        last = picture
    shrink(out)
    return last


def shrink(path: Path) -> None:
    """Fewer shades, so that the picture is small enough to live in the documentation."""
    from PIL import Image, ImageOps

    ImageOps.posterize(Image.open(path).convert("RGB"), 6).save(path, optimize=True)


def look_at_live(out: Path, width: int = 1600, height: int = 1000) -> npt.NDArray[np.uint8]:
    """Feed a synthetic test to a live view and photograph it."""
    view = LiveView("look-isometric", isometric_layout(), port=0)
    assert view.error is None, view.error
    assert view.page_error == "", view.page_error
    try:
        with Browser(width, height) as browser:
            browser.open(view.url)
            test = threading.Thread(target=SyntheticTest(view).run, kwargs={"last_down": 4})
            test.start()
            test.join()
            return photograph(browser, out)
    finally:
        view.close()


def look_at_bench(
    root: Path,
    out: Path,
    protocol: str = "isometric",
    points: int = 130,
    width: int = 1600,
    height: int = 1000,
    at: str = "",
    template: str = "",
    rig: str = "",
) -> npt.NDArray[np.uint8]:
    """Photograph the live view of a real run on the virtual bench, held after some points.

    Args:
        root: folder of runs.
        out: the picture.
        protocol: the test.
        points: so many results are made before the picture.
        width, height: of the page.
        at: a state of the test, or "end": the picture is taken there and not after some points.
        template, rig: the protocol file and the rig; by default those of the protocol.
    """
    from daq.interrupt import StopFlag
    from rigs.execution.session import run_protocol
    from rigs.live.feed import LiveFeed
    from rigs.protocols.names import default_rig
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig

    config = load_rig(rig or default_rig(protocol))
    kind = procedure(protocol)
    plan = kind.read(template or protocol, config)
    layout = kind.analysis.layout(plan.as_dict())
    stop, done = StopFlag(), []
    taken: list[npt.NDArray[np.uint8]] = []

    class HeldView(LiveView):
        """Stops the virtual clock after some points, for as long as the picture takes."""

        def points(self, *args: object, **kwargs: object) -> None:
            super().points(*args, **kwargs)
            done.append(args)
            if not at and len(done) == points:
                self.take()

        def state(self, path: str, time_s: float, text: str) -> None:
            super().state(path, time_s, text)
            if text == at and not taken:
                self.take()

        def close(self) -> None:
            if at == "end" and not taken:
                taken.append(photograph(browser, out))
            super().close()

        def take(self) -> None:
            taken.append(photograph(browser, out))
            stop.set("the picture is taken")

    def make_live(run_id: str) -> LiveFeed:
        view = HeldView(run_id, layout, port=0)
        assert view.error is None, view.error
        assert view.page_error == "", view.page_error
        browser.open(view.url)
        assert view.wait_for_viewer(LOAD_S)
        return LiveFeed(view, layout)

    with Browser(width, height) as browser:
        run_protocol(kind, config, plan, root, stop=stop, make_live=make_live)
    return taken[0]


def look_at_run(
    folder: Path, out: Path, width: int = 1600, height: int = 1000
) -> npt.NDArray[np.uint8]:
    """Photograph the view of a recorded run."""
    from analysis.registry import layout_of

    run = open_run(folder)
    viewer = open_view(run, layout_of(run), measured_edges(run), port=0)
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
    parser.add_argument("--protocol", default="isometric")
    parser.add_argument("--points", type=int, default=130, help="settled points before the picture")
    parser.add_argument("--at", default="", help="a state of the test, or end")
    parser.add_argument("--template", default="", help="protocol file; default: of the protocol")
    parser.add_argument("--rig", default="", help="default: of the protocol")
    parser.add_argument("--run", type=Path, help="a run folder instead of a live test")
    parser.add_argument("--synthetic", action="store_true", help="no bench, made-up curves")
    parser.add_argument("--width", type=int, default=1600)
    parser.add_argument("--height", type=int, default=1000)
    given = parser.parse_args()
    if given.run:
        look_at_run(given.run, given.out, given.width, given.height)
    elif not given.synthetic:
        with tempfile.TemporaryDirectory() as root:
            look_at_bench(
                Path(root), given.out, given.protocol, given.points, given.width, given.height,
                given.at, given.template, given.rig,
            )  # fmt: skip
    else:
        look_at_live(given.out, given.width, given.height)
    print(f"{given.out}: {given.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
