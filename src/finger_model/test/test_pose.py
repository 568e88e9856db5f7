# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Elliptical pads and tilted plates: first touch, the learned correction, aspect and tilt found."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.flags import ShapeFlag, StateFlag
from finger_model.estimator import ContactEstimate, ContactEstimator, EstimatorSettings
from finger_model.estimator.estimate import ESTIMATE_FIELDS
from finger_model.geometry import Geometry
from finger_model.laws import GeneralizedMaxwell2, StandardLinearSolid
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.pose.correction import STEEP, PoseCorrection
from finger_model.pose.pose import Pose
from finger_model.pose.touch import first_touch
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population
from finger_model.shape.estimate import MeasuredOutline
from finger_model.shape.estimator import PoseEstimator
from finger_model.shape.settings import PoseSettings
from finger_model.shape.torque_zero import TorqueZero
from finger_model.verification.cases import CALCULIX_FINGER, STUDY, reference, smooth_area

ROUND = 40e-6
SKIN = 60.0
"""Modulus of the epidermis over that of the tissue."""
DIRECTION = 0.7
TURN = np.array(
    [
        [math.cos(DIRECTION), -math.sin(DIRECTION)],
        [math.sin(DIRECTION), math.cos(DIRECTION)],
    ]
)


@pytest.mark.parametrize("name", ["pitch", "roll"])
@pytest.mark.parametrize("degrees", [6.0, -13.0, 19.0, 25.0])
def test_a_tilt_in_degrees_is_refused(name, degrees):
    """Such a tilt in radians differs from a small one by whole turns."""
    assert Pose(**{name: math.radians(degrees)}).tilt == pytest.approx(math.radians(abs(degrees)))
    with pytest.raises(
        InputError, match=f"plate {name} is {degrees:g} rad, which is .*, beyond 45°"
    ):
        Pose(**{name: degrees})


def test_a_round_pad_on_a_level_plate_is_not_corrected():
    level = PoseCorrection(Geometry(), Pose(), SKIN)
    found = level.outline(ROUND)
    assert found.area == ROUND
    assert found.semi_axes == pytest.approx((math.sqrt(ROUND / math.pi),) * 2)
    assert np.all(found.center == 0.0) and np.all(found.center_of_pressure == 0.0)


def test_first_touch_is_where_calculix_sees_the_contact_begin():
    touch = first_touch(CALCULIX_FINGER, Pose(pitch=math.radians(20.0)))
    table = reference("tilt_20deg")
    assert touch.place[0] * 1e3 == pytest.approx(table["center_x_mm"][0], abs=0.02)
    assert touch.place[1] == 0.0
    # The curvatures of a level ellipsoid are known.
    long = first_touch(CALCULIX_FINGER, Pose(1.35))
    assert long.elongation == pytest.approx([math.log(1.35), 0.0])
    assert long.bluntness == pytest.approx(math.log(1.35))
    assert long.thickness == pytest.approx(0.0)
    # Beside the bone the tissue is thicker; at 90° it would be 5 mm where it was 4 mm.
    assert 0.0 < touch.thickness < math.log(5.0 / 4.0)


@pytest.mark.parametrize(("pitch", "roll"), [(0.3, 0.0), (0.0, 0.3), (0.2, -0.15)])
def test_opposite_tilts_mirror_the_contact(pitch, roll):
    one = PoseCorrection(Geometry(), Pose(1.3, pitch, roll), SKIN).outline(ROUND)
    other = PoseCorrection(Geometry(), Pose(1.3, -pitch, roll), SKIN).outline(ROUND)
    assert other.area == pytest.approx(one.area)
    assert other.center == pytest.approx(one.center * [-1.0, 1.0], abs=0.1e-3)
    assert math.cos(2 * other.orientation) == pytest.approx(math.cos(2 * one.orientation), abs=0.05)


def test_a_longer_pad_has_a_larger_contact_and_its_area_can_be_inverted():
    poses = [Pose(aspect) for aspect in (1.0, 1.2, 1.4, 1.6)]
    areas = [PoseCorrection(Geometry(), pose, SKIN).outline(ROUND).area for pose in poses]
    assert np.all(np.diff(areas) > 0.03 * ROUND)
    tilted = PoseCorrection(Geometry(), Pose(1.4, 0.4, 0.1), SKIN)
    assert tilted.round_area(tilted.outline(ROUND).area) == pytest.approx(ROUND, rel=1e-6)


