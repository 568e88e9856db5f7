# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of any camera become 8-bit grey or are refused."""

from __future__ import annotations

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.image_size import white_level
from finger_common.mono8 import Mono8, as_mono8, in_full_range, in_low_bits

LOWER = np.arange(4096, dtype=np.uint16).reshape(64, 64)
"""A picture of 12 bits in the lower bits."""


def test_colour_becomes_its_brightest_channel_and_equal_channels_stay() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    for pixels in (np.dstack([grey] * 3), np.dstack([grey, grey // 2, grey // 9, grey * 0 + 255])):
        np.testing.assert_array_equal(as_mono8(pixels), grey)
    deep = np.dstack([grey.astype(np.uint16) << 8] * 3)
    np.testing.assert_array_equal(as_mono8(deep), grey)


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_a_dark_picture_in_the_upper_bits_is_one(bits: int) -> None:
    """Cameras that fill the upper bits leave the lower ones empty."""
    dark = (LOWER >> (16 - bits)) << (16 - bits)
    np.testing.assert_array_equal(as_mono8(dark), LOWER >> 8)


def test_a_picture_in_the_lower_bits_is_refused_until_the_camera_has_shown_more() -> None:
    camera = Mono8()
    with pytest.raises(InputError, match="above 4095 of 65535: 10- or 12-bit"):
        camera(LOWER, "frame")
    camera(LOWER * 16)
    np.testing.assert_array_equal(camera(LOWER), LOWER >> 8)
    np.testing.assert_array_equal(Mono8(dark=True)(LOWER), LOWER >> 8)
    assert not as_mono8(np.zeros((4, 4), np.uint16)).any()
    assert in_low_bits(LOWER)
    assert not any(map(in_low_bits, (LOWER * 16, LOWER & 0xFFF0, LOWER * 0)))


def test_white_of_a_pgm_is_that_of_its_header() -> None:
    header = b"P5\n# a comment\n64 64\n4095\n"
    assert white_level(header) == 4095 and white_level(b"P4\n8 8\n") is None
    full = in_full_range(LOWER, header)
    assert full.dtype == np.uint16 and full[0, 0] == 0 and full[-1, -1] == 65535
    np.testing.assert_array_equal(as_mono8(full), (LOWER >> 4).astype(np.uint8))
    assert in_full_range(LOWER, b"\x89PNG\r\n\x1a\n") is LOWER
