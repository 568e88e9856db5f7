# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How a bag of another system is read: other topic names, units, fields and axes, from a YAML file.

    topics:
      wrench: {topic: /ft_sensor/wrench, unit: N}
      contact_area: {topic: /camera/area, field: area, unit: mm2, stamp: log_time}
      moisture: {topic: /skin/moisture, field: data, stamp: log_time}
      indentation: {topic: /laser/distance, field: range, unit: mm, sign: negative}
      image_raw: {topic: /camera/image_mono}
    normal_axis: "+z"
    trial: {subject: S01, condition: natural, target_force: 1.35}

docs/bags.md, "Preparing your data", explains each key.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from finger_common.axes import NORMAL_AXES
from finger_common.errors import InputError
from finger_common.files import load_yaml
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS

MAPPED_TOPICS = (
    "wrench",
    "contact_area",
    "moisture",
    "indentation",
    "image_raw",
    "image_raw/compressed",
    "trial",
    "model_events",
    "contact_state",
)
_OWN_STAMP = ("trial", "model_events", "contact_state")
"""Messages of the suite, whose stamps mean something."""
_UNITS: dict[str, dict[str, float]] = {
    "wrench": FORCE_UNITS,
    "contact_area": AREA_UNITS,
    "moisture": {"a.u.": 1.0},
    "indentation": LENGTH_UNITS,
}
TRIAL_KEYS = ("session", "subject", "condition", "trial_index", "target_force", "rig", "source")
"""Of `trial`, as in `SessionMetadata`."""
_KEYS = {"topic", "unit", "field", "stamp", "sign"}
_SIGNS = {"positive": 1.0, "negative": -1.0}


@dataclass(frozen=True)
class MappedTopic:
    """Where a stream of the schema is found in another bag.

    field: dotted name of the value in the message, empty for the schema's own. scale: SI per unit
    of the bag, below 0 for an indentation of the other sign. log_time: take the recorder's time,
    for messages without a header.
    """

    topic: str = ""
    scale: float = 1.0
    field: str = ""
    log_time: bool = False


@dataclass(frozen=True)
class TopicMapping:
    """A mapping file, checked. `trial` holds text for keys of SessionMetadata."""

    topics: Mapping[str, MappedTopic] = field(default_factory=dict)
    normal_axis: str | None = None
    trial: Mapping[str, str] = field(default_factory=dict)

    def topic(self, name: str) -> MappedTopic:
        """Entry of a stream, an empty one when the file does not name it."""
        return self.topics.get(name, MappedTopic())

    @classmethod
    def load(cls, path: str | Path) -> TopicMapping:
        """From a YAML file; raises InputError naming file, key and what is allowed."""
        return cls.from_mapping(load_yaml(path, "mapping file"), str(path))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], where: str = "mapping") -> TopicMapping:
        """From plain data; raises InputError."""
        for key in data:
            if key not in ("topics", "normal_axis", "trial"):
                raise InputError(
                    f"{where}: key '{key}' is not known; use topics, normal_axis and trial"
                )
        axis = data.get("normal_axis")
        if axis is not None and axis not in NORMAL_AXES:
            allowed = ", ".join(NORMAL_AXES)
            raise InputError(f"{where}: normal_axis is {axis!r}, choose one of {allowed}")
        topics = data.get("topics") or {}
        trial = data.get("trial") or {}
        if not isinstance(topics, Mapping) or not isinstance(trial, Mapping):
            raise InputError(f"{where}: 'topics' and 'trial' hold 'key: value' lines; correct them")
        text = {str(k): str(v) for k, v in trial.items()}
        for key in text:
            if key not in TRIAL_KEYS:
                raise InputError(f"{where}: trial.{key} is not known; use {', '.join(TRIAL_KEYS)}")
        for key, least in (("target_force", 0.0), ("trial_index", -1.0)):
            if key in text and not _is_number(text[key], least):
                raise InputError(
                    f"{where}: trial.{key} is '{text[key]}'; give a number without a unit, as in "
                    f"{'1.35' if key == 'target_force' else '3'}"
                )
        entries = {str(name): _entry(str(name), v, where) for name, v in topics.items()}
        return cls(entries, axis, text)


def _is_number(text: str, above: float) -> bool:
    try:
        value = float(text)
    except ValueError:
        return False
    return above < value < math.inf


def _entry(name: str, value: Any, where: str) -> MappedTopic:
    if name not in MAPPED_TOPICS:
        raise InputError(
            f"{where}: topic '{name}' cannot be mapped; known are {', '.join(MAPPED_TOPICS)}"
        )
    if isinstance(value, str):
        value = {"topic": value}
    if not isinstance(value, Mapping) or not isinstance(value.get("topic", ""), str):
        raise InputError(f"{where}: topics.{name} needs the topic's name in the bag")
    unknown = set(value) - _KEYS
    if unknown:
        raise InputError(
            f"{where}: topics.{name} has the unknown key '{sorted(map(str, unknown))[0]}'; "
            f"use {', '.join(sorted(_KEYS))}"
        )
    unit = value.get("unit")
    allowed = _UNITS.get(name, {})
    if unit is not None and not (isinstance(unit, str) and unit in allowed):
        raise InputError(
            f"{where}: topics.{name}.unit is {unit!r}, choose one of {', '.join(allowed) or 'none'}"
        )
    stamp = value.get("stamp", "header")
    if stamp not in ("header", "log_time"):
        raise InputError(f"{where}: topics.{name}.stamp is {stamp!r}, choose header or log_time")
    if "stamp" in value and name in _OWN_STAMP:
        raise InputError(f"{where}: topics.{name} has the key 'stamp', but needs its own stamps")
    sign = value.get("sign", "positive")
    if sign not in _SIGNS:
        raise InputError(f"{where}: topics.{name}.sign is {sign!r}, choose positive or negative")
    if "sign" in value and name != "indentation":
        raise InputError(f"{where}: topics.{name} has the key 'sign', which is for indentation")
    return MappedTopic(
        value.get("topic", ""),
        _SIGNS[sign] * (allowed[unit] if unit else 1.0),
        str(value.get("field", "")),
        stamp == "log_time",
    )