def test_poses_and_fingers_that_were_not_learned_are_named():
    assert PoseCorrection(Geometry(), Pose(1.6, math.radians(30)), SKIN).inside
    assert not PoseCorrection(Geometry(), Pose(1.7), SKIN).inside
    assert PoseCorrection(Geometry(), Pose(0.96), SKIN).inside
    assert not PoseCorrection(Geometry(), Pose(0.9), SKIN).inside
    assert not PoseCorrection(Geometry(), Pose(1.2, math.radians(35)), SKIN).inside
    assert PoseCorrection(CALCULIX_FINGER, Pose(1.2), SKIN).inside
    assert not PoseCorrection(Geometry(), Pose(1.2), 11.0).inside
    assert not PoseCorrection(Geometry(), Pose(1.2), 130.0).inside
    flat = replace(Geometry(), pad_semi_axis_axial=4.5e-3)
    assert not PoseCorrection(flat, Pose(1.2), SKIN).inside
    assert not PoseCorrection(replace(Geometry(), bone_center_height=1e-3), Pose(1.2), SKIN).inside


@pytest.mark.parametrize(
    ("name", "pose", "error"),
    [("tilt_20deg", Pose(pitch=math.radians(20.0)), 0.025), ("ellipse_135", Pose(1.35), 0.04)],
)
def test_areas_of_a_finger_that_was_not_learned_are_those_of_calculix(name, pose, error):
    """CalculiX's own areas scatter by 2 and 2.5 %."""
    table = reference(name)
    load = table["normal_force_n"]
    known = load > 0.1
    # The tissue of these runs is a little stiffer than that of the round pad's, 30.23 kPa.
    level = 1e-6 * smooth_area("dry_frictionless", load[known] * 30.0 / 30.23)
    correction = PoseCorrection(CALCULIX_FINGER, pose, STUDY["dry"].skin_ratio)
    found = [correction.outline(area).area for area in level]
    assert found == pytest.approx(1e-6 * table["area_mm2"][known], rel=error)


def test_fingers_that_were_kept_aside_are_within_what_is_stated():
    file = resources.files("finger_model") / "data" / "pose_held_out.csv"
    errors, steep = [], []
    for row in csv.DictReader(file.read_text().splitlines()):
        value = {name: float(text) for name, text in row.items()}
        lengths = (value[k] for k in "width height skin bone_width bone_height".split())
        tilt = math.radians(value["pitch_deg"]), math.radians(value["roll_deg"])
        correction = PoseCorrection(
            Geometry(*lengths, 0.0, value["nail"]),
            Pose(value["aspect"], *tilt),
            value["skin_ratio"],
        )
        if correction.depth(value["round_area_m2"]) > 0.2:
            found = correction.outline(value["round_area_m2"])
            ratio = found.semi_axes[0] / found.semi_axes[1] * value["axis_b_m"] / value["axis_a_m"]
            center = found.center - [value["center_x_m"], value["center_y_m"]]
            area = math.log(found.area / value["area_m2"])
            errors.append([area, math.log(ratio), float(np.hypot(*center)), correction.area_sd])
            steep.append(math.hypot(*correction.touch.aside) > STEEP)
    area, ratio, center, sd = np.transpose(errors)
    flat = ~np.array(steep)
    within = np.abs(area) < 0.02
    assert within.mean() > 0.85 and within[flat].mean() > 0.9
    assert math.sqrt(np.mean(ratio**2)) < 0.015
    assert math.sqrt(np.mean(center**2)) < 0.1e-3
    for kind in (flat, ~flat):
        assert math.sqrt(np.mean((area[kind] / sd[kind]) ** 2)) == pytest.approx(1.0, abs=0.1)


def test_the_correction_widens_the_estimate_by_its_own_error():
    sds = []
    for aspect, pitch in ((1.0, 0.0), (1.3, 0.0), (1.6, math.radians(29.0))):
        settings = EstimatorSettings(pad_aspect=aspect, plate_pitch=pitch)
        estimator = ContactEstimator(ReducedModel.load(), settings=settings)
        for k in range(300):
            out = estimator.add_wrench(10**9 + 2_000_000 * k, (0.0, 0.0, -0.004 * k))
        sds.append(out[-1].area_stddev / out[-1].area)
    assert sds[0] < sds[1] < sds[2]
    assert math.sqrt(sds[2] ** 2 - sds[0] ** 2) > 0.06


