"""Camera frames to muscle length."""

import os as _os

# Before OpenCV is loaded: how many pixels it lays out for a picture that claims to have them. The
# cameras of a bench have up to twenty million; a few bytes can claim a thousand million.
# A program that loads OpenCV before pamrig keeps OpenCV's own bound.
_most = _os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "25000000")
MOST_PIXELS = int(_most) if _most.isdigit() else 25_000_000
