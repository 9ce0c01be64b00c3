"""Where frames come from: pictures, folders, stacks, videos, runs, cameras."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.clock import Clock
from daq.errors import PamrigError
from plant import tomlfile

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".webp", ".jp2", ".tif", ".tiff"}
STACKS = {".tif", ".tiff"}
LARGEST_PICTURE = 512 << 20
"""Bytes of a picture's file; how many pixels OpenCV lays out for one is bounded in ``vision``."""
MOST_PAGES = 10_000
VIDEOS = {".avi", ".mp4", ".mkv", ".mov", ".mjpg", ".mjpeg", ".m4v", ".webm", ".mpg"}


class FramesError(PamrigError):
    """A source of frames is missing, empty or not a picture."""


@dataclass(frozen=True)
class SourceFrame:
    """One frame of a source.

    ``file`` is the name within the source, ``frame`` the index in a stack, video or run,
    else 0; ``image`` is grey, uint8 or uint16, None where ``problem`` says why not.
    """

    file: str
    frame: int
    image: npt.NDArray[Any] | None
    problem: str = ""


def open_frames(
    source: Path | str, clock: Clock | None = None, count: int = 1
) -> Iterator[SourceFrame]:
    """Frames of a picture, folder, TIFF stack, video or run folder, in order of name.

    ``uvc:INDEX`` takes ``count`` frames from a live camera (needs ``clock``) and
    ``virtual:LENGTH_MM[,LENGTH_MM...]`` renders the virtual bench's camera.

    Raises:
        FramesError: nothing there, nothing in it, or not a picture at all.
    """
    text = str(source)
    if text.startswith("virtual:"):
        yield from _virtual(text.removeprefix("virtual:"))
        return
    if text.startswith("uvc:"):
        yield from _live(text.removeprefix("uvc:"), clock, count)
        return
    path = Path(source)
    if not os.path.exists(path):
        raise FramesError(
            text, "no such file or folder", "give a picture, folder, TIFF stack, video or run"
        )
    if path.is_dir():
        if (path / "run.json").exists():
            yield from _run(path)
        else:
            yield from _folder(path)
        return
    suffix = path.suffix.lower()
    if suffix in VIDEOS:
        yield from _video(path)
        return
    found = _file(path)
    first = next(found)
    second = next(found, None)
    if second is None and first.image is None:
        raise FramesError(text, first.problem, _remedy())
    yield first
    if second is not None:
        yield second
    yield from found


def _remedy() -> str:
    return f"known pictures: {' '.join(sorted(PICTURES))}; known videos: {' '.join(sorted(VIDEOS))}"


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts]


def _folder(path: Path) -> Iterator[SourceFrame]:
    known = PICTURES | VIDEOS
    files = sorted(
        (p for p in path.iterdir() if p.is_file() and p.suffix.lower() in known), key=_natural
    )
    if not files:
        raise FramesError(str(path), "the folder holds no picture", _remedy())
    for file in files:
        if file.suffix.lower() in VIDEOS:
            try:
                yield from _video(file)
            except FramesError as error:
                yield SourceFrame(file.name, 0, None, error.what)
        else:
            yield from _file(file)


def decode(data: bytes) -> npt.NDArray[Any] | None:
    """Grey frame of an encoded picture, None when it is none.

    Eight-bit colour is decoded straight to grey (a JPEG's own luminance); 16 bits stay 16.
    """
    import cv2

    if not data:
        return None
    raw = np.frombuffer(data, dtype=np.uint8)
    try:
        image = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
        if image is not None and image.ndim == 3 and image.dtype == np.uint8:
            image = cv2.imdecode(raw, cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    return None if image is None else _gray(np.asarray(image))


def _gray(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Grey from what OpenCV hands out (BGR order)."""
    import cv2

    if image.ndim == 3 and image.shape[2] >= 3:
        image = np.asarray(cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), cv2.COLOR_BGR2GRAY))
    elif image.ndim == 3:
        image = image[:, :, 0]
    return image


def _file(path: Path) -> Iterator[SourceFrame]:
    import cv2

    if path.suffix.lower() in STACKS:
        try:
            count = cv2.imcount(str(path), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            count = 0
        if count > 1:  # page by page: a small file may hold thousands of large ones
            for k in range(min(count, MOST_PAGES)):
                yield _page(path, k)
            return
    try:
        image = decode(tomlfile.read_bytes(path, LARGEST_PICTURE))
    except OSError as error:
        yield SourceFrame(path.name, 0, None, f"cannot be read: {error.strerror}")
        return
    if image is None:
        yield SourceFrame(
            path.name, 0, None, "not a picture that can be read (damaged, or another format)"
        )
    else:
        yield SourceFrame(path.name, 0, image)


def _page(path: Path, k: int) -> SourceFrame:
    """One page of a stack."""
    import cv2

    try:
        ok, pages = cv2.imreadmulti(str(path), k, 1, flags=cv2.IMREAD_UNCHANGED)
    except cv2.error:
        ok, pages = False, ()
    if not ok or not pages:
        return SourceFrame(path.name, k, None, "page that cannot be read")
    return SourceFrame(path.name, k, _gray(np.asarray(pages[0])))


def _video(path: Path) -> Iterator[SourceFrame]:
    import cv2

    video = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise FramesError(
                str(path), "not a video that can be read (damaged, or cut short)", _remedy()
            )
        promised = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        k = 0
        while True:
            ok, image = video.read()
            if not ok or image is None:
                break
            yield SourceFrame(path.name, k, _gray(np.asarray(image)))
            k += 1
        if k == 0:
            raise FramesError(str(path), "the video holds no frame that can be read", _remedy())
        for lost in range(k, min(promised, k + MOST_PAGES)):
            yield SourceFrame(path.name, lost, None, "the video ends before this frame")
    finally:
        video.release()


def _run(path: Path) -> Iterator[SourceFrame]:
    from daq.run import open_run

    run = open_run(path)
    if not run.frames:
        raise FramesError(str(path), "the run holds no frames", "it was taken without a camera")
    for fields in run.frames:
        number = int(fields["frame"])
        name = f"frames/{number}"
        try:
            image = decode(run.frame_bytes(number))
        except PamrigError as error:
            yield SourceFrame(name, number, None, error.what)
            continue
        problem = "" if image is not None else "the frame's JPEG cannot be decoded"
        yield SourceFrame(name, number, image, problem)


def _virtual(text: str) -> Iterator[SourceFrame]:
    from rigs.virtual.camera import render

    try:
        lengths = [float(part) for part in text.split(",") if part.strip()] or [55.0]
    except ValueError as error:
        raise FramesError(
            f"virtual:{text}", f"not a length: {error}", "write virtual:55"
        ) from error
    rng = np.random.default_rng(0)
    for k, length_mm in enumerate(lengths):
        yield SourceFrame(f"virtual:{length_mm:g}", k, render(length_mm, rng))


def _live(text: str, clock: Clock | None, count: int) -> Iterator[SourceFrame]:
    from daq.clock import RealClock
    from daq.deadline import Deadline
    from rigs.uvc import UvcCamera

    used: Clock = clock or RealClock()
    camera = UvcCamera(int(text) if text.isdigit() else text, used)
    try:
        given = 0
        deadline = Deadline(used, 5.0 + count)
        while given < count:
            for frame in camera.drain()[: count - given]:
                yield SourceFrame(f"uvc:{text}", frame.seq, frame.gray)
                given += 1
            if deadline.expired:
                raise FramesError(f"camera {text}", "gave no frame", "check its cable")
            used.sleep(0.005)
    finally:
        camera.close()
