# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Normal and tangential force in a WrenchStamped message."""

from __future__ import annotations

import math
from typing import Any

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES, axis_of
from finger_common.settings import setting


def normal_axis_setting(advice: str) -> str:
    """Field of Settings: the axis that `NormalForce` projects on."""
    return setting(
        DEFAULT_NORMAL_AXIS,
        "Sensor axis along which the force is positive under a press; the model's parameter of "
        "the same name.",
        choices=NORMAL_AXES,
        advice=advice,
    )


def wrench_topic_setting() -> str:
    """Field of Settings: the topic of the force."""
    return setting(
        "wrench", "Topic of the tared force; the model's parameter of the same name.", ros_name=True
    )


class NormalForce:
    """Projects wrenches on a normal axis; cheap enough for every sample of a 500 Hz stream."""

    def __init__(self, normal_axis: str) -> None:
        index, self._sign = axis_of(normal_axis)
        self._component = "xyz"[index]
        self._others = "xyz"[(index + 1) % 3], "xyz"[(index + 2) % 3]

    def __call__(self, message: Any) -> float:
        """Normal force in N, positive in compression."""
        return self._sign * float(getattr(message.wrench.force, self._component))

    def tangential(self, message: Any) -> float:
        """Size of the force across the normal in N."""
        force = message.wrench.force
        return math.hypot(*(getattr(force, name) for name in self._others))
