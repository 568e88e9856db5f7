# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings in messages: every value comes back, of rclpy as of a bag reader."""

from __future__ import annotations

from typing import Any

import pytest

from finger_common.errors import InputError
from finger_common.parameter_values import parameter_fields, parameter_values

VALUES: dict[str, Any] = {
    "fuse_area": True,
    "rounds": -(2**40),
    "step": 0.1 + 0.2,
    "force": "volle Kraft",
    "optimizer": ["pso", "de"],
    "bounds": [],
    "spans": [1, 2.5],
    "numbers": [1, 2],
    "switches": [True, False],
}


def same(found: dict[str, Any]) -> None:
    assert repr(found) == repr({**VALUES, "spans": [1.0, 2.5]})


def test_values_come_back_through_a_bag_reader() -> None:
    from finger_bag.definitions import decoder, encode

    fields = {"estimator_settings": parameter_fields(VALUES)}
    kind = "finger_msgs/msg/ModelEvent"
    same(parameter_values(decoder(kind)(encode(kind, fields)).estimator_settings))


def test_values_come_back_through_rclpy() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from rclpy.serialization import deserialize_message, serialize_message

    from finger_common.node import message_of
    from finger_msgs.msg import ModelEvent

    message = message_of(ModelEvent, {"estimator_settings": parameter_fields(VALUES)})
    again = deserialize_message(serialize_message(message), ModelEvent)
    same(parameter_values(again.estimator_settings))
    with pytest.raises(AttributeError, match="ModelEvent has no field 'colour'"):
        message_of(ModelEvent, {"colour": "red"})


def test_what_no_parameter_can_hold_is_named() -> None:
    for value in (None, {"a": 1}, ["a", 1], [[1.0]]):
        with pytest.raises(InputError, match="'box' is"):
            parameter_fields({"box": value})
