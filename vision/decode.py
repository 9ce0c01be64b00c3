"""Decodes pictures to grey levels; files from untrusted sources need less than 300 MB.

OpenCV refuses a picture with more than ``MOST_PIXELS`` before it allocates memory. This module
also refuses: strips and tiles of a TIFF larger than the picture; a PNG with a chunk beyond the
file, or with animation, which needs memory several times; and formats with twenty bytes per
pixel, such as JPEG 2000. Bench cameras do not produce the last two.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from vision import MOST_PIXELS, tiff

PNG = b"\x89PNG\r\n\x1a\n"
KINDS = (PNG, *tiff.SIGNATURES, b"\xff\xd8\xff", b"BM", b"RIFF", *(b"P%d" % k for k in range(1, 7)))
"""First bytes of supported files: PNG, TIFF, JPEG, BMP, WebP, PBM to PPM."""
MOST_AT_ONCE = 8 * MOST_PIXELS
"""Limit of one TIFF strip or tile, bytes: a whole picture of four channels with 16 bits."""
TOO_LARGE = (
    f"more than {MOST_PIXELS / 1e6:g} million pixels; OPENCV_IO_MAX_IMAGE_PIXELS in the "
    "environment raises the limit"
)
NO_PICTURE = "not a picture that can be read (damaged, or unsupported format)"


class PictureError(ValueError):
    """The data are not a supported picture, or the picture is too large."""


def decode_gray(data: bytes | memoryview, eight_bit: bool = False) -> npt.NDArray[Any]:
    """Decode a picture to grey levels, shape (height, width).

    The type is uint8, uint16 or float as in the picture, uint8 with ``eight_bit``. A colour
    JPEG gives its luminance, a TIFF its first page.

    Raises:
        PictureError: names the reason.
    """
    import cv2

    view = memoryview(data)
    head = view[:8].tobytes()
    if not head.startswith(KINDS) or (head == PNG and not _is_whole(view)):
        raise PictureError(NO_PICTURE)
    first = next(tiff.pages(view), None)
    if first is not None and first.strip_bytes > MOST_AT_ONCE:
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
    """True if all chunks lie inside the file and the picture is not animated."""
    at, kind = len(PNG), b""
    while kind != b"IEND":
        if at + 8 > len(png):
            return False
        length, kind = struct.unpack_from(">I4s", png, at)
        at += 12 + length
        if at > len(png) or kind == b"acTL":
            return False
    return True