def estimate(stamp, area, force):
    """Of a contact that began a second after the epoch."""
    values = {field.name: 0 for field in ESTIMATE_FIELDS}
    values |= {"stamp_ns": stamp, "area": area, "normal_force": force, "in_contact": force > 0.05}
    return ContactEstimate(**{**values, "onset_ns": 10**9, "parameter_set": ""})


def follow(
    pose, torque=True, camera=True, place_error=0.2e-3, seed=0, bias=0.0, repeated=1, assumed=None
):
    """The shape found at the end of a press of a second in this pose; bias: of the torque (N m);
    every outline comes `repeated` times; assumed: first guess of the pose."""
    rng = np.random.default_rng(seed)
    place = np.array([1e-3, -2e-3])
    settings = PoseSettings(
        pad_x=float(place[0] + place_error * rng.standard_normal()),
        pad_y=float(place[1] + place_error * rng.standard_normal()),
        pad_place_sd=place_error,
        finger_direction=DIRECTION,
        sensor_depth=0.02,
    )
    estimator = PoseEstimator(PoseCorrection(Geometry(), assumed or Pose(), SKIN), settings)
    estimator.outlines.delay = 0.1
    correction = PoseCorrection(Geometry(), pose, SKIN)
    for k in range(250):
        stamp, force = 10**9 + k * 4_000_000, 0.1 + 1.2 * k / 250
        area = 44e-6 * force**0.6
        seen = correction.outline(area)
        if camera and k % 25 == 0:
            center = place + TURN @ seen.center + 5e-5 * rng.standard_normal(2)
            major, minor = np.array(seen.semi_axes) * 2 * (1 + 0.01 * rng.standard_normal(2))
            angle = seen.orientation + DIRECTION
            outline = MeasuredOutline(
                (float(center[0]), float(center[1])),
                max(major, minor),
                min(major, minor),
                angle,
                5e-5,
                0.01 * major,
                0.01 * minor,
            )
            for _ in range(repeated):
                estimator.expect_outline(stamp, outline)
        pull = np.array([0.1 * force, -0.05 * force, -force])
        pressed = place + TURN @ seen.center_of_pressure
        moment = np.cross([*pressed, 0.02], pull) + bias + 3e-4 * rng.standard_normal(3)
        estimator.add(estimate(stamp, area, force), pull, moment if torque else (0.0,) * 3)
    return estimator.shape(estimate(stamp, area, force)), correction.outline(area)


