# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The FTIR renderer: the areas it gives as true are in the pixels."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_sim.ftir import AREA_PER_PIXEL, NOT_MODELLED, SKINS, Contact, FtirRenderer, Scene

CLEAN = Scene(noise=0.0, texture=0.0, dust=0, latent=0.0, vignetting=0.0, gradient=0.0, blur=0.0)


@pytest.mark.parametrize("tilt", [0.0, 20.0])
def test_changed_pixels_lie_in_the_contact_and_reach_its_rim(tilt: float) -> None:
    scene = Scene(**{**CLEAN.__dict__, "tilt": math.radians(tilt), "tilt_direction": 0.7})
    renderer = FtirRenderer("moist", seed=2, scene=scene)
    contact = Contact(4.5e-3, (1e-3, -0.5e-3), 1.4, 0.6)
    frame = renderer.render_frame([contact])
    changed = cv2.absdiff(frame.image, renderer.empty()) > 10
    rim = cv2.perspectiveTransform(contact.outline(400)[None], renderer.homography)[0]
    inside = np.zeros(changed.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint(rim).astype(np.int32)], 1)
    outside = cv2.dilate(inside, np.ones((5, 5), np.uint8)) == 0
    assert not changed[outside].any()
    hull = cv2.convexHull(np.argwhere(changed)[:, ::-1].astype(np.float32))
    assert cv2.contourArea(hull) == pytest.approx(inside.sum(), rel=0.03)
    assert frame.gross_area == pytest.approx(math.pi * 4.5e-3**2)


@pytest.mark.parametrize("skin", SKINS)
def test_real_area_is_that_of_the_dark_pixels(skin: str) -> None:
    renderer = FtirRenderer(skin, seed=3, scene=CLEAN)
    frame = renderer.render_frame([Contact(5e-3)])
    drop = renderer.empty().astype(float) - frame.image
    # Half of the local contrast marks the edge of a ridge.
    local = cv2.dilate(drop, np.ones((7, 7)))
    real = np.count_nonzero((drop > 0.5 * local) & (drop > 8)) * AREA_PER_PIXEL
    assert frame.real_area == pytest.approx(real, rel=0.05)
    assert frame.real_area < frame.gross_area


def test_moister_skin_touches_more_and_looks_stronger() -> None:
    shares = []
    for skin in ("dry", "natural", "moist"):
        frame = FtirRenderer(skin, seed=4, scene=CLEAN).render_frame([Contact(5e-3)])
        shares.append(frame.real_area / frame.gross_area)
    assert shares[0] < shares[1] < shares[2]
    assert 0.2 < shares[0] and shares[2] < 0.95


@pytest.mark.parametrize("period", [0.4e-3, 0.6e-3])
def test_ridges_have_the_period_asked_for(period: float) -> None:
    scene = Scene(**{**CLEAN.__dict__, "ridge_period": period})
    seen = []
    for seed in (6, 7, 8):
        image = FtirRenderer("natural", seed=seed, scene=scene).render(8e-3)
        patch = image[384:640, 512:768].astype(float)
        window = np.outer(np.hanning(256), np.hanning(256))
        power = np.abs(np.fft.fft2((patch - patch.mean()) * window)) ** 2
        cycles = np.hypot(*np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256)))
        band = (cycles > 0.03) & (cycles < 0.13)
        seen.append(math.sqrt(AREA_PER_PIXEL) / np.average(cycles[band], weights=power[band]))
    assert np.mean(seen) == pytest.approx(period, rel=0.15)


def test_same_seed_same_frames_other_seed_other_print() -> None:
    first, second = (FtirRenderer("dry", seed=7).render(4e-3) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    other = FtirRenderer("dry", seed=8).render(4e-3)
    assert np.mean(np.abs(first.astype(int) - other)) > 1


def test_bright_ridges_and_noise_level() -> None:
    scene = Scene(background=40, bright_ridges=True, noise=3.0, texture=0.0, dust=0, latent=0.0)
    renderer = FtirRenderer("natural", seed=9, scene=scene)
    difference = renderer.empty().astype(float) - renderer.empty()
    assert difference.std() == pytest.approx(3.0 * math.sqrt(2), rel=0.1)
    assert renderer.render(5e-3)[400:620, 530:750].mean() > renderer.empty().mean() + 40


def test_clipped_second_and_absent_contacts() -> None:
    renderer = FtirRenderer("natural", seed=10)
    assert renderer.render_frame([Contact(5e-3, (19e-3, 0))]).clipped
    frame = renderer.render_frame([Contact(4e-3), Contact(3e-3, (0, 12e-3))])
    assert not frame.clipped and frame.gross_area == pytest.approx(math.pi * 16e-6)
    nothing = renderer.render_frame([Contact(0.0)])
    assert (nothing.gross_area, nothing.real_area) == (0.0, 0.0)
    assert abs(nothing.image.mean() - renderer.empty().mean()) < 0.1


def test_settings_without_sense_are_refused_and_limits_are_stated() -> None:
    with pytest.raises(InputError, match="skin 'wet'"):
        FtirRenderer("wet")
    with pytest.raises(InputError, match="tilt"):
        FtirRenderer(scene=Scene(tilt=1.5))
    with pytest.raises(InputError, match="aspect"):
        FtirRenderer(seed=1).render(1e-3, aspect=0.5)
    assert len(NOT_MODELLED) >= 4
