# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bits of `flags` in ContactState, ContactArea and ContactSlip, as in the message definitions.

A test keeps them equal.
"""

from __future__ import annotations

from enum import IntFlag


class StateFlag(IntFlag):
    """Flags of an estimated contact state; 0 means: everything is valid and fresh."""

    FORCE_INVALID = 1
    FORCE_GAP = 2
    FORCE_OUT_OF_RANGE = 4
    LATERAL_LOAD = 8
    PARAMETERS_OUT_OF_RANGE = 16
    MOISTURE_MISSING = 32
    MOISTURE_STALE = 64
    MOISTURE_OUT_OF_RANGE = 128
    AREA_MISSING = 256
    AREA_STALE = 512
    AREA_LATE = 1024
    AREA_REJECTED = 2048
    MODEL_FAILED = 4096
    TIME_RESET = 8192
    MOISTURE_LATE = 16384
    OUT_OF_ORDER = 32768
    MODEL_MISMATCH = 65536
    FORCE_OFFSET = 131072
    POSE_OUT_OF_RANGE = 262144


FORCE_ALONE = StateFlag(
    ~(
        StateFlag.MOISTURE_MISSING
        | StateFlag.MOISTURE_STALE
        | StateFlag.MOISTURE_OUT_OF_RANGE
        | StateFlag.MOISTURE_LATE
        | StateFlag.AREA_MISSING
        | StateFlag.AREA_STALE
        | StateFlag.AREA_LATE
        | StateFlag.AREA_REJECTED
    )
)
"""What a controller without camera and moisture probe compares with zero: flags & FORCE_ALONE."""


class AreaFlag(IntFlag):
    """Flags of a measured area: reasons to doubt it, and whether it slides; 0 means none."""

    NO_CONTACT = 1
    SPARSE = 2
    CLIPPED = 4
    LOW_CONTRAST = 8
    SATURATED = 16
    UNCALIBRATED = 32
    MULTIPLE_REGIONS = 64
    NO_BACKGROUND = 128
    SLIDING = 256


class SlipFlag(IntFlag):
    """Flags of an estimated slip state; 0 means: a contact that sticks, its friction learned."""

    NO_CONTACT = 1
    SLIPPING = 2
    FRICTION_ASSUMED = 4
    FORCE_INVALID = 8


class ShapeFlag(IntFlag):
    """Flags of an estimated shape; 0 means: outline and torque tell the pose."""

    NO_CONTACT = 1
    OUTLINE_MISSING = 2
    TORQUE_MISSING = 4
    TILT_UNCERTAIN = 8
    OUT_OF_RANGE = 16
    PRESSURE_OUTSIDE = 32


def flag_names(flags: StateFlag | AreaFlag) -> str:
    """Names of the bits set, lower case, joined by '|'; empty for 0."""
    return "|".join(f.name.lower() for f in type(flags) if flags & f and f.name)
