# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the pose estimator: one declaration for the core, the node and the node reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from finger_common.settings import Settings, setting

_runtime = partial(setting, runtime=True)


@dataclass(frozen=True)
class PoseSettings(Settings):
    """What is known of pad, plate and sensor before a contact. Raises InputError for bad values."""

    pad_aspect_sd: float = _runtime(
        0.25,
        "Standard deviation of pad_aspect (its logarithm) before any outline was seen.",
        minimum=0.0,
        maximum=0.5,
    )
    tilt_sd: float = _runtime(
        0.4,
        "Standard deviation of the plate's tilt about plate_pitch and plate_roll.",
        unit="rad",
        minimum=0.0,
        maximum=0.6,
    )
    tilt_wander: float = _runtime(
        0.03,
        "Standard deviation of what pitch and roll change by in a second of contact, where the "
        "finger rolls; it grows with the square root of time.",
        unit="rad/√s",
        minimum=0.0,
        maximum=3.0,
        advice="0.1 for a finger that is rolled on purpose; the tilt is less certain then.",
    )
    pad_x: float = _runtime(
        0.0,
        "Place of the pad's centre (that of its ellipsoid, in the bone) along x of the plate.",
        unit="m",
        minimum=-0.1,
        maximum=0.1,
    )
    pad_y: float = _runtime(
        0.0, "The same along y of the plate.", unit="m", minimum=-0.1, maximum=0.1
    )
    pad_place_sd: float = _runtime(
        3e-3,
        "Standard deviation of that place, in a contact too; the tilt is known as well as it is.",
        unit="m",
        minimum=1e-5,
        maximum=0.1,
        advice="A robot knows where its finger is: give its value. 0.3 mm tell a "
        "small tilt within 3°; a larger one needs the finger's lengths too.",
    )
    finger_direction: float = _runtime(
        0.5 * math.pi,
        "Direction of the fingertip in the plate, from +x towards +y.",
        unit="rad",
        minimum=-math.pi,
        maximum=math.pi,
    )
    sensor_x: float = _runtime(
        0.0,
        "Place of the torque's origin along x of the plate.",
        unit="m",
        minimum=-0.1,
        maximum=0.1,
    )
    sensor_y: float = _runtime(
        0.0, "The same along y of the plate.", unit="m", minimum=-0.1, maximum=0.1
    )
    sensor_depth: float = _runtime(
        0.0,
        "Depth of the torque's origin below the surface of the plate; negative above it, as "
        "behind the finger.",
        unit="m",
        minimum=-0.2,
        maximum=0.2,
    )
    sensor_place_sd: float = _runtime(
        1e-3,
        "Standard deviation of that origin, in x and y, beside the plate that the camera sees.",
        unit="m",
        minimum=0.0,
        maximum=0.1,
    )
    wrench_on_finger: bool = _runtime(
        False,
        "The wrench is what the plate does to the finger, as a sensor behind the finger measures "
        "it, and not what the finger does to the plate.",
    )
    sensor_direction: float = _runtime(
        0.0,
        "Direction of the sensor's x in the plate, from +x towards +y, where sensor and camera are "
        "turned against each other about the plate's normal; that of y where x is the normal axis, "
        "and that of z where y is.",
        unit="rad",
        minimum=-math.pi,
        maximum=math.pi,
    )
    torque_noise: float = _runtime(
        2e-4,
        "Standard deviation of the mean torque of a thirtieth of a second, and of its zero as long "
        "as the air has not told it.",
        unit="N m",
        minimum=1e-6,
        maximum=0.1,
    )
