"""Camera frames to muscle length."""

import os as _os

# Before OpenCV is loaded: how many pixels it lays out for a picture that claims to have them.
# Sixty-four million are more than the cameras of a bench have; a few bytes can claim a thousand.
_os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))
