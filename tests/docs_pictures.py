"""Writes the pictures that the commands of docs/use/length.md and pose.md speak of, into a folder.

python tests/docs_pictures.py FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from rigs.virtual.emulators.pictures.camera import CameraModel, render
from rigs.virtual.emulators.pictures.marks import Drawn, MarkCamera, draw_marks


def main(folder: Path) -> None:
    rng = np.random.default_rng(1)
    frames = folder / "frames"
    frames.mkdir(exist_ok=True)
    for k in range(4):
        cv2.imwrite(str(frames / f"{k}.png"), render(50.0 + 3 * k, rng))
    blocks = folder / "blocks"
    blocks.mkdir(exist_ok=True)
    rows = ["file,length_mm,u_mm"]
    for k, length_mm in enumerate(np.linspace(46, 62, 9)):
        cv2.imwrite(str(blocks / f"{k}.png"), render(length_mm, rng, CameraModel(tilt_deg=0.5)))
        rows.append(f"{k}.png,{length_mm:g},0.001")
    (blocks / "blocks.csv").write_text("\n".join(rows) + "\n")
    marks(folder, rng)
    bars(folder, rng)


def bars(folder: Path, rng: np.random.Generator) -> None:
    """A muscle with four markers, at rest and longer by 2 and 4 %."""
    (folder / "bars").mkdir(exist_ok=True)
    for k in range(3):
        image = np.full((480, 640), 190.0)
        x = 100.0
        for gap in (0.0, 60.0, 70.0, 80.0):
            x += gap * (1.0 + 0.02 * k)
            image[180:300, round(x) : round(x) + 30] = 45.0
            x += 30.0
        image = cv2.GaussianBlur(image, (0, 0), 1.0) + rng.normal(0.0, 2.0, image.shape)
        cv2.imwrite(
            str(folder / "bars" / f"{k}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8)
        )


MARKS = """camera = "pose-camera.toml"
reference = "base"

[marks.base]
id = 0
side_mm = 20.0

[marks.link]
id = 3
side_mm = 20.0
"""


def marks(folder: Path, rng: np.random.Generator) -> None:
    """Pictures of a board at six tilts and in the plane, and of a link on the way."""
    board = Drawn(side_mm=14.0, mark_mm=10.0, columns=7, rows=5)
    plane = MarkCamera(k1=-0.12, tilt_deg=(4.0, -3.0), distance_mm=260.0)
    tilts = ((25, 0), (-25, 5), (0, 30), (5, -28), (20, 20), (-18, 22))
    for name in ("board", "link"):
        (folder / name).mkdir(exist_ok=True)
    for k, tilt in enumerate(tilts):
        view = MarkCamera(k1=-0.12, tilt_deg=tilt, roll_deg=17.0 * k, distance_mm=195.0)
        cv2.imwrite(str(folder / "board" / f"{k}.png"), draw_marks([board], rng, view))
    cv2.imwrite(str(folder / "plane.png"), draw_marks([board], rng, plane))
    for k in range(4):
        bodies = [Drawn(0, x_mm=-40.0), Drawn(3, x_mm=30.0, angle_deg=15.0 * k)]
        cv2.imwrite(str(folder / "link" / f"{k}.png"), draw_marks(bodies, rng, plane))
    (folder / "marks.toml").write_text(MARKS)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
