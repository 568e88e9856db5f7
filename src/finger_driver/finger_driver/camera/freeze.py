# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Detects a camera that repeats its last images, unlike one that sees nothing move."""

from __future__ import annotations

import zlib
from collections import deque

import numpy as np

_BUFFERS = 8
"""Buffers that the ring of a camera's driver has at most."""


class FreezeDetector:
    """Counts images in a row that are each the one before, or the one as many before as the ring of
    the camera's driver has buffers. A sensor's noise makes two equal images all but impossible.

    limit: images in a row that count as frozen, 0 never. Images of one grey level throughout (dark
    or at the end of the scale) do not count: these can be equal.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._known: deque[int] = deque(maxlen=_BUFFERS)
        self._period = self._number = 0

    def add(self, image: np.ndarray) -> bool:
        """Take an image (H, W) uint8; whether it is at least the `limit`-th of a row."""
        if not self._limit:
            return False
        key = zlib.crc32(np.ascontiguousarray(image).data)
        same = [back for back, known in enumerate(reversed(self._known), 1) if known == key]
        self._known.append(key)
        if self._period in same:
            self._number += 1
        elif same:
            self._period, self._number = same[0], 2
        else:
            self._period, self._number = 0, 1
        return self._number >= self._limit and int(image.min()) != int(image.max())
