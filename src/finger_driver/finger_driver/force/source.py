# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What every force sensor's driver gives, and the settings that all of them have."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from finger_common.diagnostics import ERROR, Health
from finger_common.errors import DeviceError
from finger_common.settings import Settings, setting
from finger_common.stamps import whole_stamp

from ..device import Device

GOOD, SATURATED, CRITICAL = 0, 1, 2
"""Quality of a sample: usable; a gauge or channel at its end; a fault or an impossible value."""

REPEATED = 0.1
"""s for which a sensor may repeat one sample; after them it stands still."""

_STILL, _STILL_SAMPLES = 1.0, 20
"""s, and samples at the rate set, of equal channels after which a sensor may be frozen."""

_CATCH_UP = 5
"""Missed polls that are made up for by polling without pause; more are skipped and counted."""

_STEPS = 1000
"""Steps that a range must have at least, and times that it may be wider than the end of scale."""


@dataclass(frozen=True)
class ForceSettings(Settings):
    """Settings of every force sensor."""

    rate: float = setting(
        500.0,
        "Samples per second: polled (netcanoem, and dbc with a request), averaged to (netft), or "
        "just expected (dbc of a sensor that streams).",
        unit="Hz",
        minimum=1.0,
        maximum=7000.0,
        advice="A CAN bus of 250 kbit/s carries at most about 800 NETCANOEM readings per second.",
    )
    force_range: float = setting(
        100.0,
        "Largest force of any axis that the sensor can measure; a reading beyond it is a fault.",
        unit="N",
        minimum=0.01,
        maximum=1e5,
        advice="The calibration sheet gives it.",
    )
    torque_range: float = setting(
        10.0,
        "Largest torque of any axis that the sensor can measure; a reading beyond it is a fault.",
        unit="N m",
        minimum=1e-4,
        maximum=1e5,
        advice="The calibration sheet gives it.",
    )

    def address(self) -> str:
        """What tells this sensor from others, in words; empty where nobody knows."""
        return ""


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
        """Sample of a sensor that measures the wrench (6,) itself, in N and N m.

        Raises DeviceError for another number of values, InputError for a stamp with a point.
        """
        wrench = np.asarray(wrench, dtype=float)
        if wrench.shape != (6,):
            raise DeviceError(
                f"a wrench has shape {wrench.shape}; the driver must give (6,), force in N and "
                "torque in N m"
            )
        return cls(whole_stamp(stamp_ns), wrench[:3], wrench[3:], wrench, status, quality)


class ForceSource(Device[WrenchSample]):
    """A force and torque sensor."""

    SETTINGS: type[ForceSettings] = ForceSettings

    settings: ForceSettings

    def __init__(self, settings: ForceSettings) -> None:
        health = Health(
            "force", expected_rate=settings.rate, stale_after=max(0.5, 5.0 / settings.rate)
        )
        super().__init__(settings, health)
        self._channels, self._changed, self._last_stamp, self._equal_samples = b"", 0, 0, 0
        """The newest good channels, and the stamp (ns) of the first sample that had them."""

    @property
    def longest_silence(self) -> float:
        """s without a sample after which the connection counts as lost."""
        return max(0.25, 3.0 / self.settings.rate)

    def poll_after(self, due: float) -> float:
        """When the poll after the one of `due` is due (monotonic s); polls that were missed by far
        are left out and counted."""
        period = 1.0 / self.settings.rate
        behind = time.monotonic() - due
        if behind > _CATCH_UP * period:
            skipped = int(behind / period)
            self.health.count("overrun", skipped)
            due += skipped * period
        return due + period

    def check_scale(self, where: str, step: np.ndarray, end: np.ndarray) -> None:
        """Raise DeviceError for a scale that cannot be that of a sensor of the range set.

        step, end: (6,) change of the wrench by one count and its largest value, in N and N m. A
        wrong scale gives values that are wrong by a factor and look right.
        """
        settings = self.settings
        for axes, setting_name, unit in (
            (slice(0, 3), "force_range", "N"),
            (slice(3, 6), "torque_range", "N m"),
        ):
            limit = getattr(settings, setting_name)
            coarse, least = float(np.max(step[axes])), float(np.min(end[axes]))
            if not (coarse <= limit / _STEPS and least >= limit / _STEPS):
                raise DeviceError(
                    f"{where}: one count is {coarse:.3g} {unit} and the end of scale "
                    f"{least:.3g} {unit}, which cannot be right for {setting_name} {limit:g} "
                    f"{unit}; check counts per unit and units in the sensor"
                )

    def checked(self, sample: WrenchSample) -> WrenchSample:
        """The sample; of quality CRITICAL where it lies beyond the sensor's range.

        Samples that all are equal stay good, but are told.
        """
        if sample.quality != GOOD:
            return sample
        settings = self.settings
        # Written so that NaN fails, too.
        if all(abs(f) <= settings.force_range for f in sample.force.tolist()) and all(
            abs(t) <= settings.torque_range for t in sample.torque.tolist()
        ):
            self.cleared("implausible")
            self._find_still(sample)
            return sample
        force = ", ".join(f"{v:.3g}" for v in sample.force)
        torque = ", ".join(f"{v:.3g}" for v in sample.torque)
        self.note(
            "implausible",
            f"force ({force}) N, torque ({torque}) N m: beyond force_range "
            f"{settings.force_range:g} N or torque_range {settings.torque_range:g} N m; check "
            "sensor, units and these settings",
            ERROR,
        )
        return replace(sample, quality=CRITICAL)

    def _find_still(self, sample: WrenchSample) -> None:
        """Tell of channels that stand still, since a sensor has noise; not of zeros, since one
        without a load, simulated or of coarse steps, may have none."""
        channels = sample.channels.tobytes()
        pause = (sample.stamp_ns - self._last_stamp) * 1e-9
        self._last_stamp = sample.stamp_ns
        if channels != self._channels or pause > max(_STILL, 5 / self.settings.rate):
            self._channels, self._changed, self._equal_samples = channels, sample.stamp_ns, 0
            self.cleared("still")
            return
        self._equal_samples += 1
        still = (sample.stamp_ns - self._changed) * 1e-9
        if still > _STILL and self._equal_samples > _STILL_SAMPLES and sample.channels.any():
            self.note(
                "still",
                f"no channel has changed for {still:.0f} s; if the sensor is not a coarse one at "
                "rest, it is frozen: switch it off and on",
            )

    def wrench_of(self, channels: np.ndarray) -> np.ndarray:
        """Wrench (6,) in N and N m of channels (6,), from which a bias may have been taken."""
        return np.asarray(channels, dtype=float)

    @property
    def scale_id(self) -> object:
        """Changes whenever `wrench_of` does, so that a bias in channels is known to be void."""
        return None

    @property
    def serial(self) -> str:
        """Serial number of the sensor, a part of `scale_id`; empty where it is not known.

        A sensor without one may be replaced by another while the connection is lost.
        """
        return ""
