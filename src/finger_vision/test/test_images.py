# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Images of messages and files become arrays or are refused with the reason."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.mono8 import as_mono8
from finger_vision.images import decode, read_image
from finger_vision.messages import image_of

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20


def test_mono8_is_not_copied_and_padding_is_skipped() -> None:
    padded = np.zeros((3, 7), np.uint8)
    padded[:, :4] = GREY
    image = decode(padded.tobytes(), 3, 4, "mono8", 7)
    np.testing.assert_array_equal(image, GREY)
    data = bytearray(GREY.tobytes())
    seen = decode(data, 3, 4, "mono8", 4)
    assert not seen.flags.owndata


@pytest.mark.parametrize("bigendian", [False, True])
def test_16_bit_keeps_full_scale(bigendian: bool) -> None:
    values = np.array([[0, 256, 65535]], np.uint16)
    data = values.astype(">u2" if bigendian else "<u2").tobytes()
    sent = decode(data, 1, 3, "mono16", 6, bigendian)
    assert sent.dtype == np.uint16
    np.testing.assert_array_equal(sent, values)
    np.testing.assert_array_equal(as_mono8(sent), [[0, 1, 255]])
    np.testing.assert_array_equal(as_mono8(values), [[0, 1, 255]])


def test_a_signal_of_floats_comes_as_sent() -> None:
    values = np.array([[0.25, -3.0], [1e6, 7.0]], np.float32)
    np.testing.assert_array_equal(decode(values.tobytes(), 2, 2, "32FC1", 8), values)
    swapped = values.astype(">f4").tobytes()
    np.testing.assert_array_equal(decode(swapped, 2, 2, "32FC1", 8, bigendian=True), values)


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_grey_colour_frames_become_the_same_grey(encoding: str) -> None:
    channels = 4 if encoding.endswith("a8") else 3
    data = np.repeat(GREY[:, :, None], channels, axis=2)
    sent = decode(data.tobytes(), 3, 4, encoding, 4 * channels)
    np.testing.assert_array_equal(as_mono8(sent), GREY)


@pytest.mark.parametrize(("encoding", "blue"), [("rgb8", 2), ("bgr8", 0), ("rgba8", 2)])
def test_a_plate_in_blue_light_loses_nothing_in_a_colour_camera(encoding: str, blue: int) -> None:
    channels = 4 if encoding.endswith("a8") else 3
    data = np.zeros((3, 4, channels), np.uint8)
    data[:, :, blue] = GREY
    data[:, :, 3:] = 255
    sent = decode(data.tobytes(), 3, 4, encoding, 4 * channels)
    np.testing.assert_array_equal(as_mono8(sent), GREY)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((b"", 0, 4, "mono8", 4), "size above zero"),
        ((bytes(18), 3, 4, "nv21", 4), "encoding 'nv21' is not supported"),
        ((bytes(4), 2, 2, "bayer_rggb8", 2), "2×2 is too small"),
        ((bytes(11), 3, 4, "mono8", 4), "too few"),
        ((bytes(12), 3, 4, "mono8", 2), "too few"),
        ((bytes(12), 10**6, 10**6, "mono8", 10**6), "too large"),
    ],
)
def test_unusable_messages_are_refused(arguments, words: str) -> None:
    with pytest.raises(InputError, match=words):
        decode(*arguments)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((0, 5), np.uint8), "empty"),
        (np.zeros((4, 4), np.float32), "float32"),
        (np.full((4, 4), 4095, np.uint16), "10- or 12-bit pixels"),
        (np.zeros((4, 4, 2), np.uint8), "4×4×2"),
        (np.zeros(4, np.uint8), r"\(height, width\)"),
    ],
)
def test_unusable_arrays_are_refused(image: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        as_mono8(image)


def test_files_are_read_or_named(tmp_path: Path) -> None:
    good = tmp_path / "good.png"
    cv2.imwrite(str(good), GREY.astype(np.uint16) * 256)
    np.testing.assert_array_equal(read_image(good), GREY)
    blue = tmp_path / "blue.png"
    cv2.imwrite(str(blue), np.dstack([GREY, GREY // 2, GREY // 4]))
    np.testing.assert_array_equal(read_image(blue), GREY)
    twelve = tmp_path / "twelve.pgm"
    twelve.write_bytes(b"P5\n4 3\n4095\n" + (GREY.astype(int) * 16).astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(twelve), GREY)
    for name, content, words in (
        ("empty.png", b"", "empty"),
        ("text.png", b"not an image", "decoded"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=words):
            read_image(tmp_path / name)
    with pytest.raises(InputError, match="folder"):
        read_image(tmp_path)
    with pytest.raises(InputError, match="no such image"):
        read_image(tmp_path / "absent.png")


def test_messages_are_read_by_attribute() -> None:
    message = SimpleNamespace(
        height=3,
        width=4,
        encoding="mono8",
        step=4,
        is_bigendian=0,
        data=GREY.ravel(),
    )
    np.testing.assert_array_equal(image_of(message), GREY)


SMOOTH = np.add.outer(np.arange(40), np.arange(60)).astype(np.uint8) * 2


def compressed(form: str, picture: np.ndarray, ending: str) -> SimpleNamespace:
    """A sensor_msgs/CompressedImage."""
    return SimpleNamespace(format=form, data=cv2.imencode(ending, picture)[1])


@pytest.mark.parametrize(
    ("form", "ending"),
    [
        ("jpeg", ".jpg"),
        ("png", ".png"),
        ("mono8; jpeg compressed ", ".jpg"),
        ("bgr8; jpeg compressed bgr8", ".jpg"),
        ("rgb8; png compressed bgr8", ".png"),
        ("", ".png"),
    ],
)
def test_a_compressed_image_is_read_by_its_content(form: str, ending: str) -> None:
    picture = np.dstack([SMOOTH] * 3) if "gr8" in form or "gb8" in form else SMOOTH
    image = as_mono8(image_of(compressed(form, picture, ending)))
    assert np.abs(image.astype(int) - SMOOTH).max() <= (2 if ending == ".jpg" else 0)


def test_a_compressed_mosaic_becomes_colours_as_the_raw_one_does() -> None:
    mosaic = np.zeros((40, 60), np.uint8)
    mosaic[1::2, 1::2] = SMOOTH[1::2, 1::2]  # a plate in blue light
    raw = decode(mosaic.tobytes(), 40, 60, "bayer_rggb8", 60)
    for form in ("bayer_rggb8; png compressed ", "bayer_rggb8; png compressed bayer_rggb8"):
        np.testing.assert_array_equal(image_of(compressed(form, mosaic, ".png")), raw)
    converted = image_of(compressed("bayer_rggb8; png compressed bgr8", raw, ".png"))
    np.testing.assert_array_equal(converted, raw)


def test_broken_and_other_compressed_images_are_refused() -> None:
    for ending in (".jpg", ".png"):
        whole = compressed("jpeg", SMOOTH, ending)
        whole.data = whole.data[: len(whole.data) // 2]
        with pytest.raises(InputError, match=r"compressed image \('jpeg'\): broken"):
            image_of(whole)
    depth = compressed("16UC1; compressedDepth png", SMOOTH.astype(np.uint16), ".png")
    depth.data = b"\0" * 12 + depth.data.tobytes()
    with pytest.raises(InputError, match="no picture of the plate"):
        image_of(depth)
