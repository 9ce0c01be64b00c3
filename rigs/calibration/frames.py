"""Where frames come from: pictures, folders, stacks, videos, runs, cameras."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.errors import PamrigError
from plant import tomlfile
from vision.files import LARGEST_PICTURE, PICTURES, VIDEOS, natural

STACKS = {".tif", ".tiff"}
MOST_LOST = 10_000


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


def open_frames(source: Path | str, count: int = 1) -> Iterator[SourceFrame]:
    """Frames of a picture, folder, TIFF stack, video or run folder, in order of name.

    ``uvc:INDEX`` takes ``count`` frames from a live camera and
    ``virtual:LENGTH_MM[,LENGTH_MM...]`` renders the virtual bench's camera.

    Raises:
        FramesError: nothing there, nothing in it, or not a picture at all.
    """
    text = str(source)
    if text.startswith("virtual:"):
        yield from _virtual(text.removeprefix("virtual:"))
        return
    if text.startswith("uvc:"):
        yield from _live(text.removeprefix("uvc:"), count)
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


def _folder(path: Path) -> Iterator[SourceFrame]:
    known = PICTURES | VIDEOS
    files = sorted(
        (p for p in path.iterdir() if p.is_file() and p.suffix.lower() in known), key=natural
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


def _picture(name: str, frame: int, data: bytes | memoryview) -> SourceFrame:
    from vision.decode import PictureError, decode_gray

    try:
        return SourceFrame(name, frame, decode_gray(data))
    except PictureError as error:
        return SourceFrame(name, frame, None, str(error))


def _file(path: Path) -> Iterator[SourceFrame]:
    try:
        stack = _pages(path) if path.suffix.lower() in STACKS else []
        if len(stack) > 1:  # page by page: a small file may hold thousands of large ones
            for k, at in enumerate(stack):
                yield _page(path, k, at)
        else:
            yield _picture(path.name, 0, tomlfile.read_bytes(path, LARGEST_PICTURE))
    except OSError as error:
        yield SourceFrame(path.name, 0, None, f"cannot be read: {error.strerror}")


def _pages(path: Path) -> list[int]:
    from vision import tiff

    if path.stat().st_size == 0:  # nothing that could be mapped
        return []
    return [page.at for page in tiff.pages(np.memmap(path, np.uint8, "r").data)]


def _page(path: Path, k: int, at: int) -> SourceFrame:
    """One page of a stack, of which no more is read; mapped anew, so that none is kept."""
    from vision import tiff

    data = np.memmap(path, np.uint8, "c").data
    tiff.set_first_page(data, at)
    return _picture(path.name, k, data)


def _video(path: Path) -> Iterator[SourceFrame]:
    import cv2

    from vision import MOST_PIXELS
    from vision.decode import TOO_LARGE

    video = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise FramesError(
                str(path), "not a video that can be read (damaged, or cut short)", _remedy()
            )
        size = video.get(cv2.CAP_PROP_FRAME_WIDTH) * video.get(cv2.CAP_PROP_FRAME_HEIGHT)
        if size > MOST_PIXELS:
            raise FramesError(str(path), TOO_LARGE, _remedy())
        promised = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        k = 0
        while True:
            ok, image = video.read()
            if not ok or image is None:
                break
            yield SourceFrame(path.name, k, np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))
            k += 1
        if k == 0:
            raise FramesError(str(path), "the video holds no frame that can be read", _remedy())
        for lost in range(k, min(promised, k + MOST_LOST)):
            yield SourceFrame(path.name, lost, None, "the video ends before this frame")
    finally:
        video.release()


def _run(path: Path) -> Iterator[SourceFrame]:
    from daq.store.run import open_run

    run = open_run(path)
    if not run.frames:
        raise FramesError(str(path), "the run holds no frames", "it was taken without a camera")
    for fields in run.frames:
        number = int(fields["frame"])
        name = f"frames/{number}"
        try:
            data = run.frame_bytes(number)
        except PamrigError as error:
            yield SourceFrame(name, number, None, error.what)
            continue
        yield _picture(name, number, data)


def _virtual(text: str) -> Iterator[SourceFrame]:
    from rigs.virtual.emulators.pictures.camera import render

    try:
        lengths = [float(part) for part in text.split(",") if part.strip()] or [55.0]
        if not all(abs(length_mm) < 1e4 for length_mm in lengths):
            raise ValueError("expected mm below 10000")
    except ValueError as error:
        raise FramesError(
            f"virtual:{text}", f"not a length: {error}", "write virtual:55"
        ) from error
    rng = np.random.default_rng(0)
    for k, length_mm in enumerate(lengths):
        yield SourceFrame(f"virtual:{length_mm:g}", k, render(length_mm, rng))


def _live(text: str, count: int) -> Iterator[SourceFrame]:
    from daq.clock import Deadline, RealClock
    from rigs.devices.uvc import UvcCamera

    clock = RealClock()
    camera = UvcCamera(int(text) if text.isdigit() else text, clock)
    try:
        given = 0
        deadline = Deadline(clock, 5.0 + count)
        while given < count:
            for frame in camera.drain()[: count - given]:
                yield SourceFrame(f"uvc:{text}", frame.seq, frame.gray)
                given += 1
            if deadline.expired:
                raise FramesError(f"camera {text}", "gave no frame", "check its cable")
            clock.sleep(0.005)
    finally:
        camera.close()
