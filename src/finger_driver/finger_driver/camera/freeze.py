# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Detects a camera that repeats its last image, unlike one that sees nothing move."""

from __future__ import annotations

import zlib

import numpy as np


class FreezeDetector:
    """Counts identical images in a row. A sensor's noise makes two equal images all but impossible.

    limit: images in a row that count as frozen, 0 never. Images of one grey level throughout (dark
    or at the end of the scale) do not count: these can be equal.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._last: int | None = None
        self._number = 0

    def frozen(self, image: np.ndarray) -> bool:
        """Whether this image (H, W) uint8 is at least the `limit`-th of equal ones."""
        if not self._limit:
            return False
        key = zlib.crc32(np.ascontiguousarray(image).data)
        if key != self._last:
            self._last, self._number = key, 1
            return False
        self._number += 1
        return self._number >= self._limit and int(image.min()) != int(image.max())