@pytest.mark.parametrize(
    "pose", [Pose(1.3, 0.35, 0.0), Pose(1.2, -0.2, 0.15), Pose(1.5), Pose(1.1, 0.1, -0.25)]
)
def test_aspect_and_tilt_are_found_within_three_degrees(pose):
    shape, true = follow(pose)
    assert shape.pitch == pytest.approx(pose.pitch, abs=math.radians(3))
    assert shape.roll == pytest.approx(pose.roll, abs=math.radians(3))
    assert shape.pad_aspect == pytest.approx(pose.aspect, abs=0.08)
    assert abs(shape.pitch - pose.pitch) < 3 * shape.pitch_stddev
    assert shape.semi_axis_major / shape.semi_axis_minor == pytest.approx(
        true.semi_axes[0] / true.semi_axes[1], rel=0.03
    )
    ellipse = math.pi * shape.semi_axis_major * shape.semi_axis_minor
    assert ellipse == pytest.approx(shape.area, rel=1e-9)
    turn = (shape.angle - true.orientation - DIRECTION + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    if true.semi_axes[0] > 1.1 * true.semi_axes[1]:
        assert abs(turn) < 0.1


def test_torque_alone_tells_the_tilt_as_well_as_it_says():
    shape, _ = follow(Pose(1.0, 0.3, 0.0), camera=False)
    assert shape.flags & ShapeFlag.OUTLINE_MISSING
    # Without an outline the aspect is not known, and with it how far a tilt moves the contact.
    assert abs(shape.pitch - 0.3) < 2 * shape.pitch_stddev < math.radians(24)


def test_a_finger_whose_place_is_not_known_says_so():
    shape, _ = follow(Pose(1.3, 0.35), place_error=3e-3)
    assert shape.flags & ShapeFlag.TILT_UNCERTAIN
    assert not follow(Pose(1.3, 0.35), torque=False)[0].flags & ShapeFlag.TILT_UNCERTAIN
    # A long pad that rolls moves little.
    aside, _ = follow(Pose(1.5), place_error=0.8e-3)
    assert aside.pitch_stddev < math.radians(2.5) < math.radians(5.0) < aside.roll_stddev
    assert aside.flags & ShapeFlag.TILT_UNCERTAIN


def test_a_torque_that_was_not_tared_is_flagged_and_left_out():
    pose = Pose(1.3, 0.35)
    shape, _ = follow(pose, bias=0.05)
    assert shape.flags & ShapeFlag.PRESSURE_OUTSIDE
    assert math.hypot(*shape.center_of_pressure) > 0.02
    without = follow(pose, torque=False)[0]
    assert shape[7:13] == without[7:13]
    assert not follow(pose)[0].flags & ShapeFlag.PRESSURE_OUTSIDE


@pytest.mark.parametrize("guess", [Pose(2.0), Pose(0.5), Pose(1.0, math.radians(44.9))])
def test_a_guess_at_the_ends_of_its_range_is_followed(guess):
    """A user may set it: the search begins within what the correction holds for."""
    shape, _ = follow(Pose(1.3, 0.2), assumed=guess)
    assert 0.5 < shape.pad_aspect < 2.0 and abs(shape.pitch) < math.radians(45.0)


@pytest.mark.parametrize(("pitch", "roll"), [(40.0, 0.0), (0.0, 40.0)])
def test_an_aspect_is_not_learned_at_a_tilt_that_the_correction_does_not_know(pitch, roll):
    """It would stay for the contacts that follow."""
    tilt = math.radians(pitch), math.radians(roll)
    shape, _ = follow(Pose(1.5, *tilt), assumed=Pose(1.2, *tilt))
    assert shape.flags & ShapeFlag.OUT_OF_RANGE
    assert shape.pad_aspect == pytest.approx(1.2)
    assert shape.pad_aspect_stddev == pytest.approx(1.2 * PoseSettings().pad_aspect_sd)


@pytest.mark.parametrize("guess", [1.7, 2.0])
def test_an_aspect_that_the_correction_does_not_know_is_left_by_learning(guess):
    shape, _ = follow(Pose(1.3, 0.2), assumed=Pose(guess))
    assert shape.pad_aspect == pytest.approx(1.3, abs=0.05)
    assert not shape.flags & ShapeFlag.OUT_OF_RANGE


def test_an_outline_that_comes_twice_counts_once():
    once, twice = follow(Pose(1.3, 0.35))[0], follow(Pose(1.3, 0.35), repeated=2)[0]
    assert once == twice


@pytest.mark.parametrize("turned", [-2.0, 0.5 * math.pi])
@pytest.mark.parametrize("normal_axis", ["-z", "+z", "+x", "-y"])
def test_a_sensor_turned_about_the_normal_tells_the_same_when_its_direction_is_given(
    normal_axis, turned
):
    """The centre of pressure is that of an aligned sensor below the plate, whose z points up."""
    pressed, pull = np.array([1.2e-3, -0.7e-3, 0.02]), np.array([0.1, -0.05, -1.0])
    moment = np.cross(pressed, pull)
    along = np.array([math.cos(turned), math.sin(turned), 0.0])
    up = np.array([0.0, 0.0, 1.0 if normal_axis[0] == "-" else -1.0])
    of_normal = "xyz".index(normal_axis[1])
    axes = np.zeros((3, 3))  # of the sensor (rows) in the plate
    axes[of_normal], axes[(of_normal + 1) % 3] = up, along
    axes[(of_normal + 2) % 3] = np.cross(up, along)
    for direction, same in ((turned, True), (0.0, False)):
        settings = PoseSettings(sensor_depth=0.02, sensor_direction=direction)
        estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN), settings, normal_axis)
        for k in range(10):
            sample = estimate(10**9 + 10**7 * k, ROUND, 1.0)
            estimator.add(sample, axes @ pull, axes @ moment)
        found = estimator.shape(sample).center_of_pressure
        assert (found == pytest.approx(tuple(pressed[:2]), abs=1e-9)) is same


