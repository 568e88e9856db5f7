# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Content of image files becomes an array, or is refused in a sentence that names it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.image_files import decode_image

PIXELS = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5


def test_bytes_and_arrays_give_the_pixels_as_stored() -> None:
    deep = np.dstack([PIXELS.astype(np.uint16) * 256] * 3)
    for pixels in (PIXELS, deep):
        packed = cv2.imencode(".png", pixels)[1].ravel()
        for data in (packed, packed.tobytes()):
            np.testing.assert_array_equal(decode_image(data, "a.png"), pixels)


def test_white_of_a_pgm_is_the_largest_value_of_its_type() -> None:
    twelve = b"P5\n8 6\n4095\n" + (PIXELS.astype(int) * 16).astype(">u2").tobytes()
    white = b"P5\n1 1\n4095\n" + (4095).to_bytes(2, "big")
    assert decode_image(white, "a.pgm") == 65535
    assert decode_image(twelve, "a.pgm").max() == 235 * 16 * 65535 // 4095


@pytest.mark.parametrize("data", [b"", b"text", b"\x89PNG\r\n\x1a\n", "cut"])
def test_what_is_no_image_is_named(data: bytes | str) -> None:
    if isinstance(data, str):
        data = cv2.imencode(".png", PIXELS)[1].tobytes()[:45]
    with pytest.raises(InputError, match=r"^camera 3: "):
        decode_image(data, "camera 3")
