# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Between messages and the core's plain data.

Messages are read by attribute: those of rclpy and those of a bag reader alike.
"""

from __future__ import annotations

import json
import math
from typing import Any

from finger_common.errors import InputError
from finger_common.files import parse_json
from finger_common.flags import AreaFlag
from finger_common.parameter_values import parameter_fields, parameter_values
from finger_common.stamps import NANOSECONDS, header_stamp, stamp_of, time_fields

from .estimator import ContactEstimate, EstimatorEvent, EventType
from .shape.estimate import NO_OUTLINE, MeasuredOutline, ShapeEstimate
from .slip import SlipEstimate

PLATE = "plate"
"""Frame of the plate, before a prefix."""

NOT_WHOLE = int(AreaFlag.NO_CONTACT | AreaFlag.SPARSE | AreaFlag.CLIPPED)
"""Flags of a contact of which too little is seen for a stick ratio."""


def wrench_of(message: Any) -> tuple[int, tuple[float, float, float]]:
    """Arguments of `add_wrench` from a geometry_msgs/WrenchStamped."""
    force = message.wrench.force
    return header_stamp(message), (force.x, force.y, force.z)


def area_of(message: Any) -> tuple[int, float, float, int]:
    """Arguments of `add_area` from a finger_msgs/ContactArea."""
    area, sd = float(message.gross_area), float(message.area_stddev)
    return header_stamp(message), area, sd, int(message.flags)


def stick_of(message: Any) -> tuple[float, float]:
    """Stick ratio that a camera saw and its standard deviation, from a finger_msgs/ContactArea.

    NaN where it is not known, as in recordings that are older than these fields, and where the
    picture of the contact is not whole.
    """
    if int(message.flags) & NOT_WHOLE:
        return math.nan, math.nan
    ratio, sd = (getattr(message, name, math.nan) for name in ("stick_ratio", "stick_ratio_stddev"))
    return float(ratio), float(sd)


def moisture_of(message: Any) -> tuple[int, float]:
    """Arguments of `add_moisture` from a finger_msgs/Moisture."""
    return header_stamp(message), float(message.value)


def event_of(message: Any) -> EstimatorEvent:
    """Argument of `apply_event` from a finger_msgs/ModelEvent."""
    if hasattr(message, "estimator_settings"):
        settings = json.dumps(parameter_values(message.estimator_settings), sort_keys=True)
        late = tuple(
            tuple(stamp_of(time) for time in times)
            for times in (message.late_areas, message.late_moistures)
        )
    else:
        settings, late = str(message.settings), _late_of_text(message.settings)
    return EstimatorEvent(
        header_stamp(message),
        EventType(int(message.type)),
        settings,
        str(message.parameter_sets),
        str(message.model_hash),
        str(message.reason),
        *late,
    )


def _late_of_text(settings: str) -> tuple[tuple[int, ...], ...]:
    """Stamps of late areas and readings in the JSON text that older recordings have.

    Empty without any, and for text that is none.
    """
    try:
        late = parse_json(settings, "settings").get("late", {})
        return tuple(tuple(int(s) for s in late.get(k, ())) for k in ("areas", "moistures"))
    except (InputError, ValueError, TypeError, AttributeError):
        return (), ()


def event_fields(event: EstimatorEvent, sequence: int) -> dict[str, Any]:
    """Fields of a ModelEvent; header and stamp are dicts of their own fields."""
    return {
        "header": {"stamp": time_fields(event.stamp_ns)},
        "type": int(event.type),
        "sequence": sequence,
        "parameter_sets": event.parameter_sets,
        "model_hash": event.model_hash,
        "reason": event.reason,
        "estimator_settings": parameter_fields(json.loads(event.settings)),
        "late_areas": [time_fields(stamp) for stamp in event.late_areas],
        "late_moistures": [time_fields(stamp) for stamp in event.late_moistures],
    }


def state_numbers(estimate: ContactEstimate) -> tuple[float, ...]:
    """Numbers of a finger_msgs/ContactState in the order of its fields, without its texts."""
    stamp, normal_force, lateral_force, in_contact, onset, *others = estimate
    numbers: list[Any] = [value for value in others if not isinstance(value, str)]
    return (
        *divmod(stamp, NANOSECONDS),
        normal_force,
        lateral_force,
        in_contact,
        *divmod(onset, NANOSECONDS),
        *numbers,
    )


def slip_numbers(estimate: SlipEstimate, lateral_axes: tuple[int, int]) -> tuple[float, ...]:
    """Numbers of a finger_msgs/ContactSlip in the order of its fields, without its text."""
    return _numbers(estimate, lateral_axes)


def outline_of(message: Any) -> MeasuredOutline:
    """Outline of a contact from a finger_msgs/ContactArea; NaN where it is not known, as in
    recordings that are older than its deviations, and where the contact is not seen whole."""
    if int(message.flags) & NOT_WHOLE:
        return NO_OUTLINE
    names = "centroid_stddev", "ellipse_major_stddev", "ellipse_minor_stddev"
    center = float(message.centroid.x), float(message.centroid.y)
    axes = (float(getattr(message, f"ellipse_{name}")) for name in ("major", "minor", "angle"))
    return MeasuredOutline(center, *axes, *(float(getattr(message, n, math.nan)) for n in names))


def plate_frame(area_frame: str, sensor_frame: str) -> str:
    """Frame of a shape: that of the last contact_area, or, where none names one, PLATE with what
    comes before the name of the sensor's frame, as in "thumb/force_sensor"."""
    prefix, slash, _ = sensor_frame.rpartition("/")
    return area_frame or f"{prefix}{slash}{PLATE}"


def shape_numbers(shape: ShapeEstimate) -> tuple[float, ...]:
    """Numbers of a finger_msgs/ContactShape in the order of its fields, without its text."""
    return _numbers(shape, (0, 1))


def shape_fields(shape: ShapeEstimate, frame_id: str = "") -> dict[str, Any]:
    """Fields of a finger_msgs/ContactShape."""
    fields = shape._asdict()
    header = {"stamp": time_fields(fields.pop("stamp_ns")), "frame_id": frame_id}
    for name in ("center", "center_of_pressure"):
        fields[name] = dict(zip("xy", fields[name]))
    return {"header": header, **fields}


def torque_of(message: Any) -> tuple[float, float, float]:
    """Torque (3,) in N m of a geometry_msgs/WrenchStamped."""
    torque = message.wrench.torque
    return torque.x, torque.y, torque.z


def _numbers(
    estimate: SlipEstimate | ShapeEstimate, vector_axes: tuple[int, int]
) -> tuple[float, ...]:
    """Stamp and fields of an estimate one after the other; a vector (2,) of it is one (3,) of the
    message, along these axes."""
    found: list[float] = [*divmod(estimate.stamp_ns, NANOSECONDS)]
    first, second = vector_axes
    values: tuple[Any, ...] = estimate[1:]
    for value in values:
        if isinstance(value, tuple):
            vector = [0.0, 0.0, 0.0]
            vector[first], vector[second] = value
            found += vector
        else:
            found.append(value)
    return tuple(found)
