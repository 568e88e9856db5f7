# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tilt and aspect in a world of its own: places and directions of finger, plate and sensor are
turned into each other by rotation matrices, and what is told of them may be wrong."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from finger_common.flags import ShapeFlag
from finger_model.estimator import ContactEstimate, ContactEstimator
from finger_model.estimator.estimate import ESTIMATE_FIELDS
from finger_model.geometry import Geometry, StatedGeometry
from finger_model.messages import plate_frame
from finger_model.people import People
from finger_model.pose.correction import PoseCorrection
from finger_model.pose.lengths import PEOPLE_SD, stretch_sd
from finger_model.pose.pose import Pose
from finger_model.pose.touch import first_touch
from finger_model.reduced import ReducedModel
from finger_model.shape.estimate import MeasuredOutline, ShapeEstimate
from finger_model.shape.estimator import PLACE_SD, SHAPE_SD, PoseEstimator
from finger_model.shape.settings import PoseSettings

SKIN = 60.0
RATE, FRAMES = 250, 10
"""Torques and outlines a second."""
LATE = 0.1
"""s that an outline comes after its stamp."""
TOLD = PoseSettings(pad_place_sd=2e-4, sensor_depth=0.02)
CERTAIN = math.radians(3.0)
DOWN = np.diag([1.0, -1.0, -1.0])
"""Axes of a sensor that looks down (rows) in the plate."""


