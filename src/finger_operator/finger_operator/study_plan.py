# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a session asks for: subject code, conditions in blocks, trials per block, target force.

The defaults are those of Nam and Kuchenbecker, IEEE Trans. Haptics 14(2):303–309, 2021: blocks of
15 trials in the order dry, natural, moist; three moisture readings before and three after; a press
until 1.35 N, then a cue to lift.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from finger_common.condition_name import SESSION_NAME
from finger_common.errors import InputError
from finger_common.guided_presses import CALIBRATION_PRESSES, PRESS_BY_NAME, GuidedPress
from finger_common.guided_pulls import is_pull, press_before_pull, skin_of
from finger_common.settings import Settings, setting
from finger_common.subject_code import FINGERS, HANDS, check_subject
from finger_common.trial_phases import TARGET_FORCE

from .conditions import conditions_problem
from .trial_order import ORDERS, trial_conditions

PREPARATIONS: dict[str, str] = {
    "dry": "Dip the fingerpad in isopropyl alcohol and wait until all of it has evaporated.",
    "natural": "Nothing is done to the finger. No washing, no cream.",
    "moist": "Exercise until the fingers sweat; do not wipe the finger.",
}
"""Preparation of the finger before each trial, by condition, as the paper describes it."""

CLEAN_PLATE = (
    "Clean the plate. Then press perpendicular at its centre, with the finger nearly parallel to "
    "it, until the cue changes to Lift."
)
"""Prompt before each trial."""

CLEAN_PLATE_PULL = (
    "Clean the plate. Then press at its centre until the cue changes to Pull, and pull sideways "
    "until it changes to Lift."
)
"""Prompt before each pull."""

REQUIRED = ("subject", "session", "conditions", "trials", "readings", "target_force")
"""What the plan in a state file must name; older files lack the rest."""


@dataclass(frozen=True)
class PlanSettings(Settings):
    """The plan of the next session, parameters of the protocol node."""

    subject: str = setting(
        "",
        "Subject code with a digit in it, such as S01; never a name. Needed before a session "
        "starts.",
        runtime=True,
    )
    session: str = setting(
        "", "Id of the session; empty: made from subject, date and time.", runtime=True
    )
    conditions: list = setting(
        ["dry", "natural", "moist"],
        "Blocks of the session, in this order. With '_pull' behind its name, such as natural_pull, "
        "the trials of a block are pulls until the finger slips.",
        runtime=True,
    )
    trials: int = setting(
        15, "Trials per condition (the paper: 15).", minimum=1, maximum=1000, runtime=True
    )
    readings: int = setting(
        3,
        "Moisture readings before and after each press (the paper: 3); 0 for a rig without probe.",
        minimum=0,
        maximum=20,
        runtime=True,
    )
    target_force: float = setting(
        TARGET_FORCE,
        "Normal force at which the cue to lift is given (the paper: 1.35 N).",
        "N",
        0.06,
        50.0,
        runtime=True,
    )
    age: int = setting(0, "Age of the subject; 0: not noted.", "years", 0, 120, runtime=True)
    hand: str = setting("", "Hand that is tested.", choices=("", *HANDS), runtime=True)
    finger: str = setting("", "Finger that is tested.", choices=("", *FINGERS), runtime=True)
    finger_width: float = setting(
        0.0, "Width of the fingertip, by calipers; 0: not measured.", "m", 0.0, 0.04, runtime=True
    )
    finger_depth: float = setting(
        0.0,
        "Depth of the fingertip from nail to pad, by calipers; 0: not measured.",
        "m",
        0.0,
        0.04,
        runtime=True,
    )
    order: str = setting(
        "as_given",
        "Order of the trials: blocks as given, blocks shuffled, blocks counterbalanced over the "
        "subjects (by the last number in the subject code that follows a letter), or all trials "
        "shuffled.",
        choices=ORDERS,
        runtime=True,
    )
    order_seed: int = setting(
        0, "Seed of the order, with the subject code.", minimum=0, maximum=999999, runtime=True
    )

    def trial_conditions(self) -> list[str]:
        """Condition of each trial, in order."""
        return trial_conditions(
            self.conditions, self.trials, self.order, self.order_seed, self.subject
        )


@dataclass(frozen=True)
class StudyPlan(PlanSettings):
    """The plan of one session. preparations: text by condition."""

    preparations: Mapping[str, str] = field(default_factory=lambda: dict(PREPARATIONS))

    def validate(self) -> None:
        check_subject(self.subject)
        if not SESSION_NAME.fullmatch(self.session):
            raise InputError(
                f"session '{self.session}' cannot be a folder's name; use letters, digits, - and _"
            )
        if problem := conditions_problem(self.conditions):
            raise InputError(problem)

    @property
    def is_calibration(self) -> bool:
        """Whether the trials are the guided presses of a calibration."""
        return all(name in PRESS_BY_NAME for name in self.conditions)

    def press_of(self, condition: str) -> GuidedPress:
        """The press that a trial asks for: of a calibration, before a pull, or to the target at a
        free speed."""
        found = PRESS_BY_NAME.get(condition)
        if is_pull(condition):
            found = press_before_pull(condition)
        return found or GuidedPress(condition, self.target_force, 0.0, (0.0, math.inf), "")

    def for_calibration(self, session: str, probe: bool = True) -> StudyPlan:
        """The same subject's calibration, with one moisture reading where any are taken.

        probe: whether there is one to take them with.
        """
        values = {
            **PlanSettings.to_dict(self),
            "session": session,
            "conditions": [press.name for press in CALIBRATION_PRESSES],
            "trials": 1,
            "readings": min(self.readings, int(probe)),
            "order": "as_given",
        }
        return StudyPlan(**values, preparations=self.preparations)

    def preparation(self, condition: str) -> str:
        """Preparation text of a condition."""
        return preparation_of(condition, self.preparations)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for the state file."""
        return {**super().to_dict(), "preparations": dict(self.preparations)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> StudyPlan:
        """Plan from plain data; raises InputError naming what is missing."""
        try:
            given = [p.name for p in cls.parameters() if p.name in data or p.name in REQUIRED]
            values = {name: data[name] for name in given}
            return cls(**values, preparations=dict(data["preparations"]))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"the plan in the state file is incomplete ({error})") from None


def preparation_of(condition: str, texts: Mapping[str, str]) -> str:
    """Preparation text of a condition, by those given; the press of a calibration says itself what
    is done."""
    if condition in PRESS_BY_NAME:
        return PRESS_BY_NAME[condition].text
    for name in (condition, skin_of(condition)):
        if name in texts:
            return texts[name]
    return "Prepare the finger as in your protocol."


def parse_preparations(lines: list[str]) -> dict[str, str]:
    """Texts by condition from "condition: text" lines over the defaults.

    Raises InputError for a line of another form.
    """
    return {**PREPARATIONS, **dict(parse_preparation(line) for line in lines if line.strip())}


def parse_preparation(line: str) -> tuple[str, str]:
    """Condition and text of a line "condition: text"; raises InputError for one of another form."""
    name, colon, text = line.partition(":")
    if not colon or not SESSION_NAME.fullmatch(name.strip()) or not text.strip():
        raise InputError(f"preparation '{line[:40]}' is not 'condition: text'; add the condition")
    return name.strip(), text.strip()[:2000]
