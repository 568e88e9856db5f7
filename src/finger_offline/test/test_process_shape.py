# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-bag process --shape` tells the pad's aspect and the plate's tilt from outline and torque,
and the model's area is that of the pose it is told."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from live_recording import EventLog

from finger_bag.cli import command
from finger_bag.definitions import encode
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_common.flags import ShapeFlag
from finger_model.estimator import ContactEstimator, EstimatorSettings
from finger_model.finger import load_reduced
from finger_model.geometry import Geometry
from finger_model.material import Material
from finger_model.messages import outline_of, shape_fields
from finger_model.paper import NATURAL
from finger_model.pose.correction import PoseCorrection
from finger_model.pose.pose import Pose
from finger_model.shape.estimator import PoseEstimator

SHAPE = "finger_msgs/msg/ContactShape"
POSE = Pose(1.3, 0.25, -0.1)
START = 1_700_000_000_000_000_000
DEPTH = 0.02
"""m, of the sensor below the plate."""
DIRECTION = 0.5 * math.pi


def press_of(path: Path) -> None:
    """A bag of a press of a finger in POSE: wrenches with torque, and outlines."""
    material = Material(**NATURAL.parameters)
    correction = PoseCorrection(Geometry(), POSE, material.skin_ratio)
    force = np.minimum(np.linspace(0.0, 1.2, 1000), 1.0)
    force[:100] = 0.0
    estimator = ContactEstimator(load_reduced())
    rng = np.random.default_rng(4)
    with BagWriter(path, {}) as bag:
        for k, normal in enumerate(force.tolist()):
            stamp = START + k * 2_000_000
            round_area = 0.0
            for estimate in estimator.add_wrench(stamp, (0.0, 0.0, -normal)):
                round_area = estimate.model_area
            found = correction.outline(max(round_area, 1e-7))
            turn = np.array([[0.0, -1.0], [1.0, 0.0]])
            pressed = turn @ found.center_of_pressure
            pull = np.array([0.1 * normal, 0.0, -normal])
            torque = np.cross([*pressed, DEPTH], pull) + 1e-4 * rng.standard_normal(3)
            wrench = {
                part: dict(zip("xyz", values.tolist()))
                for part, values in (("force", pull), ("torque", torque))
            }
            bag.write("wrench", {"header": {"stamp": stamp}, "wrench": wrench})
            if k % 50 == 0:
                center = turn @ found.center
                frame = "glass" if k < 500 else "other_glass"
                fields = {
                    "header": {"stamp": stamp, "frame_id": frame},
                    "gross_area": found.area if round_area else 0.0,
                    "area_stddev": 1e-6,
                    "centroid": dict(zip("xy", center.tolist())),
                    "ellipse_major": 2 * found.semi_axes[0],
                    "ellipse_minor": 2 * found.semi_axes[1],
                    "ellipse_angle": found.orientation + DIRECTION,
                    "flags": 0 if round_area else 1,
                    "centroid_stddev": 5e-5,
                    "ellipse_major_stddev": 1e-4,
                    "ellipse_minor_stddev": 1e-4,
                    "ellipse_angle_stddev": 0.05,
                    "stick_ratio": math.nan,
                }
                bag.write("contact_area", fields)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pose") / "press"
    press_of(path)
    return path


def last(path: Path, topic: str):
    with open_bag(path) as reader:
        return [m.message for m in reader.messages([topic])][-1]


def test_outline_and_torque_tell_aspect_and_tilt(bag: Path, tmp_path: Path) -> None:
    options = ["--shape", "--set", f"sensor_depth={DEPTH}", "--set", "pad_place_sd=2e-4"]
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "out"), *options]) == 0
    shape = last(tmp_path / "out", "/finger/contact_shape")
    assert shape.flags == 0
    assert shape.pad_aspect == pytest.approx(POSE.aspect, abs=0.05)
    assert shape.pitch == pytest.approx(POSE.pitch, abs=math.radians(3))
    assert shape.roll == pytest.approx(POSE.roll, abs=math.radians(3))
    assert abs(shape.pitch - POSE.pitch) < 3 * shape.pitch_stddev
    state = last(tmp_path / "out", "/finger/contact_state")
    assert shape.area == pytest.approx(state.area, rel=0.02)
    assert math.pi * shape.semi_axis_major * shape.semi_axis_minor == pytest.approx(shape.area)
    assert shape.header.frame_id == "other_glass"
    area = last(bag, "/finger/contact_area")
    assert shape.center.x == pytest.approx(area.centroid.x, abs=0.1e-3)
    assert shape.center.y == pytest.approx(area.centroid.y, abs=0.1e-3)


