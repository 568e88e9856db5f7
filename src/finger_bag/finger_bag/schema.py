# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a session bag holds: topics, types, quality of service, metadata and attachments.

A bag is a rosbag2 folder (NAME/metadata.yaml, NAME/NAME_0.mcap, …) whose MCAP files follow the
"ros2" profile. All trials of a session may be in one bag, or each trial in its own; `trial`
messages separate them in both cases. A metadata record `finger_session` names subject, condition
and software; calibration files are attachments. docs/bags.md is the page for users.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from finger_common.errors import InputError

SCHEMA_VERSION = "1"
NAMESPACE = "finger"
SESSION_RECORD = "finger_session"
"""MCAP metadata record of the session, and prefix of its keys in metadata.yaml."""

CALIBRATION_ATTACHMENT = "plate_calibration.yaml"
PARAMETERS_ATTACHMENT = "parameters.yaml"


@dataclass(frozen=True)
class TopicSpec:
    """One topic of a session bag; `name` is in the rig's namespace unless it starts with "/"."""

    name: str
    type: str
    rate: float | None
    """Hz, None for messages on events."""
    latched: int = 0
    """Messages kept for those who come later."""
    needed: bool = False
    """Without it, a bag cannot be fitted."""
    meaning: str = ""


TOPICS: dict[str, TopicSpec] = {
    spec.name: spec
    for spec in (
        TopicSpec(
            "wrench",
            "geometry_msgs/msg/WrenchStamped",
            500.0,
            needed=True,
            meaning="force and torque in the sensor's axes, tared (N, N m)",
        ),
        TopicSpec(
            "wrench_raw",
            "geometry_msgs/msg/WrenchStamped",
            500.0,
            meaning="force and torque before the tare (N, N m)",
        ),
        TopicSpec("image_raw", "sensor_msgs/msg/Image", 10.0, meaning="FTIR image, mono8"),
        TopicSpec(
            "image_raw/compressed",
            "sensor_msgs/msg/CompressedImage",
            10.0,
            meaning="the same as lossless PNG, in place of image_raw",
        ),
        TopicSpec("camera_info", "sensor_msgs/msg/CameraInfo", 10.0, meaning="lens calibration"),
        TopicSpec(
            "contact_area",
            "finger_msgs/msg/ContactArea",
            10.0,
            meaning="gross and real contact area (m²)",
        ),
        TopicSpec(
            "indentation",
            "geometry_msgs/msg/PointStamped",
            100.0,
            meaning="measured approach of plate and bone: z (m), positive into the finger; its "
            "zero is not known",
        ),
        TopicSpec(
            "moisture",
            "finger_msgs/msg/Moisture",
            None,
            meaning="readings of the moisture probe (a.u.)",
        ),
        TopicSpec(
            "contact_state",
            "finger_msgs/msg/ContactState",
            500.0,
            meaning="the estimate, one per wrench",
        ),
        TopicSpec(
            "contact_slip",
            "finger_msgs/msg/ContactSlip",
            500.0,
            meaning="stick, slip and friction, one per wrench",
        ),
        TopicSpec(
            "contact_shape",
            "finger_msgs/msg/ContactShape",
            50.0,
            meaning="ellipse, tilt and centre of pressure, where contact_shape is set",
        ),
        TopicSpec(
            "model_events",
            "finger_msgs/msg/ModelEvent",
            None,
            latched=10,
            meaning="settings and resets of the estimator",
        ),
        TopicSpec(
            "trial",
            "finger_msgs/msg/Trial",
            None,
            latched=1,
            meaning="the current trial and its phase",
        ),
        TopicSpec("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 1.0, meaning="health"),
    )
}

IMAGE_TOPICS = ("image_raw", "image_raw/compressed", "contact_image", "contact_image/compressed")
"""Topics that show the print: biometric data."""

MAXIMUM_NAME = 247
"""Characters of a topic name, as ROS allows."""

_NAME = re.compile(r"/?[A-Za-z~_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


def full_name(topic: str, namespace: str = NAMESPACE) -> str:
    """Absolute topic name; "wrench" in namespace "finger" is "/finger/wrench".

    Raises InputError for something that is no ROS name.
    """
    if not _NAME.fullmatch(topic):
        raise InputError(f"'{topic}' is not a topic name; use letters, digits, '_' and '/'")
    if topic.startswith("/"):
        name = topic
    else:
        name = "/" + "/".join(part for part in (namespace.strip("/"), topic) if part)
    if len(name) > MAXIMUM_NAME:
        raise InputError(
            f"topic name '{name[:40]}…' has {len(name)} characters; use {MAXIMUM_NAME} at most"
        )
    return name


def spec_of(topic: str) -> TopicSpec | None:
    """Description of a topic by absolute or relative name, None outside the schema."""
    if topic in TOPICS:
        return TOPICS[topic]
    for name, spec in TOPICS.items():
        if topic.endswith("/" + name.lstrip("/")):
            return spec
    return None


def software_version() -> str:
    """Version of the suite that writes."""
    try:
        return version("finger_bag")
    except PackageNotFoundError:
        return "0 (not installed)"


@dataclass(frozen=True)
class SessionMetadata:
    """Metadata of a session bag; text throughout, empty where not known.

    subject is a code, never a name. condition and trial_index are set where the whole bag belongs
    to one condition or trial; `trial` messages in the bag take precedence.
    """

    session: str = ""
    subject: str = ""
    finger: str = ""
    """That is tested, such as right_index."""
    condition: str = ""
    trial_index: str = ""
    target_force: str = ""
    """N."""
    rig: str = ""
    source: str = ""
    """What made the data: "rig", "simulated rig", "simulated study", or a command."""
    software_version: str = ""
    schema_version: str = SCHEMA_VERSION
    extra: dict[str, str] = field(default_factory=dict)
    """Further keys, kept as they are."""

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> SessionMetadata:
        """From text or numbers under the field names; other keys go to `extra`."""
        names = {f.name for f in fields(cls)} - {"extra"}
        text = {str(k): "" if v is None else str(v) for k, v in values.items()}
        extra = {k: v for k, v in text.items() if k not in names}
        return cls(**{k: v for k, v in text.items() if k in names}, extra=extra)

    def to_mapping(self) -> dict[str, str]:
        """All keys that are set."""
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "extra"}
        return {k: v for k, v in {**named, **self.extra}.items() if v}


def offered_qos(latched: int) -> list[dict[str, Any]]:
    """Quality of service of a topic as rosbag2 stores it for `ros2 bag play`."""

    def forever() -> dict[str, int]:
        return {"sec": 9223372036, "nsec": 854775807}

    return [
        {
            "history": 1,  # keep last
            "depth": latched or 200,
            "reliability": 1,  # reliable: a reader that wants best effort hears it too
            "durability": 1 if latched else 2,  # transient local, volatile
            "deadline": forever(),
            "lifespan": forever(),
            "liveliness": 1,  # automatic
            "liveliness_lease_duration": forever(),
            "avoid_ros_namespace_conventions": False,
        }
    ]
