# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Content of an image file as an array, or refused with the reason."""

from __future__ import annotations

import cv2
import numpy as np

from .errors import InputError
from .image_size import check_image
from .mono8 import in_full_range


def decode_image(
    data: bytes | np.ndarray, where: str, flags: int = cv2.IMREAD_UNCHANGED
) -> np.ndarray:
    """Decode an image file's bytes: (H, W) or (H, W, channels), of PGM scaled to full range.

    data: bytes, or an array (n,) uint8. flags: of OpenCV's imdecode; by default all is as stored.
    Raises InputError, naming `where`, for what is no image or claims too many pixels.
    """
    content = np.frombuffer(data, np.uint8)
    check_image(content.data, where)
    try:
        image = cv2.imdecode(content, flags)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(
            f"{where}: broken, or of a kind that cannot be decoded; give a whole PNG, TIFF, JPEG "
            "or BMP"
        )
    return in_full_range(image, content.data)
