"""Files of pictures: which are known, and their order."""

from __future__ import annotations

import re
from pathlib import Path

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".webp", ".tif", ".tiff"}
VIDEOS = {".avi", ".mp4", ".mkv", ".mov", ".mjpg", ".mjpeg", ".m4v", ".webm", ".mpg"}
LARGEST_PICTURE = 80 << 20
"""Bytes of a picture's file; what its decoding may lay out is bounded in ``vision.decode``."""


def natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort key of a name: numbers in it by value, so that 2.png comes before 10.png."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts]


def picture_files(folder: Path) -> list[Path]:
    """The pictures in a folder, in natural order of their names."""
    files = (p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in PICTURES)
    return sorted(files, key=natural)
