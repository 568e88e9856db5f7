# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Slip and shape of a recording are those of the live node, whatever axis, delay and blocks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from live_recording import EventLog

from finger_bag.definitions import encode
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_model.estimator import ContactEstimator, EstimatorSettings
from finger_model.finger import load_reduced
from finger_model.messages import shape_fields, slip_numbers
from finger_model.shape.estimate import MeasuredOutline
from finger_model.shape.settings import PoseSettings
from finger_model.slip import SlipSettings
from finger_model.slip_and_shape import SlipAndShape
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions

START = 1_700_000_000_000_000_000
STEP = 2_000_000
SHAPE = "finger_msgs/msg/ContactShape"


def live_recording(
    path: Path, settings: EstimatorSettings, jump: int = 0, clock: bool = True
) -> tuple[list[tuple], list[bytes]]:
    """A bag of a press along x that is pulled along y, as a live model node has it; gives the
    numbers of the slips and the shapes that it published.

    Where the settings have another axis than +x, they change to it after 400 samples. jump: steps
    by which time jumps back after 500 samples, without areas, which offline come before samples;
    clock: whether the node sees its clock jump.
    """
    estimator = ContactEstimator(load_reduced(), settings=settings)
    slip_and_shape = SlipAndShape(estimator, SlipSettings(), PoseSettings())
    slips, shapes = [], []
    before = np.zeros(3), np.zeros(3)
    with BagWriter(path) as bag:
        tell = EventLog(bag).write
        tell(estimator.start_event(START), START)
        for k in range(1000):
            log = START + k * STEP
            stamp = log - (jump * STEP if k >= 500 else 0)
            if k == 400 and settings.normal_axis != "+x":
                tell(estimator.change_settings(EstimatorSettings(), "asked"), log)
                turned = EstimatorSettings(normal_axis="+x", fusion_delay=0.02)
                tell(estimator.change_settings(turned, "asked"), log)
            if k == 500 and jump and clock:
                tell(estimator.clock_jump_event(stamp), log)
            normal = min(1.0, k / 200)
            pull = 0.3 * normal * min(max(k - 250.0, 0.0) / 500, 1.0)
            now = np.array([normal, pull, 0.0]), np.array([0.0, 1e-3 * k * normal, -1e-3 * normal])
            parts = {
                part: dict(zip("xyz", values.tolist()))
                for part, values in zip(("force", "torque"), now)
            }
            bag.write("wrench", {"header": {"stamp": stamp}, "wrench": parts}, log)
            estimates = estimator.add_wrench(stamp, now[0].tolist())
            for estimate, sample in zip(estimates, (before, now)[-len(estimates) :]):
                slip, shape = slip_and_shape.process(estimate, *(part.tolist() for part in sample))
                assert slip is not None
                slips.append(slip_numbers(slip, slip_and_shape.lateral_axes))
                if shape is not None:
                    shapes.append(encode(SHAPE, shape_fields(shape, "plate")))
            before = now
            if k % 25 == 5 and not jump:
                axes = 2.2e-3 * math.sqrt(normal), 1.8e-3 * math.sqrt(normal)
                seen = MeasuredOutline((1e-6 * k, 0.0), 2 * axes[0], 2 * axes[1], 1.5, *[1e-4] * 3)
                stick = 1.0 - pull, 0.05
                fields = {
                    "header": {"stamp": stamp},
                    "gross_area": math.pi * axes[0] * axes[1],
                    "area_stddev": 1e-6,
                    "centroid": dict(zip("xy", seen.center)),
                    "ellipse_major": seen.major,
                    "ellipse_minor": seen.minor,
                    "ellipse_angle": seen.angle,
                    "centroid_stddev": seen.center_sd,
                    "ellipse_major_stddev": seen.major_sd,
                    "ellipse_minor_stddev": seen.minor_sd,
                    "stick_ratio": stick[0],
                    "stick_ratio_stddev": stick[1],
                }
                bag.write("contact_area", fields, log)
                assert estimator.add_area(stamp, fields["gross_area"], 1e-6)
                slip_and_shape.see_area(stamp, stick, seen)
    return slips, shapes


def processed(path: Path, target: Path) -> tuple[list, list[bytes]]:
    """ContactSlips, and ContactShapes as bytes, of the processed bag."""
    process(path, target, ProcessOptions(slip=True, shape=True))
    with open_bag(target) as made:
        slips = [m.message for m in made.messages(["/finger/contact_slip"])]
        return slips, [m.raw for m in made.messages(["/finger/contact_shape"])]


def same(found: list, wanted: list[tuple]) -> bool:
    """Whether ContactSlips have these numbers."""

    def numbers(slip) -> list[float]:
        force = slip.tangential_force
        return [slip.header.stamp.nanosec, force.x, force.y, force.z, slip.friction, slip.flags]

    return [repr(numbers(slip)) for slip in found] == [
        repr([w[1], *map(float, (*w[3:6], w[11])), w[-1]]) for w in wanted
    ]


def test_a_recording_along_another_axis_has_the_slip_along_its_own(tmp_path: Path) -> None:
    wanted, shapes = live_recording(tmp_path / "live", EstimatorSettings(normal_axis="+x"))
    found, made = processed(tmp_path / "live", tmp_path / "out")
    assert same(found, wanted) and made == shapes
    force = found[-1].tangential_force
    assert (force.x, force.z) == (0.0, 0.0) and force.y == pytest.approx(0.3, rel=0.01)
    assert found[-1].slip_probability < 0.1


@pytest.mark.parametrize("axis", ["+x", "-z"])
def test_delay_and_axis_are_those_of_the_recording_from_its_first_sample_on(
    tmp_path: Path, axis: str
) -> None:
    settings = EstimatorSettings(normal_axis=axis, fusion_delay=0.35)
    wanted, shapes = live_recording(tmp_path / "live", settings)
    found, made = processed(tmp_path / "live", tmp_path / "out")
    assert same(found, wanted) and made == shapes


@pytest.mark.parametrize("block", [1, 100, 4000])
@pytest.mark.parametrize(("jump", "clock"), [(100, True), (5000, False)])
def test_a_sample_has_its_own_force_and_torque_where_time_jumps_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int, jump: int, clock: bool
) -> None:
    """Also where it waits for its successor in the next block, and where its stamp comes twice."""
    monkeypatch.setattr("finger_offline.input_order.BLOCK", block)
    settings = EstimatorSettings(normal_axis="+x")
    wanted, shapes = live_recording(tmp_path / "live", settings, jump, clock)
    found, made = processed(tmp_path / "live", tmp_path / "out")
    assert len(wanted) == 1000
    assert same(found, wanted) and made == shapes
