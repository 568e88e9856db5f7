# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which of several contacts on the plate is measured, from frame to frame."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_sim.ftir import Contact, FtirRenderer, Scene
from finger_vision.area_sensor import ContactMeasurement, NoLight
from finger_vision.cli import main
from finger_vision.ftir import FtirSegmenter

FINGER = Contact(3.1e-3, (-7e-3, 0.0))
OTHER = Contact(4.2e-3, (7e-3, 0.0))


@pytest.fixture(scope="module")
def renderer() -> FtirRenderer:
    return FtirRenderer("natural", 4, Scene(latent=0.0))


def segmenter_of(renderer: FtirRenderer) -> FtirSegmenter:
    segmenter = FtirSegmenter()
    for _ in range(3):
        segmenter.process(renderer.empty())
    return segmenter


def picture(renderer: FtirRenderer, *contacts: Contact) -> np.ndarray:
    return renderer.render_frame(list(contacts)).image if contacts else renderer.empty()


def is_of(seen: ContactMeasurement, contact: Contact) -> bool:
    """Whether the contact, and all of it, was measured."""
    near = math.dist(seen.centroid, contact.centre) < 0.5e-3
    return near and abs(seen.gross_area / (math.pi * contact.radius**2) - 1) < 0.06


def at(contact: Contact, x: float, y: float = 0.0, scale: float = 1.0) -> Contact:
    return Contact(scale * contact.radius, (x, y), contact.aspect, contact.angle)


def test_a_larger_second_finger_does_not_take_the_place_of_the_measured_one(renderer) -> None:
    """Also while the first slides and grows, and after frames that cannot be used."""
    segmenter = segmenter_of(renderer)
    for finger in (at(FINGER, -7e-3, 0.0, 0.5), FINGER):
        assert is_of(segmenter.process(picture(renderer, finger)), finger)
    for index, x in enumerate((-7e-3, -9e-3, -11e-3, -9e-3, -6e-3)):
        finger = at(FINGER, x, 0.0, 1.0 + 0.05 * index)
        seen = segmenter.process(picture(renderer, finger, OTHER))
        assert is_of(seen, finger)
        assert seen.flags & AreaFlag.MULTIPLE_REGIONS and not seen.flags & AreaFlag.CLIPPED
        with pytest.raises(NoLight):
            segmenter.process(np.full((1024, 1280), 3, np.uint8))
        with pytest.raises(InputError):
            segmenter.process(np.zeros((480, 640), np.uint8))
    assert is_of(segmenter.process(picture(renderer, OTHER)), OTHER)


@pytest.mark.parametrize("forget", ["empty", "learn", "reset"])
def test_no_finger_is_followed_over_a_frame_without_contact(renderer, forget: str) -> None:
    segmenter = segmenter_of(renderer)
    segmenter.process(picture(renderer, FINGER))
    if forget == "empty":
        segmenter.process(renderer.empty())
    elif forget == "learn":
        segmenter.learn(renderer.empty())
    else:
        segmenter.reset()
    assert is_of(segmenter.process(picture(renderer, FINGER, OTHER)), OTHER)


def test_after_two_contacts_joined_and_parted_the_first_is_measured(renderer) -> None:
    segmenter = segmenter_of(renderer)
    joined = FINGER.radius + OTHER.radius - 7e-3 + 0.2e-3
    assert is_of(segmenter.process(picture(renderer, FINGER)), FINGER)
    for x in (7e-3, 3e-3, joined, joined, joined, 3e-3, 7e-3):
        other = at(OTHER, x)
        seen = segmenter.process(picture(renderer, FINGER, other))
        if x == joined:
            assert not seen.flags & AreaFlag.MULTIPLE_REGIONS
        else:
            assert is_of(seen, FINGER) and seen.flags & AreaFlag.MULTIPLE_REGIONS


def test_a_finger_that_slides_over_dirt_is_not_lost(renderer) -> None:
    """It takes up a contact of its way and leaves it behind."""
    segmenter = segmenter_of(renderer)
    dirt = Contact(1.2e-3, (0.0, 0.0))
    for x in np.arange(-8e-3, 8.1e-3, 2e-3):
        seen = segmenter.process(picture(renderer, at(FINGER, x), dirt))
        if abs(x) > 5.5e-3:
            assert is_of(seen, at(FINGER, x))


def test_a_contact_that_is_whole_in_the_frame_goes_before_one_that_is_cut(renderer) -> None:
    cut = Contact(4.5e-3, (17e-3, 0.0))
    for contacts in ([FINGER, cut], [at(FINGER, -4e-3, 6e-3), cut]):
        seen = segmenter_of(renderer).process(picture(renderer, *contacts))
        assert is_of(seen, contacts[0]) and not seen.flags & AreaFlag.CLIPPED


def test_an_open_choice_between_contacts_is_flagged_as_not_whole(renderer) -> None:
    """Until only one is there; dirt beside a finger is none."""
    segmenter = segmenter_of(renderer)
    for _ in range(3):
        seen = segmenter.process(picture(renderer, FINGER, OTHER))
        assert is_of(seen, OTHER) and seen.flags & AreaFlag.CLIPPED
    assert not segmenter.process(picture(renderer, OTHER)).flags & AreaFlag.CLIPPED
    dirt = at(FINGER, -7e-3, 0.0, 0.6)
    seen = segmenter_of(renderer).process(picture(renderer, dirt, OTHER))
    assert seen.flags & AreaFlag.MULTIPLE_REGIONS and not seen.flags & AreaFlag.CLIPPED


def test_a_finger_beside_one_that_rests_from_the_start_is_flagged_as_not_whole(renderer) -> None:
    """The one at rest may be no finger, or not the one that presses."""
    segmenter = segmenter_of(renderer)
    for _ in range(3):
        assert not segmenter.process(picture(renderer, FINGER)).flags & AreaFlag.CLIPPED
    for scale in (0.6, 0.9, 1.2):
        seen = segmenter.process(picture(renderer, FINGER, at(OTHER, 6e-3, 0.0, scale)))
        assert is_of(seen, FINGER) and seen.flags & AreaFlag.CLIPPED


def test_a_finger_that_is_held_is_not_taken_for_dirt(renderer) -> None:
    segmenter = segmenter_of(renderer)
    small, large = at(FINGER, -7e-3, 0.0, 0.8), at(OTHER, 6e-3, 0.0, 1.4)
    for scale in (0.3, 0.6, 0.8):
        segmenter.process(picture(renderer, at(FINGER, -7e-3, 0.0, scale)))
    held = picture(renderer, small)
    for _ in range(20):
        segmenter.process(held)
    assert is_of(segmenter.process(picture(renderer, small, large)), small)


def test_images_on_a_command_line_do_not_follow_each_other(renderer, tmp_path) -> None:
    names = {"plate": (), "one": (FINGER,), "both": (FINGER, OTHER)}
    for name, contacts in names.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture(renderer, *contacts))
    plate, one, both = (str(tmp_path / f"{name}.png") for name in names)
    rows = []
    for images in ([both], [one, both]):
        out = tmp_path / "areas.csv"
        assert main(["area", *images, "--background", plate, "-o", str(out)]) == 0
        rows.append(out.read_text().splitlines()[-1])
    assert rows[0] == rows[1]
