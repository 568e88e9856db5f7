# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Will it slip? Stick ratio, margin and probability of slip, and friction, sample by sample.

    contact, slip = ContactEstimator(model), SlipEstimator()
    for stamp_ns, force in wrenches:
        for estimate in contact.add_wrench(stamp_ns, force):
            slip.assume(model.geometry, contact.material)
            if slip.add(estimate, force).slip_probability > 0.15:
                grip_harder()

Coulomb friction with one coefficient that is estimated while running, quasi-static, independent of
rate. The output is a function of the inputs in their order.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from finger_common.axes import DEFAULT_NORMAL_AXIS, axis_of
from finger_common.errors import InputError
from finger_common.flags import StateFlag
from finger_common.stamps import NANOSECONDS, nanoseconds, stamp_array

from ..estimator import ContactEstimate, EstimateBlock
from ..geometry import Geometry
from ..laws import MaxwellLaw
from ..material import Material
from . import kernels
from .settings import SlipSettings
from .shear import set_finger


class SlipEstimate(NamedTuple):
    """Tangential state of the contact at one instant (SI).

    stamp_ns; normal_force P (N); tangential_force Q (2,) in N: the wrench's components along the
    two sensor axes that follow the normal one (x, y, z in a circle); stick_ratio: share of the
    contact's area that sticks; slip_margin: 1 − |Q|/(μP); each with its standard deviation;
    slip_probability: that the whole contact slips now or within the horizon; friction μ and its
    standard deviation; tangential_displacement (2,) in m: of the bone over the plate since the
    contact began, as far as the skin sticks; tangential_stiffness (N/m); slips: slips seen so far;
    flags: bits of SlipFlag. Without contact all but forces and friction are NaN and the
    probability is 0.
    """

    stamp_ns: int
    normal_force: float
    tangential_force: tuple[float, float]
    stick_ratio: float
    stick_ratio_stddev: float
    slip_margin: float
    slip_margin_stddev: float
    slip_probability: float
    friction: float
    friction_stddev: float
    tangential_displacement: tuple[float, float]
    tangential_stiffness: float
    slips: int
    flags: int