# In the estimator -----------------------------------------------------------------------------

T0, MS = 1_700_000_000_000_000_000, 1_000_000
TILTED = EstimatorSettings(fuse_area=False, pad_aspect=1.3, plate_pitch=math.radians(20.0))


def finger_with_skin(ratio, tissue=30e3):
    """Material whose epidermis has `ratio` times the long-term modulus of its tissue (Pa)."""
    E0 = 140e3
    return StandardLinearSolid(E0=E0, E1=1 / (1 / tissue - 1 / E0), tau1=0.1, E2=ratio * tissue)


def sets_of(*materials, moistures=(69.0,)):
    sets = [
        ParameterSet(f"at {moisture}", moisture, 0.0, tuple(material.vector()))
        for moisture, material in zip(moistures, materials, strict=True)
    ]
    return ParameterSets(sets, law=type(materials[0]))


def pressed(estimator, to=2.9):
    """Estimates of a press to a force (N) in a second."""
    found = []
    for k in range(500):
        found += estimator.add_wrench(T0 + 2 * k * MS, (0.0, 0.0, -to * (k + 1) / 500))
    return found


def areas_of_truth(number):
    """Round and tilted areas (m²) of a finger kept aside, aspect 1.3 and pitch 20° or alike."""
    file = resources.files("finger_model") / "data" / "pose_held_out.csv"
    with file.open() as text:
        rows = [r for r in csv.DictReader(text) if r["number"] == number and r["roll_deg"] == "0"]
    pose = {(float(r["aspect"]), math.radians(float(r["pitch_deg"]))) for r in rows}
    areas = [(float(r["round_area_m2"]), float(r["area_m2"])) for r in rows]
    return *pose.pop(), float(rows[0]["skin_ratio"]), np.array(areas)


@pytest.mark.parametrize("number", ["0", "1"])
def test_the_estimator_corrects_a_stiff_and_a_soft_skin_as_three_dimensions_do(number):
    """Fingers 0 and 1 of those kept aside differ by their skins: 60 and 22 times the tissue."""
    aspect, pitch, ratio, truth = areas_of_truth(number)
    model, sets = ReducedModel.load(), sets_of(finger_with_skin(ratio))
    settings = replace(TILTED, pad_aspect=aspect, plate_pitch=pitch)
    tilted = pressed(ContactEstimator(model, sets, settings))
    level = pressed(ContactEstimator(model, sets, EstimatorSettings(fuse_area=False)))
    assert not tilted[-1].flags & StateFlag.POSE_OUT_OF_RANGE
    areas = np.array([[e.model_area for e in run[10:]] for run in (level, tilted)])
    assert areas[0, 0] < truth[0, 0]
    reached = truth[truth[:, 0] < areas[0, -1]]
    assert len(reached) >= 5
    found = np.interp(reached[:, 0], *areas)
    assert found == pytest.approx(reached[:, 1], rel=0.02)


def test_the_correction_follows_the_parameters_that_moisture_brings():
    soft, stiff = finger_with_skin(20.0), finger_with_skin(90.0)
    sets = sets_of(soft, stiff, moistures=(40.0, 100.0))
    estimator = ContactEstimator(ReducedModel.load(), sets, replace(TILTED, default_moisture=40.0))
    assert estimator.pose_correction.skin_ratio == pytest.approx(20.0)
    known = estimator.pose_correction
    pressed(estimator)
    assert estimator.pose_correction is known
    estimator.add_moisture(T0 + 1000 * MS, 70.0)
    (estimate,) = estimator.add_wrench(T0 + 1300 * MS, (0.0, 0.0, -2.9))
    # Logarithms of the parameters are interpolated; E0 and E2 are, and E1.
    middle = StandardLinearSolid.PARAMETERS.mapping(estimator.parameters)
    ratio = StandardLinearSolid(**middle).skin_ratio
    assert ratio == pytest.approx(math.sqrt(20.0 * 90.0))
    assert estimator.pose_correction.skin_ratio == ratio
    wanted = PoseCorrection(Geometry(), TILTED.pose, ratio)
    round_area = wanted.round_area(estimate.model_area)
    level = ContactEstimator(
        ReducedModel.load(), sets, EstimatorSettings(fuse_area=False, default_moisture=40.0)
    )
    pressed(level)
    level.add_moisture(T0 + 1000 * MS, 70.0)
    (flat,) = level.add_wrench(T0 + 1300 * MS, (0.0, 0.0, -2.9))
    assert round_area == pytest.approx(flat.model_area, rel=1e-9)


