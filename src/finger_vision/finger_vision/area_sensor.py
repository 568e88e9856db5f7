# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an area sensor is: an image or another signal in; contact area, outline and flags out.

Area sensors are found by the entry-point group ``finger_vision.area_sensor``. The vision node,
`finger-vision area` and the processing of bags choose one by the setting `area_sensor`;
docs/add_an_area_sensor.md shows how to add one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from finger_common.cli import one_line
from finger_common.errors import FingerError, InputError
from finger_common.flags import AreaFlag
from finger_common.plugins import PluginKind
from finger_common.settings import Settings

if TYPE_CHECKING:
    from .calibration import PlateCalibration

LARGEST_AREA = 0.01
"""m² that an area sensor may give; more is an area in another unit."""


@dataclass(frozen=True)
class SkinMotion:
    """How the skin of a contact has moved over the plate.

    stick_ratio: share of the contact that has not slipped since it touched or last stuck, NaN where
    it is not known, with its standard deviation. slip: (x, y) m, mean travel of the skin since the
    contact began, as far as it was followed. rotation: rad since then, from +x towards +y.
    sliding: whether the whole contact slides now.
    """

    stick_ratio: float = math.nan
    stick_ratio_sd: float = math.nan
    slip: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    sliding: bool = False


@dataclass(frozen=True)
class ContactMeasurement:
    """The contact in one image or signal, in SI units and the plate frame.

    gross_area, real_area, area_sd: m², exactly zero without contact; real_area may be NaN where
    the sensor cannot measure it. centroid: (x, y) m. ellipse_major, ellipse_minor: full axes, m,
    of the ellipse with the contact's second moments. ellipse_angle: rad in (−π/2, π/2], from +x
    towards +y. hull: (n, 2) m, outline of the gross contact. flags: `AreaFlag` bits. centroid_sd:
    m, standard deviation of each coordinate of the centroid; ellipse_major_sd, ellipse_minor_sd
    (m), ellipse_angle_sd (rad): of the ellipse; NaN where the sensor does not say. motion: of the
    skin over the plate, as far as it was followed.
    """

    gross_area: float = 0.0
    real_area: float = 0.0
    area_sd: float = 0.0
    centroid: tuple[float, float] = (0.0, 0.0)
    ellipse_major: float = 0.0
    ellipse_minor: float = 0.0
    ellipse_angle: float = 0.0
    hull: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    flags: int = 0
    centroid_sd: float = math.nan
    ellipse_major_sd: float = math.nan
    ellipse_minor_sd: float = math.nan
    ellipse_angle_sd: float = math.nan
    motion: SkinMotion = SkinMotion()


class NoLight(InputError):
    """A signal without the light that the background was learned with, or of one grey throughout: a
    contact is not seen in it, so that it shows neither one nor none.
    """


class SensorDefect(InputError):
    """An area sensor that failed, or gave what cannot be a measurement."""


class AreaSensor(Protocol):
    """Measures the contact in the signals of one device, one after the other.

    A signal is an array (H, W) as the device sent it: uint8, uint16 or float32; an image file may
    also give (H, W, 3) BGR or (H, W, 4) BGRA. The same signals in the same order must give the
    same results, and memory must not grow with them. A signal that cannot be used raises
    InputError, one without light its subclass NoLight.
    """

    SETTINGS: ClassVar[type[Settings]] = Settings
    """Settings of this kind of sensor: parameters of the node, options of the command."""

    learned: int
    """Number of signals without contact in the background, 0 after `reset`."""

    def __init__(self, settings: Any, calibration: PlateCalibration) -> None: ...

    def measure(self, signal: np.ndarray) -> ContactMeasurement:
        """The contact in a signal; the background stays as it is."""
        ...

    def learn(self, signal: np.ndarray) -> None:
        """Add a signal without contact to the background."""

    def reset(self) -> None:
        """Forget the background."""

    def process(self, signal: np.ndarray) -> ContactMeasurement:
        """Measure a signal and learn the background from it if it shows no contact."""
        measurement = _checked(self, self.measure(signal))
        if measurement.flags & AreaFlag.NO_CONTACT:
            self.learn(signal)
        return measurement


def measured(sensor: AreaSensor, signal: np.ndarray, learn: bool = False) -> ContactMeasurement:
    """The contact in a signal, checked; learn: a signal without one joins the background.

    Raises InputError for a signal that cannot be used, SensorDefect for a defect of the sensor.
    """
    try:
        found = sensor.process(signal) if learn else sensor.measure(signal)
    except FingerError:
        raise
    except Exception as error:
        raise SensorDefect(
            f"area sensor {type(sensor).__name__} failed ({type(error).__name__}: "
            f"{one_line(error)}); correct it"
        ) from error
    return _checked(sensor, found)


def _checked(sensor: AreaSensor, found: Any) -> ContactMeasurement:
    """What a sensor gave; raises SensorDefect where it cannot be a measurement."""
    name = f"area sensor {type(sensor).__name__}"
    if not isinstance(found, ContactMeasurement):
        raise SensorDefect(f"{name} gives {type(found).__name__}; a ContactMeasurement is needed")
    for area in ("gross_area", "real_area", "area_sd"):
        value = getattr(found, area)
        if not isinstance(value, Real) or float(value) < 0 or float(value) > LARGEST_AREA:
            raise SensorDefect(
                f"{name} gives {area} {value}; 0 … {LARGEST_AREA:g} m² or NaN is needed: correct "
                "the sensor, or the calibration of the plate"
            )
    if not isinstance(found.flags, Integral):
        raise SensorDefect(f"{name} gives flags {found.flags}; bits of AreaFlag are needed")
    hull = np.asarray(found.hull)
    if hull.size and hull.shape[1:] != (2,):
        raise SensorDefect(f"{name} gives a hull of shape {hull.shape}; (n, 2) in m is needed")
    return found


AREA_SENSORS = PluginKind(
    "finger_vision.area_sensor",
    "area sensor",
    AreaSensor,  # type: ignore[type-abstract]
    "area_sensor",
    default="ftir",
)
