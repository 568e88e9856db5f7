# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the estimator: one declaration for the core, the node and the node reference."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES
from finger_common.contact_threshold import LIFTOFF_FORCE, ONSET_FORCE, check_thresholds
from finger_common.flags import AreaFlag
from finger_common.moisture import MOISTURE_RANGE
from finger_common.settings import Settings, setting

from ..paper import NATURAL
from ..pose.pose import Pose

_runtime = partial(setting, runtime=True)
"""A setting that may change while the estimator runs, as all of them may."""

_REJECTED = AreaFlag.NO_CONTACT | AreaFlag.SPARSE | AreaFlag.CLIPPED | AreaFlag.LOW_CONTRAST


@dataclass(frozen=True)
class EstimatorSettings(Settings):
    """How the estimator reads its inputs and weighs them. Raises InputError for bad values."""

    normal_axis: str = _runtime(
        DEFAULT_NORMAL_AXIS,
        "Sensor axis along which the wrench's force is positive when the finger presses.",
        choices=NORMAL_AXES,
        advice="If the state never shows contact, try the opposite sign.",
    )
    onset_force: float = _runtime(
        ONSET_FORCE,
        "Normal force from which the finger counts as in contact.",
        unit="N",
        minimum=0.001,
        maximum=1.0,
        advice="Raise it when noise in the air starts contacts.",
    )
    liftoff_force: float = _runtime(
        LIFTOFF_FORCE,
        "Normal force below which a contact ends; lower than onset_force, so that noise does not "
        "start and end contacts.",
        unit="N",
        minimum=0.0,
        maximum=1.0,
    )
    force_zero_sd: float = _runtime(
        0.01,
        "Standard deviation of the zero of the normal force. It widens the deviations of area and "
        "pressures, most at low forces.",
        unit="N",
        minimum=0.0,
        maximum=1.0,
        advice="Raise it for a sensor that drifts between two tares.",
    )
    lateral_ratio: float = _runtime(
        0.25,
        "Lateral over normal force above which a sample is flagged; the friction coefficient of "
        "the model.",
        minimum=0.0,
        maximum=10.0,
    )
    gap_limit: float = _runtime(
        0.05,
        "Time between two wrench samples from which the later one is flagged.",
        unit="s",
        minimum=0.001,
        maximum=10.0,
        advice="Raise it above the sample period of a slow sensor.",
    )
    time_reset_after: float = _runtime(
        1.0,
        "A sample older than the newest by more than this is a jump of time and resets the state; "
        "a smaller step back is an out-of-order sample and is dropped.",
        unit="s",
        minimum=0.01,
        maximum=3600.0,
    )
    fusion_delay: float = _runtime(
        0.1,
        "An area or moisture reading stamped t enters at the first wrench sample stamped t plus "
        "this or later; one that arrives after that is not used.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
        advice="Raise it when areas are flagged late: camera, transport and image processing must "
        "fit in.",
    )
    fuse_area: bool = _runtime(True, "Correct the model's area by the measured one.")
    rejected_area_flags: int = _runtime(
        int(_REJECTED),
        "ContactArea flags that keep a measurement from being fused, as a sum of bits "
        "(1 no contact, 2 sparse, 4 clipped, 8 low contrast).",
        minimum=0,
        maximum=511,
    )
    outlier_limit: float = _runtime(
        5.0,
        "Standard deviations between measured and expected area from which a measurement is "
        "rejected; the third in a row is accepted.",
        minimum=1.0,
        maximum=100.0,
    )
    area_stale_after: float = _runtime(
        0.5,
        "Age of the last fused area from which the state is flagged.",
        unit="s",
        minimum=0.01,
        maximum=60.0,
    )
    moisture_stale_after: float = _runtime(
        900.0,
        "Age of the moisture reading from which the state is flagged.",
        unit="s",
        minimum=1.0,
        maximum=86400.0,
    )
    default_moisture: float = _runtime(
        NATURAL.moisture,
        "Reading assumed until the first one arrives (mean of the paper's natural condition).",
        unit="a.u.",
        minimum=MOISTURE_RANGE[0],
        maximum=MOISTURE_RANGE[1],
    )
    prior_area_sd: float = _runtime(
        0.1,
        "Relative standard deviation of the model's area for a finger not seen before, in addition "
        "to what the covariance of the parameter sets gives.",
        minimum=0.001,
        maximum=1.0,
    )
    contact_area_sd: float = _runtime(
        0.05,
        "Relative standard deviation of the area from one contact of the same finger to the next; "
        "a first value: the estimator weighs 0.1 to 1.5 times this by the areas measured so far.",
        minimum=0.001,
        maximum=1.0,
    )
    area_gain_sd: float = _runtime(
        0.0,
        "Standard deviation (logarithm) of the factor that all measured areas share: calibration "
        "of the plate, threshold of the images. No later area shows it, so it widens every "
        "area_stddev.",
        minimum=0.0,
        maximum=1.0,
        advice="0.05 is what a fit assumes; at 0 the estimate is of the area that the camera "
        "would see without noise.",
    )
    slope_sd: float = _runtime(
        0.017,
        "Standard deviation of the model's error in the exponent of area over force, "
        "d ln A / d ln F.",
        minimum=0.0,
        maximum=1.0,
    )
    drift_sd: float = _runtime(
        0.02,
        "Relative standard deviation by which the model's error drifts in one second of contact; "
        "a first value: the estimator weighs 0.1 and 2 times this by the areas measured so far.",
        minimum=0.0,
        maximum=1.0,
    )

    pad_aspect: float = _runtime(
        1.0,
        "Length over width of the pad, where it is known; 1: round. The area of the model is "
        "corrected by it and by the plate's tilt.",
        minimum=0.5,
        maximum=2.0,
        advice="Learned for 1 to 1.6; the width is that of the geometry.",
    )
    plate_pitch: float = _runtime(
        0.0,
        "Tilt of the plate against the finger: its side towards the fingertip rises.",
        unit="rad",
        minimum=-0.78,
        maximum=0.78,
        advice="Learned up to 0.52 (30°), with plate_roll.",
    )
    plate_roll: float = _runtime(
        0.0,
        "Tilt of the plate about the finger's long axis: its side at 90 deg from the fingertip, "
        "from +x towards +y of contact_area, rises.",
        unit="rad",
        minimum=-0.78,
        maximum=0.78,
    )

    @property
    def pose(self) -> Pose:
        """Pad and plate; raises InputError for a tilt beyond 45°."""
        return Pose(self.pad_aspect, self.plate_pitch, self.plate_roll)

    def validate(self) -> None:
        check_thresholds(self.onset_force, self.liftoff_force)
        assert self.pose