def test_lengths_that_are_not_stated_make_the_tilt_less_certain(bag: Path, tmp_path: Path) -> None:
    found = []
    for stated in ("{}", "{pad_semi_axis_radial: 0, pad_semi_axis_axial: 0}"):
        finger, out = tmp_path / "finger.yaml", tmp_path / f"out{len(stated)}"
        finger.write_text(f"deviations: {stated}\n")
        options = ["--shape", "--set", f"sensor_depth={DEPTH}", "--set", "pad_place_sd=2e-4"]
        options += ["--geometry", str(finger)]
        assert run(command, ["process", str(bag), "-o", str(out), *options]) == 0
        found.append(last(out, "/finger/contact_shape"))
    assert found[0].pitch_stddev > 1.5 * found[1].pitch_stddev
    assert found[1].flags == 0


def test_a_finger_whose_place_is_not_known_has_an_uncertain_tilt(bag: Path, tmp_path: Path) -> None:
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "out"), "--shape"]) == 0
    shape = last(tmp_path / "out", "/finger/contact_shape")
    assert shape.flags & ShapeFlag.TILT_UNCERTAIN
    assert max(shape.pitch_stddev, shape.roll_stddev) > math.radians(3)


def test_the_models_area_is_that_of_the_known_pose(bag: Path, tmp_path: Path) -> None:
    names = ("pad_aspect", POSE.aspect), ("plate_pitch", POSE.pitch), ("plate_roll", POSE.roll)
    told = [text for name, value in names for text in ("--set", f"{name}={value}")]
    told += ["--set", "fuse_area=false"]
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "out"), *told]) == 0
    state = last(tmp_path / "out", "/finger/contact_state")
    area = last(bag, "/finger/contact_area")
    # The last outline is a tenth of a second old; the finger creeps meanwhile.
    assert state.model_area == pytest.approx(area.gross_area, rel=0.02)


def live_recording(path: Path, pressed: Path) -> list[bytes]:
    """`pressed` as a live model node has it: moisture and the settings change on the way, and it is
    reset. Gives the shapes that it published."""
    settings = EstimatorSettings(pad_aspect=1.2)
    estimator = ContactEstimator(load_reduced(), settings=settings)
    core = PoseEstimator(estimator.pose_correction)
    core.outlines.delay = settings.fusion_delay
    shapes, samples, frame = [], 0, "plate"
    with open_bag(pressed) as source, BagWriter(path, {}) as bag:
        tell = EventLog(bag).write
        tell(estimator.start_event(START), START)
        for item in source.messages():
            stamp, message = item.log_time_ns, item.message
            bag.write_raw(item.topic.rsplit("/", 1)[-1], item.raw, stamp)
            if item.topic == "/finger/contact_area":
                sd, flags = message.area_stddev, message.flags
                if estimator.add_area(stamp, message.gross_area, sd, flags):
                    core.expect_outline(stamp, outline_of(message))
                frame = message.header.frame_id
                continue
            samples += 1
            if samples in (301, 403, 705):
                value = {301: 40.0, 403: 72.5, 705: 100.0}[samples]
                fields = {"header": {"stamp": stamp}, "value": value}
                bag.write("moisture", fields, stamp)
                assert estimator.add_moisture(stamp, value)
            if samples == 520:  # the service ~/reset
                tell(estimator.reset("asked"), stamp)
                core.reset()
            if samples == 611:
                settings = EstimatorSettings(pad_aspect=1.3, plate_pitch=0.2)
                tell(estimator.change_settings(settings, "asked"), stamp)
            force, torque = message.wrench.force, message.wrench.torque
            force, torque = ([v.x, v.y, v.z] for v in (force, torque))
            for estimate in estimator.add_wrench(stamp, force):
                core.assume(estimator.pose_correction)
                shape = core.add(estimate, force, torque)
                if shape is not None:
                    shapes.append(encode(SHAPE, shape_fields(shape, frame)))
    return shapes


def test_shapes_of_a_recording_are_those_of_the_live_node(bag: Path, tmp_path: Path) -> None:
    """While moisture changes the skin's stiffness over the tissue's, and the pose is set anew."""
    live = live_recording(tmp_path / "live", bag)
    source, target = str(tmp_path / "live"), str(tmp_path / "out")
    assert run(command, ["process", source, "-o", target, "--shape"]) == 0
    with open_bag(tmp_path / "out") as made:
        found = [item.raw for item in made.messages(["/finger/contact_shape"])]
    assert len(live) > 50
    assert found == live
