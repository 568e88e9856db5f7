# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How a bag of another system is read: other topic names, units, fields and axes, from a YAML file.

    topics:
      wrench: {topic: /ft_sensor/wrench, unit: N}
      contact_area: {topic: /camera/area, field: area, unit: mm2, stamp: log_time}
      moisture: {topic: /skin/moisture, field: data, stamp: log_time}
      indentation: {topic: /laser/distance, field: range, unit: mm, sign: negative,
                    time_offset: -0.3}
      image_raw: {topic: /camera/image_mono}
    normal_axis: "+z"
    trial: {subject: S01, condition: natural, target_force: 1.35}

docs/bags.md, "Preparing your data", explains each key.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from finger_common.axes import NORMAL_AXES
from finger_common.errors import InputError
from finger_common.files import load_yaml
from finger_common.stamps import nanoseconds
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS


@dataclass(frozen=True)
class _Rule:
    """What may be said of a topic.

    units: SI value of each. own_stamp: a message of the suite, whose stamp means something. signed:
    whether its values may have the other sign. shifted: whether its clock may differ from the
    force's.
    """

    units: Mapping[str, float] = field(default_factory=dict)
    own_stamp: bool = False
    signed: bool = False
    shifted: bool = False


RULES = {
    "wrench": _Rule(FORCE_UNITS),
    "contact_area": _Rule(AREA_UNITS, shifted=True),
    "moisture": _Rule({"a.u.": 1.0}),
    "indentation": _Rule(LENGTH_UNITS, signed=True, shifted=True),
    "image_raw": _Rule(shifted=True),
    "image_raw/compressed": _Rule(shifted=True),
    "trial": _Rule(own_stamp=True),
    "model_events": _Rule(own_stamp=True),
    "contact_state": _Rule(own_stamp=True),
}
"""The topics that can be mapped."""

TRIAL_KEYS = ("session", "subject", "condition", "trial_index", "target_force", "rig", "source")
"""Of `trial`, as in `SessionMetadata`."""
_NUMBERS = {"target_force": 0.0, "trial_index": -1.0}
"""Those of `trial` that are numbers, which lie above these."""
_KEYS = ("field", "sign", "stamp", "time_offset", "topic", "unit")
LARGEST_OFFSET = 1e9
"""s by which a clock may differ."""

_STAMPS = ("header", "log_time")
_SIGNS = {"positive": 1.0, "negative": -1.0}


@dataclass(frozen=True)
class MappedTopic:
    """Where a stream of the schema is found in another bag.

    field: dotted name of the value in the message, empty for the schema's own. scale: SI per unit
    of the bag, below 0 for an indentation of the other sign. log_time: take the recorder's time,
    for messages without a header. offset_ns: added to the stamps.
    """

    topic: str = ""
    scale: float = 1.0
    field: str = ""
    log_time: bool = False
    offset_ns: int = 0


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
        if axis is not None:
            axis = _chosen(axis, NORMAL_AXES, f"{where}: normal_axis")
        topics = data.get("topics") or {}
        trial = data.get("trial") or {}
        if not isinstance(topics, Mapping) or not isinstance(trial, Mapping):
            raise InputError(f"{where}: 'topics' and 'trial' hold 'key: value' lines; correct them")
        text = {str(k): str(v) for k, v in trial.items()}
        for key, value in trial.items():
            if key not in TRIAL_KEYS:
                raise InputError(f"{where}: trial.{key} is not known; use {', '.join(TRIAL_KEYS)}")
            # YAML reads 010 as the number 8, and "no" as false.
            if key not in _NUMBERS and not isinstance(value, str):
                raise InputError(
                    f"{where}: trial.{key} is read as {value!r}, no text; put it between quotes, "
                    "as in '01'"
                )
        for key, least in _NUMBERS.items():
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


def _chosen(value: Any, allowed: Collection[str], what: str) -> str:
    """A value that is one of the texts allowed; raises InputError, which begins with `what`."""
    if isinstance(value, str) and value in allowed:
        return value
    choice = " or ".join(allowed) if len(allowed) == 2 else f"one of {', '.join(allowed) or 'none'}"
    raise InputError(f"{what} is {value!r}, choose {choice}")


def _entry(name: str, value: Any, where: str) -> MappedTopic:
    rule = RULES.get(name)
    if rule is None:
        raise InputError(f"{where}: topic '{name}' cannot be mapped; known are {', '.join(RULES)}")
    if isinstance(value, str):
        value = {"topic": value}
    where = f"{where}: topics.{name}"
    if not isinstance(value, Mapping) or not isinstance(value.get("topic", ""), str):
        raise InputError(f"{where} needs the topic's name in the bag")
    unknown = sorted(str(key) for key in value if key not in _KEYS)
    if unknown:
        raise InputError(f"{where} has the unknown key '{unknown[0]}'; use {', '.join(_KEYS)}")
    scale = 1.0
    if value.get("unit") is not None:
        scale = rule.units[_chosen(value["unit"], rule.units, f"{where}.unit")]
    stamp = _chosen(value.get("stamp", "header"), _STAMPS, f"{where}.stamp")
    if "stamp" in value and rule.own_stamp:
        raise InputError(f"{where} has the key 'stamp', but needs its own stamps")
    sign = _chosen(value.get("sign", "positive"), _SIGNS, f"{where}.sign")
    if "sign" in value and not rule.signed:
        raise InputError(f"{where} has the key 'sign', which is for indentation")
    offset = value.get("time_offset", 0.0)
    if "time_offset" in value and not rule.shifted:
        raise InputError(f"{where} has the key 'time_offset', which is for areas and indentation")
    known = isinstance(offset, (int, float)) and not isinstance(offset, bool)
    if not known or not abs(offset) <= LARGEST_OFFSET:
        raise InputError(
            f"{where}.time_offset is {offset!r}; give seconds without a unit, as in -0.3"
        )
    return MappedTopic(
        value.get("topic", ""),
        _SIGNS[sign] * scale,
        str(value.get("field", "")),
        stamp == "log_time",
        nanoseconds(float(offset)),
    )