class SlipEstimator:
    """Slip of one finger's contact; see the module.

    settings: None for the defaults; normal_axis: as in EstimatorSettings. Raises InputError for
    another axis.
    """

    def __init__(
        self, settings: SlipSettings | None = None, normal_axis: str = DEFAULT_NORMAL_AXIS
    ) -> None:
        axis, _ = axis_of(normal_axis)
        self.lateral_axes = (axis + 1) % 3, (axis + 2) % 3
        self._config = np.zeros(1, kernels.CONFIGURATION)
        self._state = np.zeros(1, kernels.STATE)
        self._samples = (
            np.zeros(1, np.int64),
            np.zeros(1),
            np.zeros((1, 2)),
            np.zeros(1, bool),
            np.zeros(1, bool),
            np.zeros(1),
            np.zeros(1),
        )
        self._row = np.zeros(1, kernels.OUTPUT)
        self._waiting: list[tuple[int, int, float, float]] = []
        self._stick_stamps: deque[int] = deque(maxlen=64)
        self._finger: tuple[Geometry, MaxwellLaw] | None = None
        self.assume(Geometry(), Material())
        self.configure(settings or SlipSettings())
        self.reset()

    def configure(self, settings: SlipSettings) -> None:
        """Take over settings; their prior enters at the next reset, or now if none was learned."""
        self.settings = settings
        config = self._config
        config["prior_mean"] = math.log(settings.friction_prior)
        config["prior_sd"] = settings.friction_prior_sd
        config["moisture_slope"] = settings.friction_moisture_slope
        config["drift"] = settings.friction_drift
        config["horizon"] = settings.slip_horizon
        config["noise"] = settings.tangential_noise
        if not self._state["known"]["told"][0]:
            kernels.set_prior(config[0], self._state[0], float(self._state["moisture"][0]))

    def assume(self, geometry: Geometry, material: MaxwellLaw) -> None:
        """The finger that displacement and stiffness are of; until this is called the default one.

        A new geometry takes some hundredths of a second.
        """
        if self._finger is None or self._finger != (geometry, material):
            self._finger = geometry, material
            set_finger(self._config[0], geometry, material)

    def reset(self) -> None:
        """A finger and a plate that were not seen before."""
        self._state[:] = np.zeros(1, kernels.STATE)
        kernels.set_prior(self._config[0], self._state[0], math.nan)

    def add(self, estimate: ContactEstimate, force: Sequence[float]) -> SlipEstimate:
        """One sample: the contact's estimate and the force (3,) in N that it came from."""
        if estimate.flags & StateFlag.TIME_RESET:
            self._begin_anew(estimate.stamp_ns)
        self._see_due(estimate.stamp_ns)
        first, second = self.lateral_axes
        stamps, normal, lateral, touching, doubted, indentation, moisture = self._samples
        stamps[0] = estimate.stamp_ns
        normal[0] = estimate.normal_force
        lateral[0, 0], lateral[0, 1] = force[first], force[second]
        touching[0] = estimate.in_contact
        doubted[0] = estimate.flags & StateFlag.FORCE_OFFSET
        indentation[0] = estimate.indentation
        moisture[0] = estimate.moisture
        kernels.follow_many(self._config, self._state, *self._samples, self._row)
        return slip_estimates(self._row)[0]

    def add_block(self, block: EstimateBlock, forces: np.ndarray) -> np.ndarray:
        """As `add` for a block of n estimates and their forces (n, 3); rows (n,) of OUTPUT."""
        stamps = block.column("stamp_ns")
        resets = np.flatnonzero(block.column("flags") & int(StateFlag.TIME_RESET)).tolist()
        found = [np.zeros(0, kernels.OUTPUT)]
        for begin, end in zip([0, *resets], [*resets, len(block)]):
            if begin in resets:
                self._begin_anew(int(stamps[begin]))
            while begin < end:
                self._see_due(int(stamps[begin]))
                until = end
                if self._waiting:
                    until = begin + int(np.searchsorted(stamps[begin:end], self._waiting[0][0]))
                rows = block.rows[begin:until]
                found.append(
                    self.add_many(
                        rows["stamp_ns"],
                        rows["normal_force"],
                        forces[begin:until][:, self.lateral_axes],
                        rows["in_contact"],
                        rows["indentation"],
                        rows["moisture"],
                        rows["flags"] & int(StateFlag.FORCE_OFFSET) != 0,
                    )
                )
                begin = until
        return np.concatenate(found)

    def add_many(
        self,
        stamps_ns: np.ndarray,
        normal_force: np.ndarray,
        lateral: np.ndarray,
        touching: np.ndarray,
        indentation: np.ndarray,
        moisture: np.ndarray | None = None,
        doubted: np.ndarray | None = None,
    ) -> np.ndarray:
        """Rows (n,) of `kernels.OUTPUT` for n samples.

        normal_force, indentation, moisture (n,), lateral (n, 2) in SI; touching (n,): whether in
        contact; doubted (n,): whether the force is hardly a finger's (FORCE_OFFSET): nothing is
        learned from a contact that ends so. Raises InputError for other shapes.
        """
        n = len(stamps_ns)
        if moisture is None:
            moisture = np.full(n, math.nan)
        if doubted is None:
            doubted = np.zeros(n, bool)
        for name, array, shape in (
            ("normal_force", normal_force, (n,)),
            ("lateral", lateral, (n, 2)),
            ("touching", touching, (n,)),
            ("indentation", indentation, (n,)),
            ("moisture", moisture, (n,)),
            ("doubted", doubted, (n,)),
        ):
            if np.shape(array) != shape:
                raise InputError(f"{name} has shape {np.shape(array)}, {shape} is needed")
        rows = np.zeros(n, kernels.OUTPUT)
        kernels.follow_many(
            self._config,
            self._state,
            stamp_array(stamps_ns),
            np.ascontiguousarray(normal_force, float),
            np.ascontiguousarray(lateral, float),
            np.ascontiguousarray(touching, bool),
            np.ascontiguousarray(doubted, bool),
            np.ascontiguousarray(indentation, float),
            np.ascontiguousarray(moisture, float),
            rows,
        )
        return rows

    def expect_stick_ratio(
        self, stamp_ns: int, stick_ratio: float, sd: float, delay: float
    ) -> None:
        """As `add_stick_ratio`, at the first sample stamped `stamp_ns` + `delay` (s) or later.

        So that the result does not depend on when the reading comes. A second one of a stamp, and
        one without a finite ratio, is left out.
        """
        if not math.isfinite(stick_ratio) or stamp_ns in self._stick_stamps:
            return
        self._stick_stamps.append(stamp_ns)
        due = stamp_ns + nanoseconds(delay)
        bisect.insort(self._waiting, (due, stamp_ns, float(stick_ratio), float(sd)))

    def _see_due(self, stamp_ns: int) -> None:
        """Use the stick ratios that are due at a sample of this stamp."""
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            self.add_stick_ratio(*self._waiting.pop(0)[1:])

    def _begin_anew(self, stamp_ns: int) -> None:
        """Time jumped back to a stamp: what is near it is still to come."""
        self.reset()
        self._stick_stamps.clear()
        self._waiting = [w for w in self._waiting if abs(w[1] - stamp_ns) < NANOSECONDS]

    def add_stick_ratio(self, stamp_ns: int, stick_ratio: float, sd: float) -> bool:
        """A stick ratio seen by a camera at `stamp_ns`, with its standard deviation.

        False when it tells nothing: no contact then, no tangential load, or after a reversal.
        """
        if not (math.isfinite(stick_ratio) and sd > 0.0):
            return False
        return bool(kernels.see_stick(self._state[0], stamp_ns, float(stick_ratio), float(sd)))


def slip_estimates(rows: np.ndarray) -> list[SlipEstimate]:
    """Rows (n,) of `kernels.OUTPUT` as SlipEstimates."""
    found = []
    for row in rows.tolist():
        values = list(row)
        values[2], values[10] = tuple(values[2]), tuple(values[10])
        found.append(SlipEstimate._make(values))
    return found
