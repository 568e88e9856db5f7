"""What a study asks for: subject code, conditions in blocks, trials per block, and the limits a trial must keep.

The defaults are those of Nam and Kuchenbecker, IEEE Trans. Haptics 14(2):303–309, 2021: blocks of 15 trials in the
order dry, natural, moist; three moisture readings before and three after; a press until 1.35 N, then a cue to lift.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from finger_common.errors import InputError

PREPARATIONS: dict[str, str] = {
    "dry": "Dip the fingerpad in isopropyl alcohol and wait until all of it has evaporated.",
    "natural": "Nothing is done to the finger. No washing, no cream.",
    "moist": "Exercise until the fingers sweat; do not wipe the finger.",
}
"""Preparation of the finger before each trial, by condition, as the paper describes the experiment."""

CLEAN_PLATE = (
    "Clean the plate. Then press perpendicular at its centre, with the finger nearly parallel to it, "
    "until the cue says to lift."
)
"""Prompt before each trial."""

SUBJECT = re.compile(r"(?=.*\d)[A-Za-z0-9_-]{1,16}")
NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


@dataclass(frozen=True)
class StudyPlan:
    """The study to run.

    subject: a code with a digit in it, so that a name is not typed by habit. conditions: blocks in this order.
    trials: per condition. readings: moisture readings before and after each press. target_force: N.
    """

    subject: str
    session: str
    conditions: tuple[str, ...] = ("dry", "natural", "moist")
    trials: int = 15
    readings: int = 3
    target_force: float = 1.35
    preparations: Mapping[str, str] = field(default_factory=lambda: dict(PREPARATIONS))
    operator_note: str = ""

    def __post_init__(self) -> None:
        if not SUBJECT.fullmatch(self.subject):
            raise InputError(
                f"subject '{self.subject}' is no code; use up to 16 letters, digits, - and _ with at least "
                "one digit, such as S01, and never a name"
            )
        if not NAME.fullmatch(self.session):
            raise InputError(
                f"session '{self.session}' cannot be a folder's name; use letters, digits, - and _"
            )
        if not self.conditions:
            raise InputError("no condition is given; name at least one, such as natural")
        for name in self.conditions:
            if not NAME.fullmatch(name):
                raise InputError(
                    f"condition '{name}' is no plain name; use letters, digits, - and _"
                )
        if len(set(self.conditions)) != len(self.conditions):
            raise InputError("a condition is named twice; give each block once")
        if not 1 <= self.trials <= 1000:
            raise InputError(f"{self.trials} trials per condition; give 1 to 1000")
        if not 0 <= self.readings <= 20:
            raise InputError(f"{self.readings} moisture readings; give 0 to 20")
        if not 0.05 < self.target_force <= 50:
            raise InputError(
                f"target force {self.target_force:g} N; give more than 0.05 and at most 50 N"
            )

    def preparation(self, condition: str) -> str:
        """Preparation text of a condition."""
        return self.preparations.get(condition, "Prepare the finger as your protocol says.")

    def to_dict(self) -> dict[str, Any]:
        """Plain data for the state file."""
        return {
            **asdict(self),
            "conditions": list(self.conditions),
            "preparations": dict(self.preparations),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> StudyPlan:
        """Plan from plain data; raises InputError naming what is missing."""
        known = {f.name for f in fields(cls)}
        try:
            values = {k: v for k, v in data.items() if k in known}
            values["conditions"] = tuple(values["conditions"])
            return cls(**values)
        except (KeyError, TypeError) as error:
            raise InputError(f"the plan in the state file is incomplete ({error})") from None


def parse_preparations(lines: list[str]) -> dict[str, str]:
    """Texts by condition from "condition: text" lines over the defaults; raises InputError for another form."""
    texts = dict(PREPARATIONS)
    for line in lines:
        if not line.strip():
            continue
        name, colon, text = line.partition(":")
        if not colon or not NAME.fullmatch(name.strip()) or not text.strip():
            raise InputError(
                f"preparation '{line[:40]}' is not 'condition: text'; add the condition"
            )
        texts[name.strip()] = text.strip()[:2000]
    return texts
