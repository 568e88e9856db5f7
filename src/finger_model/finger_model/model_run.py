# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a model node keeps from its activation on."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from .area_watch import AreaWatch
from .estimator import ContactEstimate, ContactEstimator
from .latency import LatencyHistogram
from .slip_and_shape import SlipAndShape
from .wrench_watch import WrenchWatch

Vector = tuple[float, float, float]


@dataclass
class Run:
    """An estimator with what follows it, and what was seen since."""

    slip_and_shape: SlipAndShape
    reason: str = "start"
    first_stamp: int | None = None
    """Of the first sample, before which the start is not told; None until it comes."""
    before: tuple[Vector, Vector] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    """Force and torque of the newest sample, which may wait for the next one."""
    sampled_at: float = -math.inf
    pause: tuple[int, int] | None = None
    """Stamps of the first and the last area that came while no force did."""
    jumped: bool = False
    last: ContactEstimate | None = None
    flags: int = 0
    watch: WrenchWatch = field(default_factory=WrenchWatch)
    area_watch: AreaWatch = field(default_factory=AreaWatch)
    area_received: bool = False
    plate: str = ""
    """Frame of the newest area."""
    latency: LatencyHistogram = field(default_factory=LatencyHistogram)
    age: LatencyHistogram = field(default_factory=LatencyHistogram)

    @property
    def estimator(self) -> ContactEstimator:
        """The estimator in use."""
        return self.slip_and_shape.estimator

    def begin_anew(self, estimator: ContactEstimator, reason: str) -> None:
        """Go on with another estimator from the next sample on."""
        self.slip_and_shape.estimator = estimator
        self.slip_and_shape.keep_up()
        self.reason, self.first_stamp, self.pause = reason, None, None
