# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-bag process --slip` writes what the slip estimator says, and only when asked to."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from live_recording import EventLog

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_model.estimator import ContactEstimator, EstimatorEvent
from finger_model.finger import load_reduced
from finger_model.messages import area_of, slip_numbers, stick_of, wrench_of
from finger_model.slip import SlipEstimator


def pulled(path: Path, seen: bool = False) -> Path:
    """A bag of a press that is pulled sideways; one stamp comes twice.

    seen: whether a camera sees the stick ratio, from 0.7 s on; its first picture is clipped.
    """
    time = np.arange(0.0, 2.0, 0.002)
    normal = np.interp(time, [0.1, 0.5, 1.8, 1.9], [0.0, 1.0, 1.0, 0.0])
    pull = np.interp(time, [0.6, 1.6, 1.8, 1.9], [0.0, 0.5, 0.5, 0.0])
    with BagWriter(path, {"subject": "S01", "condition": "natural"}) as writer:
        for i in [*range(400), 399, *range(400, len(time))]:
            stamp = 10**18 + round(time[i] * 1e9)
            sec, nanosec = divmod(stamp, 10**9)
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "sensor"}
            force = {"x": pull[i], "y": 0.0, "z": -normal[i]}
            torque = {"x": 0.0, "y": 0.0, "z": 0.0}
            fields = {"header": header, "wrench": {"force": force, "torque": torque}}
            writer.write("/finger/wrench", fields, stamp)
            if seen and i >= 350 and i % 20 == 0:
                area = {
                    "header": {"stamp": stamp - 30_500_000},
                    "gross_area": 5e-5,
                    "area_stddev": 5e-6,
                    "stick_ratio": 0.9 - 0.0018 * (i - 350),
                    "stick_ratio_stddev": 0.05,
                    "flags": 4 if i == 360 else 0,
                }
                writer.write("/finger/contact_area", area, stamp)
    return path


def test_slip_of_a_bag_is_that_of_its_samples(tmp_path: Path) -> None:
    bag = pulled(tmp_path / "bag")
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "plain")]) == 0
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "slip"), "--slip"]) == 0
    with open_bag(tmp_path / "plain") as reader:
        assert "/finger/contact_slip" not in reader.info.topics
        forces = [wrench_of(m.message) for m in reader.messages(["/finger/wrench"])]
    contact, slip = ContactEstimator(load_reduced()), SlipEstimator()
    wanted = [
        slip_numbers(slip.add(estimate, force), slip.lateral_axes)
        for stamp, force in forces
        for estimate in contact.add_wrench(stamp, force)
    ]
    with open_bag(tmp_path / "slip") as reader:
        found = [m.message for m in reader.messages(["/finger/contact_slip"])]
    assert len(found) == len(wanted) == 1000
    for message, values in zip(found, wanted):
        assert message.header.frame_id == "sensor"
        assert repr(message.slip_margin) == repr(values[8])
        assert repr(message.friction) == repr(values[11])
        assert message.tangential_force.x == values[3] and message.flags == values[-1]
    assert 0.0 < min(m.slip_margin for m in found[400:800]) < 0.4


def test_stick_ratios_of_the_camera_enter_as_in_a_live_node(tmp_path: Path) -> None:
    bag = pulled(tmp_path / "bag", seen=True)
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "slip"), "--slip"]) == 0
    contact, slip = ContactEstimator(load_reduced()), SlipEstimator()
    slip.sticks.delay = 0.1
    wanted = []
    with open_bag(bag) as reader:
        for item in reader.messages(["/finger/wrench", "/finger/contact_area"]):
            if item.topic == "/finger/contact_area":
                area = area_of(item.message)
                assert contact.add_area(*area)
                slip.expect_stick_ratio(area[0], *stick_of(item.message))
                continue
            stamp, force = wrench_of(item.message)
            for estimate in contact.add_wrench(stamp, force):
                wanted.append(slip_numbers(slip.add(estimate, force), slip.lateral_axes))
    with open_bag(tmp_path / "slip") as reader:
        found = [m.message for m in reader.messages(["/finger/contact_slip"])]
    assert [repr(m.friction) for m in found] == [repr(values[11]) for values in wanted]
    blind = pulled(tmp_path / "blind")
    assert run(command, ["process", str(blind), "-o", str(tmp_path / "without"), "--slip"]) == 0
    with open_bag(tmp_path / "without") as reader:
        without = [m.message for m in reader.messages(["/finger/contact_slip"])]
    assert without[800].friction > 1.1 * found[800].friction
    assert without[395].friction == found[395].friction


@pytest.mark.parametrize("change", [ContactEstimator.reset, ContactEstimator.change_surface])
def test_a_recorded_reset_or_surface_is_a_plate_that_was_not_seen_before(
    tmp_path: Path, change: Callable[[ContactEstimator, str], EstimatorEvent]
) -> None:
    """As in a live node, whose services ~/reset and ~/new_surface forget the friction."""
    pull = pulled(tmp_path / "bag", seen=True)
    contact, slip = ContactEstimator(load_reduced()), SlipEstimator()
    slip.sticks.delay = 0.1
    wanted: list[tuple] = []
    with open_bag(pull) as reader, BagWriter(tmp_path / "live", {}) as bag:
        tell = EventLog(bag).write
        tell(contact.start_event(10**18), 10**18)
        for item in reader.messages(["/finger/wrench", "/finger/contact_area"]):
            bag.write_raw(item.topic.rsplit("/", 1)[-1], item.raw, item.log_time_ns)
            if item.topic == "/finger/contact_area":
                area = area_of(item.message)
                assert contact.add_area(*area)
                slip.expect_stick_ratio(area[0], *stick_of(item.message))
                continue
            if len(wanted) == 700:
                tell(change(contact, "asked"), item.log_time_ns)
                (slip.reset if change is ContactEstimator.reset else slip.change_surface)()
            stamp, force = wrench_of(item.message)
            for estimate in contact.add_wrench(stamp, force):
                slip.assume(contact.model.geometry, contact.material)
                wanted.append(slip_numbers(slip.add(estimate, force), slip.lateral_axes))
    source, target = str(tmp_path / "live"), str(tmp_path / "slip")
    assert run(command, ["process", source, "-o", target, "--slip"]) == 0
    with open_bag(tmp_path / "slip") as reader:
        found = [m.message for m in reader.messages(["/finger/contact_slip"])]
    assert [repr(m.friction) for m in found] == [repr(values[11]) for values in wanted]
    assert found[702].friction_stddev > 1.5 * found[698].friction_stddev


def test_a_recording_older_than_the_stick_ratio_has_none() -> None:
    older = SimpleNamespace(flags=0, gross_area=5e-5, area_stddev=1e-6)
    assert all(math.isnan(value) for value in stick_of(older))
    clipped = SimpleNamespace(flags=4, stick_ratio=0.5, stick_ratio_stddev=0.1)
    assert all(math.isnan(value) for value in stick_of(clipped))
