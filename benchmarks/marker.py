"""Macro and edge method against plain OpenCV and scikit-image pipelines, one run, one core.

    python benchmarks/marker.py [--frames 60] [--json]
    python -m benchmarks marker               # with ImageJ, as on the page

Every method gets the same frames of known gap (rendered by the tests' own truth renderer,
not by the virtual bench): an ordinary one, one tilted by 3 degrees, one with 5 % specks and
one at JPEG quality 75. Times are medians over the frames; errors are rms in pixels over the
frames for which a method gave an answer.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

HOUSE = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(HOUSE), str(HOUSE / "tests")]

from benchmarks.paired import ratios, short, table
from vision.macro import NoMarker, measure_macro
from vision.marker.edge import measure_gap
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


def by_opencv_adaptive(frame: Frame) -> float:
    """Adaptive threshold, largest contour, its area over the height, tilt by its moments."""
    smooth = cv2.GaussianBlur(frame, (5, 5), 0)
    mask = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, 401, 0)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return math.nan
    only = np.zeros_like(mask)
    cv2.drawContours(only, [max(contours, key=cv2.contourArea)], -1, 255, -1)
    m = cv2.moments(only, binaryImage=True)
    tilt = 0.5 * math.atan2(2.0 * m["mu11"], m["mu20"] - m["mu02"])
    return float(m["m00"] / frame.shape[0] * abs(math.sin(tilt)))


def by_opencv_gradient(frame: Frame) -> float:
    """The careful user's: Sobel, a parabola through each row's two peaks, lines through them."""
    slope = cv2.Sobel(cv2.GaussianBlur(frame, (5, 5), 0), cv2.CV_32F, 1, 0, ksize=3)
    rows = np.arange(len(slope))
    edges = []
    for sign in (1.0, -1.0):
        g = sign * slope
        at = np.clip(g.argmax(axis=1), 1, g.shape[1] - 2)
        a, b, c = g[rows, at - 1], g[rows, at], g[rows, at + 1]
        edges.append(at + 0.5 * (a - c) / np.where(a - 2 * b + c == 0, 1.0, a - 2 * b + c))
    middle = (edges[0] + edges[1]) / 2.0
    fit = cv2.fitLine(np.column_stack([middle, rows]).astype(np.float32), cv2.DIST_HUBER, 0, 1, 1)
    return float(np.median(edges[1] - edges[0]) * abs(fit[1, 0]))


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
    "OpenCV adaptive threshold+moments": by_opencv_adaptive,
    "OpenCV Sobel+parabola a row": by_opencv_gradient,
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


def imagej_jar() -> str:
    """Where ImageJ is: $IMAGEJ_JAR or Debian's place; "" if Java or ImageJ is missing."""
    jar = os.environ.get("IMAGEJ_JAR", "/usr/share/java/ij.jar")
    return jar if shutil.which("java") and shutil.which("javac") and Path(jar).exists() else ""


def by_imagej(frames: list[Frame]) -> tuple[list[float], list[float], str]:
    """Gaps in px, microseconds a frame, version; by ``ImageJGap.java`` in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        names = []
        for k, frame in enumerate(frames):
            names.append(str(Path(folder) / f"{k}.png"))
            cv2.imwrite(names[-1], frame)
        done = subprocess.run(
            ["java", "-Djava.awt.headless=true", "-cp", imagej_jar(),
             str(Path(__file__).parent / "ImageJGap.java")],
            input="\n".join(names), capture_output=True, text=True, check=True,
        )  # fmt: skip
    *rows, version = done.stdout.splitlines()
    gaps, took = zip(*((float(g), float(t)) for g, t in (row.split() for row in rows)), strict=True)
    return list(gaps), list(took), version


def run(count: int, with_imagej: bool = False) -> dict[str, Any]:
    """Each frame goes to all methods in turn; times of each frame in microseconds."""
    cv2.setNumThreads(1)
    results: dict[str, Any] = {}
    for case, frames in cases(count).items():
        took: dict[str, list[float]] = {name: [] for name in METHODS}
        got: dict[str, list[float]] = {name: [] for name in METHODS}
        for measure in METHODS.values():
            measure(frames[0][0])
        for frame, _ in frames:
            for name, measure in METHODS.items():
                start = time.process_time()
                got[name].append(measure(frame))
                took[name].append((time.process_time() - start) * 1e6)
        if with_imagej:
            name = "ImageJ Otsu+particle analyser"
            got[name], took[name], results["imagej"] = by_imagej([f for f, _ in frames])
        results[case] = {}
        for name, gaps in got.items():
            e = np.array(gaps) - np.array([gap for _, gap in frames])
            known = e[np.isfinite(e)]
            results[case][name] = {
                "us": took[name],
                "us_a_frame": float(np.median(took[name])),
                "rms_px": float(np.sqrt(np.mean(known**2))) if len(known) else math.nan,
                "answered": len(known) / len(e),
            }
    return results


TITLE = "Marker measurement"


def measure(tiny: bool = False) -> dict[str, Any]:
    """The page's part: all methods, ImageJ among them where it is."""
    import skimage

    found = run(2 if tiny else 40, with_imagej=bool(imagej_jar()) and not tiny)
    version = found.pop("imagej", "ImageJ not run: no Java, no ij.jar, or the tiny size")
    versions = f"opencv {cv2.__version__}, scikit-image {skimage.__version__}, {version}"
    return {"versions": versions, "frames": 2 if tiny else 40, "cases": found}


def lines(result: dict[str, Any]) -> list[str]:
    """Two cases in a row of the table: time ratio with its spread over frames, error."""
    cases = result["cases"]
    rows = []
    for name in cases["ordinary"]:
        row = [name, short(cases["ordinary"][name]["us_a_frame"])]
        for case in cases.values():
            ours, one = case["edge (ours)"], case[name]
            times = "" if name == "edge (ours)" else str(ratios(one["us"], ours["us"]))
            error = short(one["rms_px"])
            row.append(f"{times} / {error}" if times else error)
        rows.append(row)
    heads = ["method", "us per frame, ordinary", *(f"{c}: time ratio / rms px" for c in cases)]
    out = table(heads, rows)
    faster = sorted({
        n for c in cases.values() for n, r in c.items()
        if r["us_a_frame"] < c["edge (ours)"]["us_a_frame"] and n != "edge (ours)"
    })  # fmt: skip
    closest = min(
        r["rms_px"] / c["edge (ours)"]["rms_px"]
        for c in cases.values() for n, r in c.items() if n != "edge (ours)"
    )  # fmt: skip
    out += [
        f"{result['versions']}; {result['frames']} frames of 640 x 480 per case with known gap, "
        "each to all methods in turn, processor time; for ImageJ that of its own thread, after "
        "compilation. Ratios of time: other method / edge method, median (range over frames).",
        "",
        f"Error: the best other method has {short(closest)} times the error. Time: faster than "
        f"the edge method in at least one case: {', '.join(faster) or 'none'}. The edge method "
        "fits a blurred edge with its noise to every row and calculates an uncertainty; a "
        "threshold does not.",
        "",
    ]
    return out


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
