# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What follows the contact's estimator sample by sample, live and offline: slip and pose.

    slip_and_shape = SlipAndShape(estimator, SlipSettings(), PoseSettings())
    for stamp_ns, force, torque in wrenches:
        for estimate in estimator.add_wrench(stamp_ns, force):
            slip, shape = slip_and_shape.process(estimate, force, torque)

They take finger, parameters, axis and delay from the estimator, so that a recording of its events
is enough to repeat them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from finger_common.axes import lateral_axes
from finger_common.moisture import MOISTURE_RANGE

from .estimator import ContactEstimate, ContactEstimator, EstimateBlock
from .laws import MaxwellLaw
from .parameter_sets import ParameterSets
from .reduced.model import ReducedModel
from .shape.estimate import MeasuredOutline, ShapeEstimate
from .shape.estimator import PoseEstimator
from .shape.settings import PoseSettings
from .slip import SlipEstimate, SlipEstimator, SlipSettings
from .slip.estimate import OUTPUT
from .slip.shear import shear_curve


def prepare(model: ReducedModel, sets: ParameterSets) -> None:
    """Compute what slip needs of all skins that moisture may make of a finger, some twentieths of a
    second each, so that no sample waits for it; the results are kept."""
    low, high = MOISTURE_RANGE
    for moisture in np.linspace(low, high, 1 + round(high - low)):
        parameters = sets.interpolate(float(moisture)).parameters
        material = model.material.with_vector(parameters)
        assert isinstance(material, MaxwellLaw)
        shear_curve(model.geometry, material)


class SlipAndShape:
    """Slip and pose of the finger of one estimator.

    estimator: may be replaced; with another one they begin anew. slip, pose: settings, None for
    what is not wanted.
    """

    def __init__(
        self, estimator: ContactEstimator, slip: SlipSettings | None, pose: PoseSettings | None
    ) -> None:
        self.estimator = estimator
        self._slip: SlipEstimator | None = None
        self._pose: PoseEstimator | None = None
        self._known, self._surface = self._finger(), estimator.surfaces
        self.configure(slip, pose)

    def configure(self, slip: SlipSettings | None, pose: PoseSettings | None) -> None:
        """Take over settings where they changed, as `SlipEstimator` and `PoseEstimator` do; None:
        not wanted."""
        axis = self.estimator.settings.normal_axis
        if slip is None:
            self._slip = None
        elif self._slip is None:
            self._slip = SlipEstimator(slip, axis)
        elif slip != self._slip.settings:
            self._slip.configure(slip)
        if pose is None:
            self._pose = None
        elif self._pose is None:
            self._pose = PoseEstimator(self.estimator.pose_correction, pose, axis)
        elif pose != self._pose.settings:
            self._pose.configure(pose)
        self.keep_up()

    def _finger(self) -> tuple[ContactEstimator, int, str]:
        """What they begin anew with."""
        return self.estimator, self.estimator.fingers, self.estimator.settings.normal_axis

    def keep_up(self) -> None:
        """Take over what has changed of the estimator; every sample does.

        A new geometry takes some hundredths of a second: do it at the change where samples must not
        wait.
        """
        estimator, known, surface = self.estimator, self._known, self._surface
        self._known, self._surface = self._finger(), estimator.surfaces
        axis, delay = estimator.settings.normal_axis, estimator.settings.fusion_delay
        if self._slip is not None:
            if self._known != known:
                self._slip.turn(axis)
            elif self._surface != surface:
                self._slip.change_surface()
            self._slip.assume(estimator.model.geometry, estimator.material)
            self._slip.sticks.delay = delay
        if self._pose is not None:
            if self._known != known:
                self._pose.turn(axis)
            self._pose.assume(estimator.pose_correction)
            self._pose.outlines.delay = delay

    @property
    def lateral_axes(self) -> tuple[int, int]:
        """The two axes of the sensor along which slip has its vectors (2,)."""
        return lateral_axes(self.estimator.settings.normal_axis)

    def see_area(self, stamp_ns: int, stick: tuple[float, float], outline: MeasuredOutline) -> None:
        """Take what a picture shows beside an area that the estimator uses: the stick ratio with
        its standard deviation, and the outline; NaN where they are not known."""
        if self._slip is not None and math.isfinite(stick[0]):
            self._slip.expect_stick_ratio(stamp_ns, *stick)
        elif self._slip is not None:
            self._slip.expect_lost_sight(stamp_ns)
        if self._pose is not None:
            self._pose.expect_outline(stamp_ns, outline)

    def leave_out(self, first_ns: int, last_ns: int) -> None:
        """Forget what areas of these stamps (ns) showed: they came in a pause of the force, and
        none is used."""
        if self._slip is not None:
            self._slip.sticks.leave_out(first_ns, last_ns)
        if self._pose is not None:
            self._pose.outlines.leave_out(first_ns, last_ns)

    def process(
        self, estimate: ContactEstimate, force: Sequence[float], torque: Sequence[float]
    ) -> tuple[SlipEstimate | None, ShapeEstimate | None]:
        """Slip, and shape where one is due, of an estimate and the force (3,) in N and torque (3,)
        in N m of its sample; None for what is not wanted."""
        self.keep_up()
        slip = None if self._slip is None else self._slip.add(estimate, force)
        return slip, None if self._pose is None else self._pose.add(estimate, force, torque)

    def process_block(
        self, block: EstimateBlock, forces: np.ndarray, torques: np.ndarray
    ) -> tuple[np.ndarray, list[tuple[int, ShapeEstimate]]]:
        """As `process` for n estimates between which the estimator did not change.

        forces, torques (n, 3). Gives rows (n,) of `slip.estimate.OUTPUT`, and the shapes, each with
        the number of its estimate; without rows or shapes where they are not wanted.
        """
        self.keep_up()
        slips, shapes = np.zeros(0, OUTPUT), []
        if self._slip is not None:
            slips = self._slip.add_block(block, forces)
        if self._pose is not None:
            samples = zip(block, forces.tolist(), torques.tolist())
            for number, sample in enumerate(samples):
                shape = self._pose.add(*sample)
                if shape is not None:
                    shapes.append((number, shape))
        return slips, shapes