@dataclass
class World:
    """A finger along y of the plate; press after press goes to one estimator.

    settings: what is told; stretch_sd: how badly the lengths are known, which are taken to be those
    of the default finger. geometry, skin: of the true finger. sensor (3,): true origin of the
    torque in the plate, z up (m); axes: those of the sensor (rows); reaction: it measures what the
    plate does to the finger. place (2,): true place of the pad (m).
    """

    settings: PoseSettings = TOLD
    sensor: tuple[float, float, float] = (0.0, 0.0, -0.02)
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    normal_axis: str = "-z"
    reaction: bool = False
    place: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    geometry: Geometry = field(default_factory=Geometry)
    skin: float = SKIN
    stretch_sd: float = 0.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        level = PoseCorrection(Geometry(), Pose(), SKIN, self.stretch_sd)
        self.estimator = PoseEstimator(level, self.settings, self.normal_axis)
        self.estimator.outlines.delay = LATE
        self.stamp = 10**9

    def wrench(self, force: float, place: np.ndarray) -> tuple[list[float], list[float]]:
        """Of a finger that presses at this place (2,) of the plate."""
        load = force * np.array([0.1, 0.05, -1.0])
        moment = np.cross(np.append(place, 0.0) - self.sensor, load)
        sign = -1.0 if self.reaction else 1.0
        noise = 2e-4 * self.rng.standard_normal(3)
        return (self.axes @ (sign * load)).tolist(), (self.axes @ (sign * moment) + noise).tolist()

    def sample(self, force: float, area: float, place: np.ndarray, onset: int) -> Any:
        """The shape, where one is due."""
        values: dict[str, Any] = {f.name: 0 for f in ESTIMATE_FIELDS}
        values |= {"stamp_ns": self.stamp, "onset_ns": onset, "in_contact": onset > 0}
        values |= {"parameter_set": "", "area": area, "normal_force": force}
        self.last = ContactEstimate(**values)
        found = self.estimator.add(self.last, *self.wrench(force, place))
        self.stamp += 10**9 // RATE
        return found

    def air(self, seconds: float, rest: float = 0.0) -> None:
        """Nothing in contact, or a finger that rests so lightly (N) that it is none."""
        for _ in range(round(seconds * RATE)):
            self.sample(rest, 0.0, np.array(self.place), 0)

    def press(
        self,
        pose: Pose | Callable[[float], Pose],
        seconds: float = 1.0,
        force: Callable[[float], float] = lambda t: min(0.1 + t, 1.1),
        outlines: bool = True,
    ) -> list[tuple[Pose, ShapeEstimate]]:
        """Poses and shapes of a press; the last shape is that of the end."""
        onset, found = self.stamp, []
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        for k in range(round(seconds * RATE)):
            t = k / RATE
            now = pose if isinstance(pose, Pose) else pose(t)
            area = 5e-5 * force(t) ** 0.6
            seen = PoseCorrection(self.geometry, now, self.skin).outline(area)
            if outlines and k % (RATE // FRAMES) == 0:
                self.see(seen, turn @ seen.center + self.place)
            place = turn @ seen.center_of_pressure + self.place
            shape = self.sample(force(t), area, place, onset)
            if shape is not None:
                found.append((now, shape))
        found.append((now, self.estimator.shape(self.last)))
        return found

    def see(self, seen: Any, center: np.ndarray) -> None:
        """A picture."""
        axes = 2.0 * np.array(seen.semi_axes) * (1.0 + 0.01 * self.rng.standard_normal(2))
        center = center + 5e-5 * self.rng.standard_normal(2)
        across = math.pi / 2 if axes[1] > axes[0] else 0.0
        angle = math.remainder(seen.orientation + math.pi / 2 + across, math.pi)
        major, minor = float(axes.max()), float(axes.min())
        outline = MeasuredOutline(
            (float(center[0]), float(center[1])), major, minor, angle, 5e-5, *(0.01 * axes)
        )
        self.estimator.expect_outline(self.stamp, outline)


def told(**changes: Any) -> PoseSettings:
    """TOLD with changes."""
    return replace(TOLD, **changes)


def error(pose: Pose, shape: ShapeEstimate) -> float:
    """Larger error of pitch and roll (rad)."""
    return max(abs(shape.pitch - pose.pitch), abs(shape.roll - pose.roll))


def deviation(shape: ShapeEstimate) -> float:
    """Larger deviation of the two (rad)."""
    return max(shape.pitch_stddev, shape.roll_stddev)


# Camera and torque -----------------------------------------------------------------------------


@pytest.mark.parametrize("pitch", [0.0, 15.0])
@pytest.mark.parametrize("aside", [2e-3, 5e-3, 10e-3])
def test_a_sensor_that_is_not_where_it_is_told_turns_no_finger(aside, pitch):
    """It did by 4 to 15°, with ±1.4° and without a flag."""
    pose = Pose(1.3, math.radians(pitch))
    shape = World(sensor=(0.0, aside, -0.02)).press(pose)[-1][1]
    assert error(pose, shape) < max(CERTAIN, 0.5 * deviation(shape))
    assert shape.pad_aspect == pytest.approx(1.3, abs=0.12)
    if aside > 4e-3:
        assert shape.flags & ShapeFlag.PRESSURE_OUTSIDE
        assert shape.flags & ShapeFlag.TILT_UNCERTAIN and deviation(shape) > CERTAIN
    assert World().press(pose)[-1][1].flags == 0


def test_what_of_camera_and_torque_is_wrong_is_not_known():
    """The plate of the camera is 5 mm beside that of finger and sensor."""
    pose = Pose(1.3)
    world = World(place=(0.0, 5e-3), sensor=(0.0, 0.0, -0.02))
    world.wrench = lambda force, place, own=world.wrench: own(force, place - [0.0, 5e-3])
    shape = world.press(pose)[-1][1]
    assert error(pose, shape) > math.radians(10.0)
    assert shape.flags & ShapeFlag.PRESSURE_OUTSIDE and shape.flags & ShapeFlag.TILT_UNCERTAIN


@pytest.mark.parametrize(
    "wrong",
    [
        {"settings": told(sensor_depth=-0.02)},
        {"reaction": True, "normal_axis": "+z"},
    ],
    ids=["depth of the other sign", "reaction"],
)
def test_a_wrench_of_the_wrong_sign_is_flagged(wrong):
    pose = Pose(1.3, math.radians(15.0), math.radians(-10.0))
    shape = World(**wrong).press(pose)[-1][1]
    assert error(pose, shape) < 3.0 * deviation(shape)
    assert shape.flags & ShapeFlag.PRESSURE_OUTSIDE and shape.flags & ShapeFlag.TILT_UNCERTAIN


def test_torque_alone_tells_the_tilt_as_well_as_the_sensors_place_is_known():
    pose = Pose(1.3, math.radians(15.0))
    known, not_known = (
        World(told(sensor_place_sd=sd)).press(pose, outlines=False)[-1][1] for sd in (0.0, 3e-3)
    )
    assert known.roll_stddev < math.radians(4.0) < 2.0 * known.roll_stddev < not_known.roll_stddev
    assert not_known.flags & ShapeFlag.TILT_UNCERTAIN


# A finger whose lengths are not known ----------------------------------------------------------


def presses_of_people(number, tilt, place_sd, unknown, longest=1.3):
    """Errors over deviations (n, 2) of pitch and roll, errors (n,) in rad and flags (n,) at the end
    of presses of other fingers than the default one, which the estimator takes them for. tilt
    (rad): deviation of pitch and roll; place_sd (m): of the pad's place; unknown: of the
    lengths."""
    found = []
    for seed in range(number):
        rng = np.random.default_rng([7, seed])
        person = People.default().draw(rng)
        place, sensor = place_sd * rng.standard_normal(2), 1e-3 * rng.standard_normal(2)
        world = World(
            told(pad_place_sd=place_sd),
            (*sensor.tolist(), -0.02),
            place=tuple(place.tolist()),
            seed=seed,
            geometry=person.geometry,
            skin=person.material.skin_ratio,
            stretch_sd=unknown,
        )
        turned = np.clip(tilt * rng.standard_normal(2), -0.45, 0.45).tolist()
        pose = Pose(float(rng.uniform(1.0, longest)), *turned)
        shape = world.press(pose)[-1][1]
        errors = np.array([shape.pitch - pose.pitch, shape.roll - pose.roll])
        ratios = errors / [shape.pitch_stddev, shape.roll_stddev]
        found.append((*ratios, error(pose, shape), shape.flags))
    table = np.array(found)
    return table[:, :2], table[:, 2], table[:, 3].astype(int)


@pytest.mark.slow
def test_a_finger_of_unknown_lengths_is_within_its_deviations():
    """Errors were 1.3 and 1.4 deviations (RMS), and 30 % of the tilts without a flag were more than
    3° wrong."""
    ratios, errors, flags = presses_of_people(80, math.radians(15.0), 1e-4, PEOPLE_SD)
    sizes = np.sqrt(np.mean(ratios**2, axis=0))
    assert np.all((sizes > 0.65) & (sizes < 1.1))
    certain = flags == 0
    assert 0.3 < certain.mean() < 0.6
    assert np.mean(errors[certain] > CERTAIN) < 0.22


def test_a_steep_tilt_is_uncertain_where_the_lengths_are_not_known():
    """A fifth of it, so that 3° are reached; a level plate tells it as before."""
    found = []
    for degrees in (0.0, 20.0):
        for unknown in (0.0, PEOPLE_SD):
            world = World(stretch_sd=unknown)
            found.append(world.press(Pose(1.2, math.radians(degrees)))[-1][1])
    level, unsure_level, steep, unsure = found
    assert level.flags == unsure_level.flags == steep.flags == 0
    assert unsure_level.pitch_stddev < 1.1 * level.pitch_stddev
    assert unsure.flags & ShapeFlag.TILT_UNCERTAIN
    assert unsure.pitch_stddev > math.radians(3.0) > 1.3 * steep.pitch_stddev


def test_presses_again_and_again_do_not_tell_the_lengths():
    world = World(stretch_sd=PEOPLE_SD)
    once = world.press(Pose(1.2, 0.3))[-1][1]
    for _ in range(4):
        world.air(0.5)
        again = world.press(Pose(1.2, 0.3), 2.0)[-1][1]
    assert again.pitch_stddev > 0.85 * once.pitch_stddev


def test_people_whose_fingers_are_anywhere_have_no_sure_tilt():
    """Where the place is known to 3 mm, errors are up to twice the stated deviations."""
    ratios, errors, flags = presses_of_people(40, math.radians(14.0), 3e-3, PEOPLE_SD, longest=1.0)
    assert np.all(np.sqrt(np.mean(ratios**2, axis=0)) < 2.5)
    assert not np.any((flags == 0) & (errors > CERTAIN))


def test_lengths_that_are_stated_count_with_their_deviations():
    finger, other = Geometry(), replace(Geometry(), pad_semi_axis_axial=5.6e-3)
    pad = {"pad_semi_axis_radial": 0.2e-3, "pad_semi_axis_axial": 0.1e-3}

    def sd(**deviations):
        return stretch_sd(finger, StatedGeometry(finger, deviations))

    assert stretch_sd(finger, None) == PEOPLE_SD == sd() == sd(pad_semi_axis_axial=0.0)
    assert stretch_sd(other, StatedGeometry(finger, pad)) == PEOPLE_SD
    assert sd(**dict.fromkeys(pad, 0.0)) == 0.0
    # As the place of the first touch changes.
    moved = 0.0
    for name, deviation in pad.items():
        places = [
            first_touch(replace(finger, **{name: getattr(finger, name) + step}), Pose(pitch=0.05))
            for step in (-deviation, deviation)
        ]
        moved += (0.5 * math.log(places[1].place[0] / places[0].place[0])) ** 2
    assert sd(**pad) == pytest.approx(math.sqrt(moved), rel=0.02)
    ball = replace(finger, pad_semi_axis_axial=8.5e-3)
    assert stretch_sd(ball, StatedGeometry(ball, pad)) == 1.0


def test_the_estimator_takes_the_lengths_as_known_only_where_they_are_stated():
    model = ReducedModel.load()
    exact = StatedGeometry(Geometry(), {"pad_semi_axis_radial": 0.0, "pad_semi_axis_axial": 0.0})
    found = [ContactEstimator(model, stated=stated) for stated in (None, exact)]
    assert [e.pose_correction.stretch_sd for e in found] == [PEOPLE_SD, 0.0]


def test_the_deviation_between_people_is_that_of_their_fingers(module_of):
    found = module_of("scripts/pose_people.py").errors(1000, seed=3)
    assert math.sqrt(np.mean(found.factor**2)) == pytest.approx(PEOPLE_SD, rel=0.1)
    for rest in (found.rest, found.torque_rest):
        assert math.sqrt(np.mean(rest**2)) < 0.5 * PLACE_SD
    assert math.sqrt(np.mean(found.shape**2)) < 0.6 * SHAPE_SD


# A finger that turns ---------------------------------------------------------------------------


@functools.cache
def rolled(rate, settings=TOLD):
    """Errors (rad), deviations (rad) and flags (n,), from the first outline on, while a finger
    rolls from −10° to 10° at `rate` (°/s), after half a second; its place is known to 0.2 mm."""
    found = []
    for seed in range(4):
        rng = np.random.default_rng(50 + seed)
        world = World(settings, place=tuple(2e-4 * rng.standard_normal(2)), seed=seed)

        def pose(t: float) -> Pose:
            turn = min(max(t - 0.5, 0.0) * rate, 20.0)
            return Pose(1.3, math.radians(5.0), math.radians(turn - 10.0))

        path = world.press(pose, 1.0 + 20.0 / rate, lambda t: 1.0)
        seen = [both for both in path if not both[1].flags & ShapeFlag.OUTLINE_MISSING]
        found += [(error(*both), deviation(both[1]), both[1].flags) for both in seen]
    errors, deviations, flags = np.transpose(found)
    return errors, deviations, flags.astype(int)


@pytest.mark.parametrize("rate", [2.0, 5.0])
def test_a_finger_that_rolls_slowly_is_followed(rate):
    """It was up to 8.3 ± 3.0° behind at 5°/s, unflagged."""
    errors, deviations, flags = rolled(rate)
    assert math.sqrt(np.mean((errors / deviations) ** 2)) < 1.2
    certain = flags == 0
    assert certain.mean() > 0.9
    assert np.mean(errors[certain] > CERTAIN) < 0.15
    assert errors[certain].max() < math.radians(4.5)


def test_the_deviation_grows_with_a_finger_that_rolls_fast():
    """At 20°/s errors were up to 11.6 ± 2.6°, more than 60 % of the shapes without flags wrong."""
    errors, deviations, flags = rolled(20.0)
    assert math.sqrt(np.mean((errors / deviations) ** 2)) < 1.3
    assert np.mean(flags & ShapeFlag.TILT_UNCERTAIN > 0) > 0.2
    assert errors[flags == 0].max() < math.radians(7.0)


def test_a_finger_that_is_said_to_roll_is_followed_faster():
    (slow, _, _), (fast, deviations, flags) = rolled(20.0), rolled(20.0, told(tilt_wander=0.1))
    assert np.mean(fast**2) < 0.6 * np.mean(slow**2)
    assert math.sqrt(np.mean((fast / deviations) ** 2)) < 1.0
    assert fast[flags == 0].max() < math.radians(4.5)


def test_a_place_that_is_known_stays_known():
    """The deviation of the place holds all the time."""
    world = World(told(tilt_wander=0.0))
    path = world.press(Pose(1.3, 0.1), 12.0, lambda t: 1.0)
    early, late = (path[k][1] for k in (len(path) // 6, -1))
    assert late.roll_stddev == pytest.approx(early.roll_stddev, rel=0.25)
    assert early.flags == late.flags == 0


def test_more_outlines_do_not_make_the_corrections_error_smaller():
    """It is the same in all of them as long as the force is held."""
    world = World(told(tilt_wander=0.0, pad_place_sd=1e-5))
    path = world.press(Pose(1.3, 0.1), 6.0, lambda t: 1.0, outlines=True)
    early, late = (path[k][1] for k in (len(path) // 6, -1))
    assert late.pitch_stddev == pytest.approx(early.pitch_stddev, rel=0.1)
    assert late.pitch_stddev > math.radians(0.5)


# The sensor ------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(0.0, 0.0), (2e-3, -3e-3)])
@pytest.mark.parametrize(("pitch", "roll"), [(15.0, 0.0), (0.0, 15.0), (15.0, -10.0), (0.0, 0.0)])
def test_a_sensor_behind_the_finger_tells_the_same(place, pitch, roll):
    """It looks down, 50 mm above the plate; no setting made its tilt right."""
    pose = Pose(1.3, math.radians(pitch), math.radians(roll))
    x, y = place
    sensor = {"pad_x": x, "pad_y": y, "sensor_x": x, "sensor_y": y, "sensor_depth": -0.05}
    found = []
    for on_finger in (True, False):
        settings = told(**sensor, wrench_on_finger=on_finger, sensor_place_sd=0.0)
        world = World(settings, (x, y, 0.05), DOWN, "-z", True, place)
        found.append(world.press(pose, outlines=True)[-1][1])
    assert found[0].flags == 0 and error(pose, found[0]) < CERTAIN
    under = World(told(sensor_place_sd=0.0, pad_x=x, pad_y=y), place=place)
    under.press(pose)
    pressed = under.estimator.shape(under.last).center_of_pressure
    assert found[0].center_of_pressure == pytest.approx(pressed, abs=0.4e-3)
    assert found[1].flags


@pytest.mark.parametrize(("normal_axis", "axes"), [("+z", np.eye(3)), ("-z", DOWN)])
def test_a_sensor_under_the_plate_that_gives_the_reaction_is_understood(normal_axis, axes):
    pose = Pose(1.3, math.radians(15.0), math.radians(-10.0))
    settings = told(wrench_on_finger=True)
    shape = World(settings, axes=axes, normal_axis=normal_axis, reaction=True).press(pose)[-1][1]
    assert shape.flags == 0 and error(pose, shape) < CERTAIN


@pytest.mark.parametrize("seconds", [2.0, pytest.param(6.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("torque", "most"), [(False, 1.6), (True, 2.0)])
def test_a_pad_whose_place_is_hardly_known_has_no_sure_tilt(seconds, torque, most):
    """With the default deviation of its place; nothing that repeats makes the tilt sure."""
    settings = PoseSettings(sensor_depth=0.02)
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        place = settings.pad_place_sd * rng.standard_normal(2)
        world = World(settings, place=tuple(place.tolist()), seed=seed)
        if not torque:
            world.wrench = lambda force, place: ([0.0, 0.0, -force], [0.0, 0.0, 0.0])
        tilt = np.clip(math.radians(12.0) * rng.standard_normal(2), -0.35, 0.35)
        pose = Pose(float(rng.uniform(1.0, 1.5)), *tilt.tolist())
        shape = world.press(pose, seconds, lambda t: 1.0)[-1][1]
        errors = np.array([shape.pitch - pose.pitch, shape.roll - pose.roll])
        ratios.extend((errors / [shape.pitch_stddev, shape.roll_stddev]).tolist())
        assert shape.flags & ShapeFlag.TILT_UNCERTAIN or error(pose, shape) < CERTAIN
    assert np.sqrt(np.mean(np.square(ratios))) < most


# Before and after a contact --------------------------------------------------------------------


@pytest.mark.parametrize("rest", [0.02, 0.04])
def test_a_finger_that_rested_lightly_is_no_zero_of_the_torque(rest):
    """20 mm beside the torque's origin: the tilt was 13 to 15 ± 1.7°, without a flag."""
    found = []
    for force in (0.0, rest):
        world = World(told(sensor_x=0.02), sensor=(0.02, 0.0, -0.02))
        world.air(1.0)
        world.air(1.0, force)
        shape = world.press(Pose(1.2))[-1][1]
        assert error(Pose(1.2), shape) < CERTAIN
        assert error(Pose(1.2), shape) < 2.0 * deviation(shape)
        world.air(1.0)
        world.air(1.0, force)
        alone = world.press(Pose(1.2), outlines=False)[-1][1]
        assert error(Pose(1.2), alone) < 2.0 * deviation(alone)
        found.append(deviation(alone))
    assert found[1] > found[0]


def test_another_finger_is_learned_in_its_first_contact():
    """Of an aspect of 1.05 after 1.5 it was 1.25 ± 0.01 after four presses."""
    world = World()
    for _ in range(4):
        world.press(Pose(1.5, math.radians(5.0)))
        world.air(1.0)
    other = Pose(1.05, math.radians(5.0))
    shape = world.press(other)[-1][1]
    assert shape.pad_aspect == pytest.approx(1.05, abs=0.06)
    assert abs(shape.pad_aspect - 1.05) < 3.0 * shape.pad_aspect_stddev
    assert error(other, shape) < CERTAIN


def test_an_aspect_that_is_known_stays():
    world = World(told(pad_aspect_sd=0.0))
    world.press(Pose(1.3))
    world.air(1.0)
    assert world.press(Pose(1.3))[-1][1].pad_aspect == 1.0


def test_a_tilt_that_is_known_stays():
    world = World(told(tilt_sd=0.0))
    shape = world.press(Pose(1.3, 0.1))[-1][1]
    assert (shape.pitch, shape.roll, shape.pitch_stddev) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("area", "sensor", "wanted"),
    [
        ("", "force_sensor", "plate"),
        ("", "", "plate"),
        ("", "hand/thumb/force_sensor", "hand/thumb/plate"),
        ("glass", "hand/thumb/force_sensor", "glass"),
    ],
)
def test_the_numbers_of_a_shape_are_in_the_frame_of_the_plate(area, sensor, wanted):
    assert plate_frame(area, sensor) == wanted
