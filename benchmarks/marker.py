"""Macro and edge method against plain OpenCV and scikit-image pipelines, one run, one core.

    python benchmarks/marker.py [--frames 60] [--json]

Every method gets the same frames of known gap (rendered by the tests' own truth renderer,
not by the virtual bench): an ordinary one, one tilted by 3 degrees, one with 5 % specks and
one at JPEG quality 75. Times are medians over the frames; errors are rms in pixels over the
frames for which a method gave an answer.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from vision.edge import measure_gap
from vision.macro import NoMarker, measure_macro
from vision_defects import jpeg, specks
from vision_truth import Scene, picture

Frame = npt.NDArray[np.uint8]


def by_macro(frame: Frame) -> float:
    """The thesis's macro; the frames' right mark begins at column 630."""
    try:
        return float(measure_macro(frame))
    except NoMarker:
        return math.nan


def by_edge(frame: Frame) -> float:
    got = measure_gap(frame)
    return got.pixels if got.trusted else math.nan


def by_opencv(frame: Frame) -> float:
    """Otsu threshold, opening and closing, components; gap between the two largest."""
    _, mask = cv2.threshold(frame, 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)
    kernel = np.ones((5, 5), np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel)
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 3:
        return math.nan
    marks = sorted(stats[1:], key=lambda s: -s[cv2.CC_STAT_AREA])[:2]
    a, b = sorted(marks, key=lambda s: s[cv2.CC_STAT_LEFT])
    return float(b[cv2.CC_STAT_LEFT] - a[cv2.CC_STAT_LEFT] - a[cv2.CC_STAT_WIDTH])


def by_skimage(frame: Frame) -> float:
    """threshold_otsu, label, regionprops; gap between the bounding boxes of the two largest."""
    from skimage.filters import threshold_otsu
    from skimage.measure import label, regionprops

    regions = regionprops(label(frame < threshold_otsu(frame)))
    if len(regions) < 2:
        return math.nan
    marks = sorted(regions, key=lambda r: -r.area)[:2]
    a, b = sorted(marks, key=lambda r: r.bbox[1])
    return float(b.bbox[1] - a.bbox[3])


def by_skimage_contours(frame: Frame) -> float:
    """Sub-pixel iso-contours half-way between the levels; median distance over the rows."""
    from skimage.filters import threshold_otsu
    from skimage.measure import find_contours

    long = sorted(find_contours(frame, threshold_otsu(frame)), key=len, reverse=True)[:2]
    if len(long) < 2:
        return math.nan
    a, b = sorted(np.median(c[:, 1]) for c in long)
    return float(b - a)


METHODS: dict[str, Callable[[Frame], float]] = {
    "macro (thesis)": by_macro,
    "edge (ours)": by_edge,
    "OpenCV threshold+components": by_opencv,
    "scikit-image otsu+regionprops": by_skimage,
    "scikit-image find_contours": by_skimage_contours,
}


def cases(count: int) -> dict[str, list[tuple[Frame, float]]]:
    out: dict[str, list[tuple[Frame, float]]] = {}
    for k, (name, tilt) in enumerate(
        (("ordinary", 0.0), ("tilt 3 deg", 3.0), ("5 % specks", 0.0), ("JPEG 75", 0.0))
    ):
        rng = np.random.default_rng([99, k])
        frames = []
        for _ in range(count):
            gap = float(rng.uniform(90, 200))
            # facing edge of the right mark at column 630, where the macro's region begins
            scene = Scene(gap=gap, x=630.0 - gap / 2, tilt_deg=tilt)
            frame = picture(scene, rng)
            if name == "5 % specks":
                frame = specks(frame, rng, "any")
            if name == "JPEG 75":
                frame = jpeg(frame)
            frames.append((frame, gap))
        out[name] = frames
    return out


def run(count: int) -> dict[str, Any]:
    cv2.setNumThreads(1)
    results: dict[str, Any] = {}
    for case, frames in cases(count).items():
        results[case] = {}
        for name, measure in METHODS.items():
            measure(frames[0][0])
            took, errors = [], []
            for frame, gap in frames:
                start = time.perf_counter()
                got = measure(frame)
                took.append(time.perf_counter() - start)
                errors.append(got - gap)
            e = np.array(errors)
            known = e[np.isfinite(e)]
            results[case][name] = {
                "us_a_frame": 1e6 * float(np.median(took)),
                "rms_px": float(np.sqrt(np.mean(known**2))) if len(known) else math.nan,
                "answered": len(known) / len(e),
            }
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    results = run(given.frames)
    if given.json:
        print(json.dumps(results, indent=1))
        return
    import numba
    import skimage

    print(
        f"python {platform.python_version()}, numpy {np.__version__}, numba {numba.__version__}, "
        f"opencv {cv2.__version__}, scikit-image {skimage.__version__}; "
        f"{given.frames} frames of 640 x 480 a case, one core"
    )
    for case, by_method in results.items():
        ours = by_method["edge (ours)"]
        print(f"\n{case}")
        heads = f"{'us/frame':>10s}{'vs edge':>9s}{'rms px':>11s}{'vs edge':>9s}  answered"
        print(f"  {'method':32s}{heads}")
        for name, row in by_method.items():
            slower = row["us_a_frame"] / ours["us_a_frame"]
            worse = row["rms_px"] / ours["rms_px"]
            print(
                f"  {name:32s}{row['us_a_frame']:10.0f}{slower:9.2f}"
                f"{row['rms_px']:11.4f}{worse:9.1f}  {row['answered']:.2f}"
            )


if __name__ == "__main__":
    main()
