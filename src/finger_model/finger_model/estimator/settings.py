"""Settings of the estimator: one described table for the core, the node and the node reference."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from finger_common.errors import InputError
from finger_common.parameters import Parameter, ParameterTable

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")

ESTIMATOR_PARAMETERS = ParameterTable(
    Parameter(
        "normal_axis",
        "-z",
        "Sensor axis along which the wrench's force is positive when the finger presses.",
        choices=AXES,
        runtime=True,
        advice="If the state never shows contact, try the opposite sign.",
    ),
    Parameter(
        "onset_force",
        0.05,
        "Normal force from which the finger counts as in contact.",
        unit="N",
        minimum=0.001,
        maximum=1.0,
        runtime=True,
        advice="Raise it when noise in the air starts contacts.",
    ),
    Parameter(
        "liftoff_force",
        0.03,
        "Normal force below which a contact ends; below onset_force, so that noise does not chatter.",
        unit="N",
        minimum=0.0,
        maximum=1.0,
        runtime=True,
    ),
    Parameter(
        "lateral_ratio",
        0.25,
        "Lateral over normal force above which a sample is flagged (the friction coefficient of the model).",
        minimum=0.0,
        maximum=10.0,
        runtime=True,
    ),
    Parameter(
        "gap_limit",
        0.05,
        "Time between two wrench samples from which the later one is flagged.",
        unit="s",
        minimum=0.001,
        maximum=10.0,
        runtime=True,
        advice="Raise it above the sample period of a slow sensor.",
    ),
    Parameter(
        "time_reset_after",
        1.0,
        "A sample older than the newest by more than this is a jump of time and resets the state; "
        "a smaller step back is an out-of-order sample and is dropped.",
        unit="s",
        minimum=0.01,
        maximum=3600.0,
        runtime=True,
    ),
    Parameter(
        "fusion_delay",
        0.1,
        "An area or moisture reading stamped t enters at the first wrench sample stamped t plus this or later; "
        "one that arrives after that is not used.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
        runtime=True,
        advice="Raise it when areas are flagged late: camera, transport and image processing must fit in.",
    ),
    Parameter(
        "fuse_area",
        True,
        "Correct the model's area by the measured one.",
        runtime=True,
    ),
    Parameter(
        "rejected_area_flags",
        15,
        "ContactArea flags that keep a measurement from being fused, as a sum of bits "
        "(1 no contact, 2 sparse, 4 clipped, 8 low contrast).",
        minimum=0,
        maximum=255,
        runtime=True,
    ),
    Parameter(
        "outlier_limit",
        5.0,
        "Standard deviations between measured and expected area from which a measurement is rejected; "
        "the third in a row is believed.",
        minimum=1.0,
        maximum=100.0,
        runtime=True,
    ),
    Parameter(
        "area_stale_after",
        0.5,
        "Age of the last fused area from which the state is flagged.",
        unit="s",
        minimum=0.01,
        maximum=60.0,
        runtime=True,
    ),
    Parameter(
        "moisture_stale_after",
        900.0,
        "Age of the moisture reading from which the state is flagged.",
        unit="s",
        minimum=1.0,
        maximum=86400.0,
        runtime=True,
    ),
    Parameter(
        "default_moisture",
        69.31,
        "Reading assumed until the first one arrives (mean of the paper's natural condition).",
        unit="a.u.",
        minimum=0.0,
        maximum=130.0,
        runtime=True,
    ),
    Parameter(
        "prior_area_sd",
        0.1,
        "Relative standard deviation of the model's area for a finger not seen before, beside what the "
        "covariance of the parameter sets says.",
        minimum=0.001,
        maximum=1.0,
        runtime=True,
    ),
    Parameter(
        "contact_area_sd",
        0.05,
        "Relative standard deviation of the area from one contact of the same finger to the next; "
        "a first value: the estimator weighs 0.1 to 1.5 times this as contacts with measured areas go by.",
        minimum=0.001,
        maximum=1.0,
        runtime=True,
    ),
    Parameter(
        "slope_sd",
        0.017,
        "Standard deviation of the model's error in the exponent of area over force, d ln A / d ln F.",
        minimum=0.0,
        maximum=1.0,
        runtime=True,
    ),
    Parameter(
        "drift_sd",
        0.02,
        "Relative standard deviation by which the model's error wanders within one second of contact; a first "
        "value: the estimator weighs 0.1 and 2 times this as contacts with measured areas go by.",
        minimum=0.0,
        maximum=1.0,
        runtime=True,
    ),
)
"""Every setting of the estimator, with unit, range and meaning."""


@dataclass(frozen=True)
class EstimatorSettings:
    """Checked settings; names, units and meanings as in ESTIMATOR_PARAMETERS."""

    normal_axis: str = "-z"
    onset_force: float = 0.05
    liftoff_force: float = 0.03
    lateral_ratio: float = 0.25
    gap_limit: float = 0.05
    time_reset_after: float = 1.0
    fusion_delay: float = 0.1
    fuse_area: bool = True
    rejected_area_flags: int = 15
    outlier_limit: float = 5.0
    area_stale_after: float = 0.5
    moisture_stale_after: float = 900.0
    default_moisture: float = 69.31
    prior_area_sd: float = 0.1
    contact_area_sd: float = 0.05
    slope_sd: float = 0.017
    drift_sd: float = 0.02

    def __post_init__(self) -> None:
        """Raises InputError for a value outside its range or contradictory ones."""
        for name, value in ESTIMATOR_PARAMETERS.check(asdict(self)).items():
            object.__setattr__(self, name, value)
        if self.liftoff_force >= self.onset_force:
            raise InputError(
                f"liftoff_force is {self.liftoff_force} N, not below onset_force "
                f"({self.onset_force} N); lower one or raise the other"
            )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> EstimatorSettings:
        """From a mapping that may hold other keys too, which are ignored."""
        return cls(**{k: v for k, v in values.items() if k in ESTIMATOR_PARAMETERS})

    def to_json(self) -> str:
        """JSON object with every setting; `from_json` gives equal settings."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> EstimatorSettings:
        """From `to_json`; raises InputError for text that is no JSON object."""
        try:
            values = json.loads(text)
        except ValueError:
            values = None
        if not isinstance(values, dict):
            raise InputError("estimator settings are not a JSON object; record the bag anew")
        return cls.from_mapping(values)