def test_laws_of_branches_are_corrected_by_their_own_skin():
    solid = finger_with_skin(30.0)
    (branch,) = solid.branches
    branches = GeneralizedMaxwell2(
        E0=solid.E0,
        fraction_1=branch.fraction / 2,
        tau_1=branch.relaxation_time,
        fraction_2=branch.fraction / 2,
        tau_2=branch.relaxation_time,
        E2=solid.E2,
    )
    assert branches.skin_ratio == pytest.approx(30.0)
    model = load_population(Geometry())
    one = pressed(ContactEstimator(model, sets_of(solid), TILTED))[-1]
    other = ContactEstimator(model.for_law(type(branches)), sets_of(branches), TILTED)
    assert other.pose_correction.skin_ratio == pytest.approx(30.0)
    assert pressed(other)[-1].model_area == pytest.approx(one.model_area, rel=0.01)


def test_a_skin_that_was_not_learned_is_flagged():
    stiff = sets_of(finger_with_skin(140.0))
    flagged = pressed(ContactEstimator(ReducedModel.load(), stiff, TILTED))[-1]
    assert flagged.flags & StateFlag.POSE_OUT_OF_RANGE
    level = EstimatorSettings(fuse_area=False)
    not_flagged = pressed(ContactEstimator(ReducedModel.load(), stiff, level))[-1]
    assert not not_flagged.flags & StateFlag.POSE_OUT_OF_RANGE


def test_an_outline_that_comes_again_counts_once():
    """Also where another one came between."""
    found = []
    for order in ((0, 1, 0, 1, 2), (0, 1, 2)):
        settings = PoseSettings(pad_place_sd=1e-3)
        estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN), settings)
        outlines = [
            MeasuredOutline((1e-4, 0.0), 7e-3, 6e-3, 0.1 * k, 5e-5, 5e-5, 5e-5) for k in range(3)
        ]
        for k in order:
            estimator.expect_outline(10**9 + 10**8 * k, outlines[k])
        for k in range(10):
            estimator.add(estimate(10**9 + 10**8 * k, ROUND, 1.0), (0, 0, -1.0), (0, 0, 0))
        found.append(np.append(estimator.mean, estimator.covariance))
    assert np.array_equal(*found)


def test_one_wrong_outline_among_others_does_not_turn_the_finger():
    """8 mm beside them, such as of a smear."""
    found = []
    for aside in (0.0, 8e-3):
        settings = PoseSettings(pad_place_sd=1e-3)
        estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN), settings)
        for k in range(9):
            center = (aside if k == 8 else 0.0, 0.0)
            outline = MeasuredOutline(center, 7e-3, 6e-3, 0.0, 5e-5, 5e-5, 5e-5)
            estimator.expect_outline(10**9 + 10**8 * k, outline)
            estimator.add(estimate(10**9 + 10**8 * k, ROUND, 1.0), (0, 0, -1.0), (0, 0, 0))
        found.append(estimator.pose)
    assert found[1].roll == pytest.approx(found[0].roll, abs=0.1)
    assert found[1].pitch == pytest.approx(found[0].pitch, abs=0.1)


def test_an_outline_from_before_a_contact_tells_nothing_of_its_tilt():
    found = []
    for outlines in (0, 1):
        estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN))
        estimator.outlines.delay = 0.1
        for _ in range(outlines):
            estimator.expect_outline(10**9 - 5 * 10**7, LIKELY)
        for k in range(-6, 20):
            sample = estimate(10**9 + 10**7 * k, ROUND, 0.0 if k < 0 else 1.0)
            estimator.add(sample, (0, 0, -1.0), (0, 0, 0))
        found.append(np.append(estimator.mean, estimator.covariance))
    assert np.array_equal(*found)


