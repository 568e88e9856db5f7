# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the slip estimator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from finger_common.settings import Settings, setting

from ..paper import NATURAL

_runtime = partial(setting, runtime=True)


@dataclass(frozen=True)
class SlipSettings(Settings):
    """What the slip estimator assumes and when it warns. Raises InputError for bad values."""

    friction_prior: float = _runtime(
        0.45,
        "Median of the friction coefficient before any slip was seen, of natural skin on glass.",
        minimum=0.1,
        maximum=2.0,
    )
    friction_prior_sd: float = _runtime(
        0.5,
        "Standard deviation of the logarithm of that friction coefficient.",
        minimum=0.01,
        maximum=2.0,
        advice="0.5 means: two of three fingers within a factor of 1.65.",
    )
    friction_moisture_slope: float = _runtime(
        0.012,
        "Change of the logarithm of the prior friction for each unit of moisture from "
        f"{NATURAL.moisture:g}.",
        minimum=-0.1,
        maximum=0.1,
    )
    friction_drift: float = _runtime(
        0.04,
        "Standard deviation by which the logarithm of friction may change from contact to contact.",
        minimum=0.0,
        maximum=1.0,
    )
    level_sd: float = _runtime(
        0.04,
        "Standard deviation of the angle between the force sensor's normal axis and the plate's "
        "normal, for the one sensor in twenty that is taken not to be level; 0: none is.",
        unit="rad",
        minimum=0.0,
        maximum=0.2,
    )
    slip_horizon: float = _runtime(
        0.05,
        "Time ahead for which the probability of slip is given.",
        unit="s",
        minimum=0.005,
        maximum=0.5,
    )
    tangential_noise: float = _runtime(
        0.01,
        "Standard deviation of one sample of the tangential force.",
        unit="N",
        minimum=0.0001,
        maximum=1.0,
    )
    grip_follows_load: bool = _runtime(
        False,
        "Whether a controller lets the grip follow the load: then the tangential force follows the "
        "normal one without slip too, and only changes faster than some 3 Hz tell of a slip.",
    )
