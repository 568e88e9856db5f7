# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Changes of the estimator beside its inputs; recorded, so that a replay makes them too."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from finger_common.errors import InputError
from finger_common.files import parse_json

from .settings import EstimatorSettings

TIME_JUMP = "time jumped back"
"""Reason of the reset that a jump of the clock caused."""

ANOTHER_SUBJECT = "another subject: "
"""Beginning of the reason of the reset at another subject, whose moisture is not known yet."""


NO_FORCE = "no force came: no area from the first to the second stamp was used"
"""Reason of the event that records a pause of the force, however many areas came in it."""


class EventType(IntEnum):
    """Kinds of event, numbered as in ModelEvent."""

    START = 0
    RESET = 1
    PARAMETERS = 2
    SETTINGS = 3
    SURFACE = 4


@dataclass(frozen=True)
class EstimatorEvent:
    """A change of the estimator, as published on `model_events`.

    stamp_ns: takes effect before the first wrench sample stamped like this or later.
    settings, parameter_sets: JSON and YAML text in force after the event.
    late_areas, late_moistures: stamps of inputs that had arrived too late and were not used; of a
    pause, the first and the last one.
    """

    stamp_ns: int
    type: EventType
    settings: str
    parameter_sets: str
    model_hash: str = ""
    reason: str = ""
    late_areas: tuple[int, ...] = ()
    late_moistures: tuple[int, ...] = ()

    @property
    def is_time_jump(self) -> bool:
        """Whether it records that time jumped back."""
        return self.type == EventType.RESET and self.reason == TIME_JUMP

    @property
    def is_pause(self) -> bool:
        """Whether it records that no force came for a while."""
        return self.reason == NO_FORCE and len(self.late_areas) == 2

    @property
    def is_another_subject(self) -> bool:
        """Whether it records that the finger is another subject's."""
        forgets = self.type in (EventType.RESET, EventType.START)
        return forgets and self.reason.startswith(ANOTHER_SUBJECT)

    def estimator_settings(self) -> EstimatorSettings:
        """Settings in force after the event; raises InputError for text that is no JSON object."""
        try:
            values = parse_json(self.settings, "settings")
        except InputError:
            values = None
        if not isinstance(values, dict):
            raise InputError("estimator settings are not a JSON object; record the bag again")
        return EstimatorSettings.select(values)