def test_another_pose_that_is_assumed_begins_the_search_anew():
    assumed = PoseCorrection(Geometry(), Pose(1.2, 0.3), SKIN)
    changed, fresh = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN)), PoseEstimator(assumed)
    changed.add(estimate(10**9, ROUND, 1.0), (0, 0, -1.0), (0, 0, 0))
    changed.assume(assumed)
    assert changed.pose == fresh.pose == assumed.pose
    assert np.array_equal(changed.covariance, fresh.covariance)


LIKELY = MeasuredOutline((1e-3, -2e-3), 8e-3, 7e-3, 0.5, 5e-5, 8e-5, 7e-5)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"center": (640.0, 512.0)}, "center 640 m"),
        ({"center": (0.0, 1e200)}, "center 1e+200 m"),
        ({"center": (-math.inf, 0.0)}, "center -inf m"),
        ({"major": 8.0, "minor": 7.0}, "major axis 8 m"),
        ({"minor": 1e-300}, "minor axis 1e-300 m"),
        ({"minor": 9e-3}, "minor axis 0.009 m, longer than the major one"),
        ({"angle": 90.0}, "angle 90 rad"),
        ({"center_sd": 0.0}, "center_sd 0 m"),
        ({"major_sd": -1e-4}, "major_sd -0.0001 m"),
        ({"minor_sd": 1e200}, "minor_sd 1e+200 m"),
    ],
)
def test_an_outline_that_is_no_fingers_is_named_and_left_out(changes, says):
    absurd = LIKELY._replace(**changes)
    assert absurd.known and absurd.implausible == says and not absurd.usable
    found = []
    for outlines in ((LIKELY,), (LIKELY, absurd)):
        estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN))
        for k, outline in enumerate(outlines):
            estimator.expect_outline(10**9 + 10**8 * k, outline)
        for k in range(5):
            estimator.add(estimate(10**9 + 10**8 * k, ROUND, 1.0), (0, 0, -1.0), (0, 0, 0))
        found.append(np.append(estimator.mean, estimator.covariance))
    assert np.array_equal(*found)


def test_an_outline_that_is_not_known_is_no_fault():
    assert LIKELY.known and LIKELY.usable and not LIKELY.implausible
    assert not LIKELY._replace(center_sd=math.nan).known
    assert not LIKELY._replace(major=0.0, minor=0.0).known  # of an area sensor without


def test_endless_torques_are_left_out():
    estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN))
    for k in range(100):
        moment = (-1.7e308, 1.7e308, 0.0) if k % 2 else (1.7e308, -1.7e308, 0.0)
        force = 0.2 if k >= 60 else 0.0  # first in the air
        estimator.add(estimate(10**9 + 10**7 * k, ROUND, force), (0, 0, -force), moment)
    assert np.all(np.isfinite(estimator.mean)) and np.all(np.isfinite(estimator.covariance))


def pressed_with_zero(offset, seconds, silence=0.0, invalid=False):
    """Shape of a level press of 0.5 N, after this time in the air with noise of the torque, where
    the torque has an offset (N m) about y; with a silence (s) in the press: only after that;
    invalid: with samples in the silence that are no numbers."""
    rng = np.random.default_rng(0)
    settings = PoseSettings(pad_place_sd=2e-4, sensor_place_sd=0.0)
    estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN), settings)
    air = round(100 * seconds)
    for k in range(-air, 200):
        late = silence if k >= 100 else 0.0
        if invalid and k == 100:
            for wait in range(0, int(1e9 * silence), 10**8):
                nothing = estimate(11 * 10**9 + wait, ROUND, math.nan)
                estimator.add(nothing, [math.nan] * 3, [math.nan] * 3)
        stamp = 10**10 + 10**7 * k + int(1e9 * late)
        sample = estimate(stamp, ROUND if k >= 0 else 0.0, 0.5 if k >= 0 else 0.0)
        torque = rng.normal(0.0, 2e-4, 3)
        torque[1] += offset if late == silence else 0.0
        estimator.add(sample, (0.0, 0.0, -0.5 if k >= 0 else 0.0), torque.tolist())
    return estimator.shape(sample)


