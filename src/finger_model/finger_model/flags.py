"""Bits of `flags` in ContactState and ContactArea, as in the message definitions (a test keeps them equal)."""

from __future__ import annotations

from enum import IntFlag


class StateFlag(IntFlag):
    """Flags of an estimate; 0 means: everything is valid and fresh."""

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


class AreaFlag(IntFlag):
    """Flags of a measured area that the estimator looks at."""

    NO_CONTACT = 1
    SPARSE = 2
    CLIPPED = 4
    LOW_CONTRAST = 8
