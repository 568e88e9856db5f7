"""What every force sensor's driver gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..device import Device

GOOD, SATURATED, CRITICAL = 0, 1, 2
"""Quality of a sample: usable; a gauge or channel at its end; the sensor reports a fault."""


@dataclass(frozen=True)
class WrenchSample:
    """One reading in the sensor's own axes, without tare.

    stamp_ns: acquisition, ns since the epoch. force (3,) N, torque (3,) N m. channels (6,): what the sensor
    measured before any matrix (gauges), or force and torque themselves. status: the device's status word.
    quality: GOOD, SATURATED or CRITICAL; the values are meaningful only when GOOD.
    """

    stamp_ns: int
    force: np.ndarray
    torque: np.ndarray
    channels: np.ndarray
    status: int = 0
    quality: int = GOOD


class ForceSource(Device[WrenchSample]):
    """A force and torque sensor."""

    def wrench_of(self, channels: np.ndarray) -> np.ndarray:
        """Wrench (6,) in N and N m of channels (6,), from which a bias may have been taken."""
        return np.asarray(channels, dtype=float)

    @property
    def scale_id(self) -> object:
        """Changes whenever `wrench_of` does, so that a bias in channels is known to be void."""
        return None
