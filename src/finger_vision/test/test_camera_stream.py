# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What cameras send wrongly gives no area, live and offline: frozen, incomplete, blank, dim and
colour images, and stamps that are not in order."""

from __future__ import annotations

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_common.image_size import PixelBudget
from finger_common.mono8 import as_mono8
from finger_offline.image_areas import ImageAreas
from finger_sim.ftir import FtirRenderer, Scene
from finger_vision.area_sensor import NoLight
from finger_vision.camera_stream import CameraStream, LeftOut
from finger_vision.ftir import FtirSegmenter, FtirSettings
from finger_vision.images import decode

SECOND = 1_000_000_000
RADIUS = 4e-3
AREA = math.pi * RADIUS**2
WIDTH = 640


def camera(**scene: float) -> FtirRenderer:
    return FtirRenderer("natural", 3, Scene(**{"background": 160, **scene}), WIDTH, 480)


def segmenter_of(renderer: FtirRenderer, frames: int = 6, **settings: str) -> FtirSegmenter:
    """A sensor that has learned the empty plate."""
    segmenter = FtirSegmenter(FtirSettings(**settings), renderer.calibration())
    for _ in range(frames):
        segmenter.process(renderer.empty())
    return segmenter


def message(picture: np.ndarray) -> SimpleNamespace:
    height, width = picture.shape
    return SimpleNamespace(
        data=picture.tobytes(),
        height=height,
        width=width,
        step=width,
        encoding="mono8",
        is_bigendian=False,
    )


# Stamps --------------------------------------------------------------------------------------


def taken(order: list[float]) -> list[float]:
    """Times (s) of which images are measured, of all that come in this order."""
    renderer = camera()
    areas = ImageAreas(FtirSegmenter(calibration=renderer.calibration()), PixelBudget(1 << 30))
    for time in order:
        item = SimpleNamespace(message=message(renderer.empty()), log_time_ns=1)
        areas.add(item, round(time * SECOND))
    said = areas.problems()
    assert bool(said) == (len(areas.table()) < len(order) or 0 in order)
    return [stamp / SECOND for stamp in areas.table()["stamp_ns"]]


def test_images_out_of_order_give_no_area_and_a_clock_set_back_is_followed() -> None:
    assert taken([10.0, 10.1, 10.1, 10.05, 9.2, 10.2]) == [10.0, 10.1, 10.2]
    # A bag that begins again, or a clock that was set: from there on all are taken.
    assert taken([10.0, 11.0, 3.0, 3.1, 3.05, 3.2]) == [10.0, 11.0, 3.0, 3.1, 3.2]
    assert taken([0.0, 10.0, 0.0, 10.1]) == [0.0, 10.0, 0.0, 10.1]


# Lost pixels ---------------------------------------------------------------------------------


def with_black(picture: np.ndarray, first: int, number: int) -> np.ndarray:
    """The picture with so many pixels from the first one exactly black, in the order of rows."""
    pixels = picture.copy().reshape(-1)
    pixels[first : first + number] = 0
    return pixels.reshape(picture.shape)


@pytest.mark.parametrize("learned", [0, 6])
@pytest.mark.parametrize("place", [20 * WIDTH, 200 * WIDTH, 200 * WIDTH + 250])
@pytest.mark.parametrize("number", [WIDTH, 1440, 3 * 1440, 16 * WIDTH])
def test_an_incomplete_image_is_refused(number: int, place: int, learned: int) -> None:
    """Lost rows and packets of 1440 bytes, beside the contact and within it."""
    renderer = camera()
    segmenter = segmenter_of(renderer, learned)
    pressed = renderer.render(RADIUS)
    with pytest.raises(InputError, match="incomplete"):
        segmenter.process(with_black(pressed, place, number))
    assert segmenter.process(pressed).gross_area == pytest.approx(AREA, rel=0.05)


def test_an_end_that_was_lost_is_refused_where_the_plate_was_learned() -> None:
    renderer = camera()
    segmenter = segmenter_of(renderer)
    with pytest.raises(InputError, match="incomplete"):
        segmenter.process(with_black(renderer.render(RADIUS), 300 * WIDTH, 180 * WIDTH))


@pytest.mark.parametrize("learned", [0, 6])
def test_black_that_a_picture_may_have_is_not_taken_for_lost(learned: int) -> None:
    """A dark plate, a black border, and skin in a picture so dark that most of it is black."""
    renderer = camera(background=1, bright_ridges=True)
    dark = segmenter_of(renderer, learned)
    found = dark.process(renderer.render(RADIUS))
    assert found.gross_area == pytest.approx(AREA, rel=0.05)

    renderer = camera(background=190)

    def cut(picture: np.ndarray) -> np.ndarray:
        picture = np.clip(picture.astype(int) * 2 - 200, 0, 255).astype(np.uint8)
        picture[:30], picture[:, :40] = 0, 0
        return picture

    segmenter = FtirSegmenter(calibration=renderer.calibration())
    for _ in range(learned):
        segmenter.process(cut(renderer.empty()))
    pressed = cut(renderer.render(RADIUS))
    assert np.mean(pressed == 0) > 0.15
    assert segmenter.process(pressed).gross_area == pytest.approx(AREA, rel=0.06)


# Light ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("grey", [5, 8, 16])
def test_a_plate_too_dim_to_see_skin_says_so_instead_of_no_contact(grey: int) -> None:
    renderer = FtirRenderer("dry", 3, Scene(background=grey, noise=1.0), WIDTH, 480)
    doubt = AreaFlag.NO_CONTACT | AreaFlag.LOW_CONTRAST
    segmenter = segmenter_of(renderer)
    for picture in (renderer.empty(), renderer.render(RADIUS)):
        assert segmenter.process(picture).flags == doubt
    # It is the plate all the same, as where touching ridges are brighter.
    assert segmenter.learned == 8
    by_design = segmenter_of(renderer, polarity="bright")
    assert by_design.process(renderer.empty()).flags == AreaFlag.NO_CONTACT


def test_a_plate_that_is_bright_enough_is_simply_without_contact() -> None:
    renderer = FtirRenderer("dry", 3, Scene(background=35, noise=1.0), WIDTH, 480)
    segmenter = segmenter_of(renderer)
    assert segmenter.process(renderer.empty()).flags == AreaFlag.NO_CONTACT
    assert segmenter.process(renderer.render(RADIUS)).gross_area > 0.9 * AREA


@pytest.mark.parametrize("grey", [128, 255])
def test_blank_images_show_no_plate_and_are_not_learned(grey: int) -> None:
    renderer = camera(dust=60, latent=0.1, vignetting=0.4)
    segmenter = segmenter_of(renderer)
    for _ in range(3):
        with pytest.raises(NoLight, match="blank or overexposed"):
            segmenter.process(np.full((480, WIDTH), grey, np.uint8))
    assert segmenter.learned == 6
    assert segmenter.process(renderer.empty()).flags == AreaFlag.NO_CONTACT
    # Those that came before any picture of the plate are forgotten.
    segmenter = FtirSegmenter(calibration=renderer.calibration())
    for _ in range(3):
        segmenter.process(np.full((480, WIDTH), grey, np.uint8))
    segmenter.process(renderer.empty())
    assert segmenter.learned == 1


def test_an_overexposed_image_of_a_plate_that_was_not_is_refused() -> None:
    renderer = camera(dust=60)
    segmenter = segmenter_of(renderer)
    flash = np.clip(renderer.empty().astype(int) * 3, 0, 255).astype(np.uint8)
    assert 0.9 < np.mean(flash == 255) < 1
    with pytest.raises(NoLight, match="overexposed"):
        segmenter.process(flash)
    # A plate that always is white is one; ridges are seen on it.
    white = FtirSegmenter(calibration=renderer.calibration())
    for _ in range(3):
        white.process(np.clip(renderer.empty().astype(int) * 3, 0, 255).astype(np.uint8))
    pressed = np.clip(renderer.render(2e-3).astype(int) * 3, 0, 255).astype(np.uint8)
    assert white.process(pressed).gross_area > 10e-6


# Colour --------------------------------------------------------------------------------------


def in_colour(blue: np.ndarray, red: float, seed: int) -> np.ndarray:
    """Image (H, W, 3) BGR: what the lamp shows in blue, room light of one grey in red."""
    noise = np.random.default_rng(seed)
    other = np.rint(noise.normal([10.0, red], 2.0, (*blue.shape, 2))).clip(0, 255)
    return np.dstack([blue, other.astype(np.uint8)])


@pytest.mark.parametrize("red", [40, 140, 200])
def test_a_colour_camera_sees_the_contact_in_the_light_of_the_lamp(red: float) -> None:
    """Also where room light is brighter than the lamp, which then fills the dark ridges."""
    renderer = camera()
    stream = CameraStream(FtirSegmenter(calibration=renderer.calibration()))
    number = 0

    def show(picture: np.ndarray) -> float:
        nonlocal number
        number += 1
        return stream.measure(stream.signal(in_colour(picture, red, number))).gross_area

    assert [show(renderer.empty()) for _ in range(4)] == [0.0] * 4
    assert show(renderer.render(RADIUS)) == pytest.approx(AREA, rel=0.05)
    # From then on it is known.
    assert [show(renderer.empty()) for _ in range(4)] == [0.0] * 4
    found = stream.measure(stream.signal(in_colour(renderer.render(RADIUS), red, 99)))
    assert found.gross_area == pytest.approx(AREA, rel=0.05) and found.flags == 0


def test_a_single_colour_image_shows_its_channel_of_ridges() -> None:
    """As an image file; brightest values would fill the ridges with the other light."""
    pressed = camera().render(RADIUS)
    np.testing.assert_array_equal(as_mono8(in_colour(pressed, 200, 0)), pressed)


def test_a_colour_camera_in_white_light_keeps_its_channel() -> None:
    renderer = camera()
    stream = CameraStream(FtirSegmenter(calibration=renderer.calibration()))
    for picture in [*(renderer.empty() for _ in range(6)), renderer.render(RADIUS)]:
        white = np.dstack([picture * 0.8, picture, picture * 0.9]).astype(np.uint8)
        found = stream.measure(stream.signal(white))
    assert stream.sensor.learned == 6 and found.flags == 0
    assert found.gross_area == pytest.approx(AREA, rel=0.05)


@pytest.mark.parametrize(
    "encoding", ["bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8", "bayer_rggb16"]
)
def test_a_mosaic_in_blue_light_is_measured(encoding: str) -> None:
    renderer = camera()
    segmenter = FtirSegmenter(calibration=renderer.calibration())
    row, column = divmod(encoding[6:10].index("b"), 2)

    def sent(picture: np.ndarray) -> np.ndarray:
        mosaic = np.full_like(picture, 6)
        mosaic[row::2, column::2] = picture[row::2, column::2]
        values = mosaic.astype("<u2") * 257 if encoding.endswith("16") else mosaic
        return decode(values.tobytes(), 480, WIDTH, encoding, values.strides[0])

    stream = CameraStream(segmenter)
    for _ in range(4):
        assert stream.measure(stream.signal(sent(renderer.empty()))).gross_area == 0.0
    found = stream.measure(stream.signal(sent(renderer.render(RADIUS))))
    assert found.gross_area == pytest.approx(AREA, rel=0.06)


@pytest.mark.parametrize("encoding", ["yuv422", "uyvy", "yuv422_yuy2", "yuyv"])
def test_the_luma_of_a_picture_is_its_grey(encoding: str) -> None:
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    chroma = np.full_like(grey, 128)
    order = (chroma, grey) if encoding in ("yuv422", "uyvy") else (grey, chroma)
    data = np.dstack(order).tobytes()
    np.testing.assert_array_equal(decode(data, 6, 8, encoding, 16), grey)


@pytest.mark.parametrize(("encoding", "channels"), [("rgb16", 3), ("bgr16", 3), ("rgba16", 4)])
def test_colour_of_16_bits_is_read(encoding: str, channels: int) -> None:
    values = np.arange(12 * channels, dtype=np.uint16).reshape(3, 4, channels) * 300
    data = values.astype("<u2").tobytes()
    found = decode(data, 3, 4, encoding, 8 * channels)
    np.testing.assert_array_equal(found, values)
    swapped = values.astype(">u2").tobytes()
    np.testing.assert_array_equal(decode(swapped, 3, 4, encoding, 8 * channels, True), values)


def test_what_no_picture_has_is_not_named_as_known() -> None:
    with pytest.raises(InputError) as error:
        decode(bytes(12), 3, 4, "mono12", 4)
    assert "32FC1" not in str(error.value) and "bayer_rggb8" in str(error.value)


# Repeats -------------------------------------------------------------------------------------


def test_a_frozen_camera_is_told_from_a_drawn_scene() -> None:
    renderer = camera()
    stream = CameraStream(FtirSegmenter(calibration=renderer.calibration()))
    for _ in range(4):
        stream.signal(renderer.empty())
    frozen = renderer.render(RADIUS)
    stream.signal(frozen)
    for _ in range(3):
        with pytest.raises(LeftOut):
            stream.signal(frozen.copy())
    assert stream.repeats.in_a_row == stream.repeats.count == 3
    stream.signal(renderer.empty())
    assert stream.repeats.in_a_row == 0
    drawn = CameraStream(FtirSegmenter())
    picture = cv2.circle(np.full((480, WIDTH), 200, np.uint8), (320, 240), 90, 40, -1)
    for _ in range(9):
        drawn.signal(picture.copy())
