"""Encoded pictures to grey levels, those of strangers in less than 300 MB.

OpenCV refuses what claims more than ``MOST_PIXELS`` before it lays anything out. What gets past
that is looked for here: strips and tiles of a TIFF that are larger than its picture; a PNG that
claims four gigabytes for a chunk, or is animated and laid out several times; and formats that take
twenty bytes a pixel, as JPEG 2000 does. The last two are no pictures of a bench.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from vision import MOST_PIXELS, tiff

PNG = b"\x89PNG\r\n\x1a\n"
KINDS = (PNG, *tiff.BEGINS, b"\xff\xd8\xff", b"BM", b"RIFF", *(b"P%d" % k for k in range(1, 7)))
"""How a file begins: PNG, TIFF, JPEG, BMP, WebP, PBM to PPM."""
MOST_AT_ONCE = 8 * MOST_PIXELS
"""Bytes of a strip or tile of a TIFF: that of a whole picture of four channels of 16 bits."""
TOO_LARGE = (
    f"more than {MOST_PIXELS / 1e6:g} million pixels; OPENCV_IO_MAX_IMAGE_PIXELS in the "
    "environment raises the limit"
)
NO_PICTURE = "not a picture that can be read (damaged, or another format)"


class PictureError(ValueError):
    """Bytes that are no picture, or one larger than those that are read."""


def decode_gray(data: bytes | memoryview, eight_bit: bool = False) -> npt.NDArray[Any]:
    """Grey levels of an encoded picture, shape (height, width).

    uint8, uint16 or floating point as the picture has them, uint8 with ``eight_bit``; of colour
    JPEG its own luminance. Of a TIFF the first page is taken.

    Raises:
        PictureError: says what is wrong.
    """
    import cv2

    view = memoryview(data)
    head = view[:8].tobytes()
    if not head.startswith(KINDS) or (head == PNG and not _is_whole(view)):
        raise PictureError(NO_PICTURE)
    first = next(tiff.pages(view), None)
    if first is not None and first.at_once > MOST_AT_ONCE:
        raise PictureError(TOO_LARGE)
    try:
        depth = cv2.IMREAD_GRAYSCALE if eight_bit else cv2.IMREAD_ANYDEPTH
        image = cv2.imdecode(np.frombuffer(view, dtype=np.uint8), depth)
    except cv2.error as error:
        too_large = "CV_IO_MAX_IMAGE" in str(error)
        raise PictureError(TOO_LARGE if too_large else NO_PICTURE) from None
    if image is None:
        raise PictureError(NO_PICTURE)
    return np.asarray(image)


def _is_whole(png: memoryview) -> bool:
    """Whether all chunks up to the last lie inside the file, and none says it is animated."""
    at, kind = len(PNG), b""
    while kind != b"IEND":
        if at + 8 > len(png):
            return False
        length, kind = struct.unpack_from(">I4s", png, at)
        at += 12 + length
        if at > len(png) or kind == b"acTL":
            return False
    return True