@pytest.mark.parametrize("seconds", [0.5, 3.0])
@pytest.mark.parametrize("offset", [0.3e-3, 1e-3])
def test_a_torque_that_a_tare_left_in_the_air_is_no_tilt(offset, seconds):
    exact, left = pressed_with_zero(0.0, seconds), pressed_with_zero(offset, seconds)
    assert left.roll == pytest.approx(exact.roll, abs=1e-6)
    assert abs(left.roll) < 2.0 * left.roll_stddev
    assert left.center_of_pressure == pytest.approx(exact.center_of_pressure, abs=1e-9)


def test_a_torque_of_1_mn_m_that_the_air_did_not_tell_is_a_tilt_of_18_degrees():
    shape = pressed_with_zero(1e-3, 0.0)
    assert math.degrees(abs(shape.roll)) == pytest.approx(18.5, abs=0.5)
    assert shape.flags & ShapeFlag.TILT_UNCERTAIN


def test_a_zero_of_the_torque_from_before_a_silence_is_forgotten():
    """A sensor that starts again, untared, while the finger presses."""
    after, blink = (pressed_with_zero(1e-3, 3.0, silence) for silence in (1.5, 0.5))
    untold = pressed_with_zero(1e-3, 0.0)
    assert after.roll_stddev == pytest.approx(untold.roll_stddev, rel=0.05)
    assert after.flags & ShapeFlag.TILT_UNCERTAIN
    assert blink.roll_stddev < 0.8 * after.roll_stddev
    invalid = pressed_with_zero(1e-3, 3.0, 1.5, invalid=True)
    assert (invalid.roll, invalid.roll_stddev) == (after.roll, after.roll_stddev)


@pytest.mark.parametrize("offset", [2e-3, 0.05, 1.0])
@pytest.mark.parametrize("after", [0.2, 0.6, 2.0])
def test_a_tare_before_a_touch_gives_the_new_zero_of_the_torque(offset, after):
    rng = np.random.default_rng(0)
    zero, touch = TorqueZero(2e-4), 10**10 + round(after * 1e9)
    for stamp in range(5 * 10**9, touch, 2_000_000):
        x, y = rng.normal(0.0, 1e-4, 2)
        zero.see_air(stamp, (x, y + (offset if stamp < 10**10 else 0.0)), 0.0, 0.02)
    zero.touch(0.02)
    if after < 0.5:  # the new zero is not known yet
        assert zero.mean == (0.0, 0.0) and zero.sd > 0.8 * offset
    else:
        assert zero.mean == pytest.approx((0.0, 0.0), abs=5e-5) and zero.sd < 5e-5


def test_a_finger_that_begins_to_rest_is_no_tare_of_the_torque():
    """0.04 N on an arm of 20 mm, which is not a contact yet."""
    rng = np.random.default_rng(0)
    zero = TorqueZero(2e-4)
    for stamp in range(5 * 10**9, 7 * 10**9, 2_000_000):
        resting = 0.04 if stamp > 65 * 10**8 else 0.0
        x, y = rng.normal(0.0, 1e-4, 2)
        zero.see_air(stamp, (1e-3 + x, y + 0.02 * resting), -resting, 0.02)
    zero.touch(0.02)
    assert zero.mean == pytest.approx((1e-3, 0.0), abs=1e-4)


def test_each_sample_of_a_sensor_of_50_hz_gives_a_shape_though_it_jitters():
    rng = np.random.default_rng(0)
    estimator = PoseEstimator(PoseCorrection(Geometry(), Pose(), SKIN))

    def shapes(stamps):
        found = (estimator.add(estimate(int(s), 0.0, 0.0), (0.0,) * 3, (0.0,) * 3) for s in stamps)
        return sum(shape is not None for shape in found)

    at = 10**10 + 20_000_000 * np.arange(200)
    assert shapes(at + rng.uniform(-2e6, 2e6, 200)) == 200
    fast = 2 * 10**10 + 2_000_000 * np.arange(5000)
    assert shapes(fast) == pytest.approx(500, abs=1)


def test_a_zero_of_the_torque_that_the_air_did_not_tell_is_part_of_the_deviation():
    """It lasts for a whole contact: more samples do not make the tilt surer."""
    unseen, seen = pressed_with_zero(0.2e-3, 0.0), pressed_with_zero(0.2e-3, 1.0)
    assert unseen.roll_stddev > 1.2 * seen.roll_stddev
    assert abs(unseen.roll) < 2.0 * unseen.roll_stddev
