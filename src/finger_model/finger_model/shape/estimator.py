# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Aspect of the pad and tilt of the plate, from the outline and from the centre of pressure.

An extended Kalman filter. Outlines of a camera tell the ratio and the direction of the ellipse's
axes and the centre of the contact, torques of a six-axis sensor its centre of pressure; what they
are in a pose is `correction`'s. A tilt moves the contact by some 0.1 to 0.2 mm a degree: it is
known as well as the place of the finger is. What stays wrong from one measurement to the next is
among the unknowns, so that no number of measurements makes the tilt surer than it is:

- logarithm of the aspect, which stays from contact to contact, pitch and roll;
- the place of the pad's centre over the plate (2);
- the correction's errors of the ellipse's shape (2) and of the centres (2), which are others at
  another depth of the contact;
- what is left of the torque's zero (2), and the place of its origin (2);
- logarithm of how much farther a tilt moves the contact of this finger than the lengths say.

All but the aspect wander about what is known before, as far as its standard deviation lets them;
the last one stays for a contact.
Measurements that are not as expected, one after the other, quicken that.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from finger_common.axes import DEFAULT_NORMAL_AXIS, axis_of, lateral_axes
from finger_common.flags import ShapeFlag, StateFlag
from finger_common.stamps import NANOSECONDS, nanoseconds

from ..delayed import REMEMBERED, Delayed
from ..estimator import ContactEstimate
from ..pose.correction import Outline, PoseCorrection
from ..pose.pose import ASPECTS, LARGEST_TILT, Pose
from ..sensor_air import SILENCE
from .estimate import MeasuredOutline, ShapeEstimate
from .settings import PoseSettings
from .torque_zero import TorqueZero

ASPECT, PITCH, ROLL = 0, 1, 2
PLACE, SHAPE, CENTER, ZERO, ORIGIN = (slice(k, k + 2) for k in range(3, 13, 2))
STRETCH = 13
UNKNOWNS = 14
STEPS = np.array([0.02, 0.01, 0.01])
"""Of the derivatives by the logarithm of the aspect, pitch and roll."""

SHAPE_SD, PLACE_SD = 0.04, 0.12e-3
"""Errors of the correction itself: of ln(a/b), and of the centres (m). What the lengths leave
unknown of the centres is `PoseCorrection.stretch_sd`; ln(a/b) hardly depends on them."""

LASTING = 0.05
"""Change of the contact's depth (`PoseCorrection.depth`) over which such an error stays."""

PLACE_WANDER = 0.2e-3
"""m, by which finger, plate and sensor move in a second."""

ASPECT_WANDER = 0.1
"""By which the logarithm of the aspect may differ from that in the contact before: another finger
may come."""

SURPRISES, TREND = 2.0, 12.0
"""Measurements over which squares of their distances from what is expected are averaged, in
standard deviations, and over which the distances themselves are: these tell a slow change."""

SURPRISED, LARGEST_SURPRISE = 3.0, 8.0
"""Mean square from which tilt and places wander faster, and the most standard deviations that one
measurement counts with in it."""

QUICKEST = 100.0
"""Times, at most, the variance of that wandering."""

LATEST = 0.3
"""s before the present, at most, of which the last outline tells the tilt."""

DISAGREEMENT = 4.0
"""Mean squared standard deviations by which the torque's origin lies beside its place from which
camera and torque contradict each other."""

TINY = 1e-30
"""Variance in place of 0, of an unknown that is known."""

PRESSURE_PERIOD = nanoseconds(1.0 / 30.0)
"""ns of torque samples that are taken together."""

SHAPE_PERIOD, SHAPE_EARLY = nanoseconds(0.02), nanoseconds(0.005)
"""ns from one shape to the next, and by which one may come early: samples of a sensor of 50 Hz do
not come at even times."""

SMALLEST_FORCE = 0.1
"""N; below it neither outline nor centre of pressure is used."""

OUTLIER = 4.0
"""Standard deviations from which a measurement counts less."""

