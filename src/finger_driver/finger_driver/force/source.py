"""What every force sensor's driver gives, and the settings that all of them have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from finger_common.diagnostics import Health
from finger_common.settings import Settings, setting

from ..device import Device

GOOD, SATURATED, CRITICAL = 0, 1, 2
"""Quality of a sample: usable; a gauge or channel at its end; the sensor reports a fault."""


@dataclass(frozen=True)
class ForceSettings(Settings):
    """Settings of every force sensor."""

    rate: float = setting(
        500.0,
        "Samples per second: polled (netcanoem), requested (netft, dbc).",
        unit="Hz",
        minimum=1.0,
        maximum=7000.0,
        advice="A CAN bus of 250 kbit/s carries at most about 800 NETCANOEM readings per second.",
    )


@dataclass(frozen=True)
class WrenchSample:
    """One reading in the sensor's own axes, without tare.

    stamp_ns: acquisition, ns since the epoch. force (3,) N, torque (3,) N m. channels (6,): what
    the sensor measured before any matrix (gauges), or force and torque themselves. status: the
    device's status word. quality: GOOD, SATURATED or CRITICAL; the values count only when GOOD.
    """

    stamp_ns: int
    force: np.ndarray
    torque: np.ndarray
    channels: np.ndarray
    status: int = 0
    quality: int = GOOD

    @classmethod
    def of_wrench(
        cls, stamp_ns: int, wrench: np.ndarray, status: int = 0, quality: int = GOOD
    ) -> WrenchSample:
        """Sample of a sensor that measures the wrench (6,) itself, in N and N m."""
        return cls(stamp_ns, wrench[:3], wrench[3:], wrench, status, quality)


class ForceSource(Device[WrenchSample]):
    """A force and torque sensor."""

    SETTINGS: type[ForceSettings] = ForceSettings

    def __init__(self, settings: ForceSettings) -> None:
        health = Health("force", expected_rate=settings.rate, stale_after=0.5)
        super().__init__(settings, health)

    def wrench_of(self, channels: np.ndarray) -> np.ndarray:
        """Wrench (6,) in N and N m of channels (6,), from which a bias may have been taken."""
        return np.asarray(channels, dtype=float)

    @property
    def scale_id(self) -> object:
        """Changes whenever `wrench_of` does, so that a bias in channels is known to be void."""
        return None
