"""Between messages and the core's plain data, by attribute access: serves rclpy messages and a bag reader's objects."""

from __future__ import annotations

import json
from typing import Any

from .estimator.estimator import ContactEstimate, EstimatorEvent, EventType

NANOSECONDS = 1_000_000_000


def stamp_of(stamp: Any) -> int:
    """Nanoseconds of a builtin_interfaces/Time."""
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nanoseconds
    return int(stamp.sec) * NANOSECONDS + int(nanoseconds)


def wrench_of(message: Any) -> tuple[int, tuple[float, float, float]]:
    """Arguments of `add_wrench` from a geometry_msgs/WrenchStamped."""
    stamp = message.header.stamp
    force = message.wrench.force
    return stamp.sec * NANOSECONDS + stamp.nanosec, (force.x, force.y, force.z)


def area_of(message: Any) -> tuple[int, float, float, int]:
    """Arguments of `add_area` from a finger_msgs/ContactArea."""
    return (
        stamp_of(message.header.stamp),
        float(message.gross_area),
        float(message.area_stddev),
        int(message.flags),
    )


def moisture_of(message: Any) -> tuple[int, float]:
    """Arguments of `add_moisture` from a finger_msgs/Moisture."""
    return stamp_of(message.header.stamp), float(message.value)


def event_of(message: Any) -> EstimatorEvent:
    """Argument of `apply_event` from a finger_msgs/ModelEvent."""
    late = {}
    try:
        late = json.loads(message.settings).get("late", {})
    except (ValueError, AttributeError):
        pass
    return EstimatorEvent(
        stamp_of(message.header.stamp),
        EventType(int(message.type)),
        str(message.settings),
        str(message.parameter_sets),
        str(message.model_hash),
        str(message.reason),
        tuple(int(s) for s in late.get("areas", ())),
        tuple(int(s) for s in late.get("moistures", ())),
    )


def event_fields(event: EstimatorEvent, sequence: int) -> dict[str, Any]:
    """Fields of a ModelEvent; "header" holds only the stamp as (sec, nanosec)."""
    settings = json.loads(event.settings)
    if event.late_areas or event.late_moistures:
        # Inputs that came too late and were not used: a replay leaves them out too.
        settings["late"] = {
            "areas": list(event.late_areas),
            "moistures": list(event.late_moistures),
        }
    return {
        "stamp": divmod(event.stamp_ns, NANOSECONDS),
        "type": int(event.type),
        "sequence": sequence,
        "settings": json.dumps(settings, sort_keys=True),
        "parameter_sets": event.parameter_sets,
        "model_hash": event.model_hash,
        "reason": event.reason,
    }


def contact_state_fields(estimate: ContactEstimate) -> dict[str, Any]:
    """Fields of a ContactState as a dict; `header` and `onset` are dicts of their own fields."""
    fields = estimate._asdict()
    seconds, nanoseconds = divmod(fields.pop("stamp_ns"), NANOSECONDS)
    onset_seconds, onset_nanoseconds = divmod(fields.pop("onset_ns"), NANOSECONDS)
    fields["header"] = {
        "stamp": {"sec": seconds, "nanosec": nanoseconds},
        "frame_id": "",
    }
    fields["onset"] = {"sec": onset_seconds, "nanosec": onset_nanoseconds}
    return fields


def fill_contact_state(message: Any, estimate: ContactEstimate) -> None:
    """Set the fields of a ContactState message that is used again and again (cheaper than a new one)."""
    (
        message.normal_force,
        message.lateral_force,
        message.model_area,
        message.measured_area,
        message.measured_area_age,
        message.area,
        message.area_stddev,
        message.area_force_slope,
        message.radius,
        message.indentation,
        message.mean_pressure,
        message.peak_pressure,
        message.moisture,
        message.moisture_age,
        stamp,
        message.flags,
        message.in_contact,
        onset,
        message.parameter_set,
    ) = estimate
    header = message.header.stamp
    header.sec, header.nanosec = divmod(stamp, NANOSECONDS)
    message.onset.sec, message.onset.nanosec = divmod(onset, NANOSECONDS)