PLACE_LIMIT = 4.0
"""Standard deviations of the places of pad and sensor by which a centre of pressure may lie beside
the pad."""

CERTAIN_TILT = math.radians(3.0)


class PoseEstimator:
    """Shape and pose of one finger's contact; see the module.

    assumed: as for `assume`; settings: None for the defaults; normal_axis: as in EstimatorSettings.
    Raises InputError for another axis.
    """

    def __init__(
        self,
        assumed: PoseCorrection,
        settings: PoseSettings | None = None,
        normal_axis: str = DEFAULT_NORMAL_AXIS,
    ) -> None:
        self.settings = settings or PoseSettings()
        self._assumed = assumed
        self._correction: PoseCorrection | None = None
        self.outlines: Delayed[MeasuredOutline] = Delayed()
        """Outlines that wait; the owner sets the delay."""
        self._areas: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)
        self.turn(normal_axis)

    def configure(self, settings: PoseSettings) -> None:
        """Take over settings, and begin anew."""
        self.settings = settings
        self.reset()

    def assume(self, assumed: PoseCorrection) -> None:
        """What the contact's estimator corrects its area by from the next sample on.

        Its finger and skin are taken over. Its pose is the first guess: with another one the
        search begins anew.
        """
        if assumed is self._assumed:
            return
        before, self._assumed = self._assumed, assumed
        self._correction = None
        if assumed.pose != before.pose:
            self._begin_search()

    def turn(self, normal_axis: str) -> None:
        """Begin anew with this axis of the sensor along the plate's normal.

        Raises InputError for another axis.
        """
        self._axis, self._sign = axis_of(normal_axis)
        self._first, self._second = lateral_axes(normal_axis)
        self.reset()

    def reset(self) -> None:
        """A finger that was not seen before."""
        self._areas.clear()
        self._zero = TorqueZero(self.settings.torque_noise)
        self._begin_search()

    def _begin_search(self) -> None:
        settings = self.settings
        self.mean = np.zeros(UNKNOWNS)
        self.covariance = np.zeros((UNKNOWNS, UNKNOWNS))
        self.mean[ASPECT] = math.log(self._assumed.pose.aspect)
        self.covariance[ASPECT, ASPECT] = settings.pad_aspect_sd**2
        self._touching = self._outlined = self._pressed = self._pressed_outside = False
        self._due = self._heard = 0
        self._sum, self._count, self._sum_since = np.zeros(2), 0, 0
        self._pressure = (math.nan, math.nan)
        self._correction = None
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        """A new contact: another tilt and place, the same pad."""
        settings, known = self.settings, self._assumed.pose
        aspect, unsure = self.mean[ASPECT], self.covariance[ASPECT, ASPECT] + ASPECT_WANDER**2
        place, origin = settings.pad_place_sd, math.hypot(settings.sensor_place_sd, PLACE_SD)
        sds = settings.tilt_sd, place, SHAPE_SD, PLACE_SD, self._zero.sd, origin
        wanders = settings.tilt_wander, PLACE_WANDER, 0.0, 0.0, 0.0, PLACE_WANDER
        stretch = self._assumed.stretch_sd**2
        self._variances = np.concatenate([[0.0], np.repeat(np.square(sds), 2), [stretch]])
        self._wanders = np.concatenate([[0.0], np.repeat(np.square(wanders), 2), [0.0]])
        self._known = np.zeros(UNKNOWNS)
        self._known[:3] = aspect, known.pitch, known.roll
        self._known = self._bounded(self._known)
        self.mean, self.covariance = self._known.copy(), np.diag(self._variances)
        self.covariance[ASPECT, ASPECT] = min(unsure, settings.pad_aspect_sd**2)
        self._outlined = self._pressed = self._pressed_outside = False
        self._updated, self._seen, self._depth = stamp_ns, stamp_ns, math.nan
        self._surprise, self._trend = np.ones(2), np.zeros(6)
        self._sum[:], self._count, self._sum_since = 0.0, 0, stamp_ns
        self._correction = None

    # Inputs ----------------------------------------------------------------------------------

    def expect_outline(self, stamp_ns: int, outline: MeasuredOutline) -> None:
        """An outline seen at `stamp_ns`; it is used at the first sample stamped that plus
        `outlines.delay` or later, so that the result does not depend on when it comes. A second one
        of a stamp is left out, and one that is not `usable`."""
        if outline.usable:
            self.outlines.add(stamp_ns, outline)

    def add(
        self, estimate: ContactEstimate, force: Sequence[float], torque: Sequence[float]
    ) -> ShapeEstimate | None:
        """One sample: the contact's estimate, and the force (3,) in N and torque (3,) in N m that
        it came with. Torques of zero are those of a sensor without.

        Gives the shape where one is due, one in SHAPE_PERIOD.
        """
        self._follow(estimate, force, torque)
        early = self._due - estimate.stamp_ns
        if SHAPE_EARLY < early <= SHAPE_PERIOD + SHAPE_EARLY:
            return None
        in_step = abs(early) < SHAPE_PERIOD
        self._due = (self._due if in_step else estimate.stamp_ns) + SHAPE_PERIOD
        return self.shape(estimate)

    def _follow(
        self, estimate: ContactEstimate, force: Sequence[float], torque: Sequence[float]
    ) -> None:
        stamp = estimate.stamp_ns
        if estimate.flags & StateFlag.TIME_RESET:
            # Time jumped back to this stamp.
            self.reset()
            self.outlines.jump_back(stamp)
        round_area = self._assumed.round_area(estimate.area) if estimate.area > 0 else 0.0
        self._areas.append((stamp, round_area))
        known = math.isfinite(estimate.normal_force + estimate.lateral_force)
        silent = known and 0 < self._heard < stamp - nanoseconds(SILENCE)
        if known:
            self._heard = stamp
        if silent:
            self._zero.forget()
        if estimate.in_contact and (silent or not self._touching):
            self._zero.touch(self._arm)
            self._begin(stamp)
        elif self._touching and not estimate.in_contact:
            self._zero.leave(stamp)
        self._touching = bool(estimate.in_contact)
        told = any(torque) and all(map(math.isfinite, (*torque, *force)))
        moment = self._moment(force, torque) if told else None
        if moment is not None and not self._touching:
            self._zero.see_air(stamp, moment, float(force[self._axis]), self._arm)
        for seen, outline in self.outlines.due(stamp):
            if self._touching and seen >= estimate.onset_ns:
                self._see_outline(seen, outline)
        pressed = estimate.normal_force > SMALLEST_FORCE and round_area > 0.0
        if not self._touching or not pressed or moment is None:
            self._pressure = (math.nan, math.nan)
            return
        self._add_pressure(stamp, round_area, float(force[self._axis]), moment)

    @property
    def _arm(self) -> float:
        """How far (m) from the torque's origin the pad may press, as far as is known."""
        settings = self.settings
        beside = settings.pad_x - settings.sensor_x, settings.pad_y - settings.sensor_y
        return math.hypot(*beside) + self._assumed.geometry.pad_semi_axis_radial

    def _moment(self, force: Sequence[float], torque: Sequence[float]) -> tuple[float, float]:
        """Centre of pressure times the force along the normal axis (2,) in N m, in sensor axes."""
        # Whether the sensor's axis points from the plate to the finger: the plate is pressed
        # against that direction, the finger along it.
        up = self._sign if self.settings.wrench_on_finger else -self._sign
        # M = r × F with r = (x, y, depth towards the finger), the axes in a circle. Seen towards
        # the finger, the other two axes of a sensor that is turned over are mirrored.
        a, b = self._first, self._second
        height = up * self.settings.sensor_depth
        along = height * force[a] - torque[b], up * (height * force[b] + torque[a])
        return float(along[0]), float(along[1])

    def _see_outline(self, stamp_ns: int, outline: MeasuredOutline) -> None:
        area = self._area_at(stamp_ns)
        if not area > 0.0:
            return
        ratio = outline.major / outline.minor
        double = 2.0 * (outline.angle - self.settings.finger_direction)
        shape = math.log(ratio) * np.array([math.cos(double), math.sin(double)])
        shape_sd = math.hypot(outline.major_sd / outline.major, outline.minor_sd / outline.minor)
        measured = np.concatenate([shape, self._to_finger(outline.center)])
        errors = math.hypot(shape_sd, SHAPE_SD), math.hypot(outline.center_sd, PLACE_SD)
        sds = np.repeat(errors, 2)
        self._correct(stamp_ns, area, measured, sds, slice(0, 4))
        self._outlined, self._seen = True, stamp_ns

    def _add_pressure(
        self, stamp: int, round_area: float, normal: float, moment: tuple[float, float]
    ) -> None:
        """Mean centre of pressure of a thirtieth of a second."""
        x, y = ((m - zero) / normal for m, zero in zip(moment, self._zero.mean, strict=True))
        turn = self.settings.sensor_direction
        c, s = math.cos(turn), math.sin(turn)
        self._sum += c * x - s * y + self.settings.sensor_x, s * x + c * y + self.settings.sensor_y
        self._count += 1
        if stamp - self._sum_since < PRESSURE_PERIOD:
            return
        mean = self._sum / self._count
        self._pressure = float(mean[0]), float(mean[1])
        self._sum[:], self._count, self._sum_since = 0.0, 0, stamp
        place = self._to_finger(self._pressure)
        pad = self._assumed.geometry.pad_semi_axis_radial * max(math.exp(self.mean[ASPECT]), 1.0)
        places = self.settings.pad_place_sd, self.settings.sensor_place_sd
        farthest = pad + PLACE_LIMIT * math.hypot(*places)
        # Also where it is NaN, the sum of endless torques of both signs.
        self._pressed_outside = not math.hypot(place[0], place[1]) <= farthest
        if self._pressed_outside:
            return
        sds = np.full(2, math.hypot(self.settings.torque_noise / abs(normal), PLACE_SD))
        self._correct(stamp, round_area, place, sds, slice(4, 6), 1.0 / abs(normal))
        self._pressed = True
        if not self._outlined:
            self._seen = stamp

    # Filter ----------------------------------------------------------------------------------

    def _correct(
        self,
        stamp_ns: int,
        area: float,
        measured: np.ndarray,
        sds: np.ndarray,
        which: slice,
        per_torque: float = 0.0,
    ) -> None:
        """Update by measurements; `which`: of those that `_expected` gives; per_torque (1/N): what
        a torque moves the centre of pressure by."""
        self._wander(stamp_ns)
        prior, spread = self.mean.copy(), self.covariance
        # A wrong aspect outlasts the contact. One that is out itself may come back.
        tilt = Pose(1.0, float(prior[PITCH]), float(prior[ROLL])).tilt
        learns_aspect = self._assumed.inside_but_for_aspect(tilt)
        mean = prior
        for _ in range(3):
            expected, slope = self._linear(mean, area, per_torque)
            h, expected = slope[which], expected[which]
            gap = measured - expected - h @ (prior - mean)
            innovation = h @ spread @ h.T + np.diag(sds**2)
            size = gap @ np.linalg.solve(innovation, gap) / len(gap)
            if mean is prior:
                self._see_surprise(gap / np.sqrt(np.diag(innovation)), which)
            if size > OUTLIER**2:
                innovation += np.diag(sds**2) * (size / OUTLIER**2 - 1.0)
            gain = np.linalg.solve(innovation, h @ spread).T
            # Nothing tells it from the tilt.
            gain[STRETCH] = 0.0
            if not learns_aspect:
                gain[ASPECT] = 0.0
            found = self._bounded(prior + gain @ gap)
            # All else is linear.
            step, mean = np.abs(found - mean)[: PLACE.start], found
            if np.all(step < 0.3 * np.sqrt(np.diag(spread)[: PLACE.start]) + 1e-9):
                break
        self.mean = mean
        kept = np.eye(UNKNOWNS) - gain @ h
        # Also right where the gain is not the best one.
        noise = innovation - h @ spread @ h.T
        spread = kept @ spread @ kept.T + gain @ noise @ gain.T
        self.covariance = 0.5 * (spread + spread.T)
        self._correction = None

    def _see_surprise(self, gap: np.ndarray, which: slice) -> None:
        """Take note of how far measurements lie beside what is expected, in standard deviations."""
        gap = np.clip(gap, -LARGEST_SURPRISE, LARGEST_SURPRISE)
        self._trend[which] += (gap - self._trend[which]) / TREND
        steady = (2.0 * TREND - 1.0) * self._trend[which] ** 2
        square = float(np.max(np.maximum(gap**2, steady)))
        kind = int(which.start > 0)
        self._surprise[kind] += (square - self._surprise[kind]) / SURPRISES

    @property
    def _wandering(self) -> np.ndarray:
        """Variances (UNKNOWNS,) that a second adds."""
        quickened = max(float(self._surprise.max()) / SURPRISED, 1.0) ** 3
        return min(quickened, QUICKEST) * self._wanders

    def _wander(self, stamp_ns: int) -> None:
        """What has changed since the last measurement."""
        passed = max(stamp_ns - self._updated, 0) / NANOSECONDS
        self._updated = max(stamp_ns, self._updated)
        depth = self._assumed.depth(self._areas[-1][1])
        deepened = 0.0 if math.isnan(self._depth) else abs(depth - self._depth)
        self._depth = depth
        # Each unknown forgets so that, left alone, it keeps the deviation that it began with.
        rates = passed * self._wandering / np.maximum(self._variances, TINY)
        rates[SHAPE] = rates[CENTER] = 2.0 * deepened / LASTING
        kept = np.exp(-0.5 * rates)
        self.mean = self._known + kept * (self.mean - self._known)
        self.covariance *= np.outer(kept, kept)
        self.covariance += np.diag(self._variances * (1.0 - kept**2))

    def _bounded(self, mean: np.ndarray) -> np.ndarray:
        low, high = np.log(ASPECTS)
        mean[ASPECT] = min(max(mean[ASPECT], 0.9 * low), 0.9 * high)
        size = math.hypot(mean[PITCH], mean[ROLL])
        if size > 0.9 * LARGEST_TILT:
            mean[1:3] *= 0.9 * LARGEST_TILT / size
        return mean

    def _expected(self, mean: np.ndarray, area: float, per_torque: float) -> np.ndarray:
        """Shape (2), centre (2) and centre of pressure (2) in axes of the finger."""
        found = self._corrected(mean).outline(area)
        shape = math.log(found.semi_axes[0] / found.semi_axes[1])
        double = 2.0 * found.orientation
        aside = mean[PLACE] + mean[CENTER]
        torque = mean[ORIGIN] + per_torque * mean[ZERO]
        return np.concatenate(
            [
                mean[SHAPE] + (shape * math.cos(double), shape * math.sin(double)),
                found.center + aside,
                found.center_of_pressure + aside + torque,
            ]
        )

    def _linear(
        self, mean: np.ndarray, area: float, per_torque: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """What is expected, and its derivatives (6, UNKNOWNS)."""
        middle = self._expected(mean, area, per_torque)
        slope = np.zeros((6, UNKNOWNS))
        for k, size in enumerate(STEPS):
            moved = mean.copy()
            moved[k] += size
            ahead = self._expected(moved, area, per_torque)
            moved[k] -= 2.0 * size
            slope[:, k] = (ahead - self._expected(moved, area, per_torque)) / (2.0 * size)
        one = np.eye(2)
        slope[0:2, SHAPE] = slope[2:4, PLACE] = slope[2:4, CENTER] = one
        slope[4:6, PLACE] = slope[4:6, CENTER] = slope[4:6, ORIGIN] = one
        slope[4:6, ZERO] = per_torque * one
        aside, torque = mean[PLACE] + mean[CENTER], mean[ORIGIN] + per_torque * mean[ZERO]
        slope[2:6, STRETCH] = middle[2:6] - np.concatenate([aside, aside + torque])
        return middle, slope

    def _corrected(self, mean: np.ndarray) -> PoseCorrection:
        pose = Pose(math.exp(mean[ASPECT]), float(mean[PITCH]), float(mean[ROLL]))
        return PoseCorrection(self._assumed.geometry, pose, self._assumed.skin_ratio)

    def _area_at(self, stamp_ns: int) -> float:
        """Area of the round pad at a past stamp, NaN when it is not remembered."""
        areas = self._areas
        back = len(areas) - 1
        while back >= 0 and areas[back][0] > stamp_ns:
            back -= 1
        return areas[back][1] if back >= 0 else math.nan

    # Results ---------------------------------------------------------------------------------

    @property
    def pose(self) -> Pose:
        """The present estimate."""
        return self._corrected(self.mean).pose

    def shape(self, estimate: ContactEstimate) -> ShapeEstimate:
        """Shape at the sample that `add` had last."""
        if self._correction is None:
            self._correction = self._corrected(self.mean)
        apart = self.mean[ORIGIN]
        disagreement = float(apart @ apart) / (2.0 * self._variances[ORIGIN][0])
        sds = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        behind = min(max(estimate.stamp_ns - self._seen, 0) / NANOSECONDS, LATEST)
        since = np.hypot(sds[1:3], np.sqrt(behind * self._wandering[1:3]))
        sds[1:3] = np.minimum(since, self.settings.tilt_sd)
        # It is not known which of the two is wrong.
        sds[1:3] *= math.sqrt(max(disagreement, 1.0))
        aspect, pitch, roll = math.exp(self.mean[ASPECT]), float(self.mean[1]), float(self.mean[2])
        flags = 0
        if not self._touching:
            flags |= ShapeFlag.NO_CONTACT
        if not self._outlined:
            flags |= ShapeFlag.OUTLINE_MISSING
        if math.isnan(self._pressure[0]) and not self._pressed:
            flags |= ShapeFlag.TORQUE_MISSING
        if self._pressed_outside or disagreement > DISAGREEMENT:
            flags |= ShapeFlag.PRESSURE_OUTSIDE
        if max(sds[1:3]) > CERTAIN_TILT:
            flags |= ShapeFlag.TILT_UNCERTAIN
        if not self._correction.inside:
            flags |= ShapeFlag.OUT_OF_RANGE
        area, axes, angle = 0.0, (0.0, 0.0), math.nan
        center = (math.nan, math.nan)
        if self._touching and estimate.area > 0.0:
            found = self._correction.outline(self._areas[-1][1])
            area = estimate.area
            scale = math.sqrt(area / found.area)
            axes = found.semi_axes[0] * scale, found.semi_axes[1] * scale
            angle = _half_turn(found.orientation + self.settings.finger_direction)
            center = self._to_plate(found, self.mean[PLACE] + self.mean[CENTER])
        return ShapeEstimate(
            estimate.stamp_ns,
            area,
            *axes,
            angle,
            center,
            self._pressure if self._touching else (math.nan, math.nan),
            aspect,
            aspect * float(sds[0]),
            pitch,
            float(sds[1]),
            roll,
            float(sds[2]),
            int(flags),
        )

    def _to_finger(self, place: Sequence[float]) -> np.ndarray:
        """Place (2,) of the plate, from the assumed place of the pad, in axes of the finger."""
        c, s = math.cos(self.settings.finger_direction), math.sin(self.settings.finger_direction)
        x, y = place[0] - self.settings.pad_x, place[1] - self.settings.pad_y
        return np.array([c * x + s * y, c * y - s * x])

    def _to_plate(self, outline: Outline, offset: np.ndarray) -> tuple[float, float]:
        c, s = math.cos(self.settings.finger_direction), math.sin(self.settings.finger_direction)
        x, y = outline.center + offset
        return (
            float(c * x - s * y) + self.settings.pad_x,
            float(s * x + c * y) + self.settings.pad_y,
        )


def _half_turn(angle: float) -> float:
    """The same axis in (−π/2, π/2]."""
    angle = angle % math.pi
    return angle - math.pi if angle > 0.5 * math.pi else angle
