"""Writes the pictures that the commands of docs/use/length.md speak of, into a folder.

python tests/docs_pictures.py FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from rigs.virtual.emulators.camera import CameraModel, render


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


if __name__ == "__main__":
    main(Path(sys.argv[1]))
