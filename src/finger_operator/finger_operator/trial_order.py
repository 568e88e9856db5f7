# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The order of the trials: blocks as given, shuffled or counterbalanced, or all trials shuffled.

Counterbalanced blocks follow Williams, Aust. J. Sci. Res. A 2(2):149–168, 1949: over the subjects
each condition stands equally often at each place and after each other condition.
"""

from __future__ import annotations

import random
import re
from collections.abc import Mapping, Sequence
from typing import Any

from finger_common.subject_code import is_subject

from .conditions import conditions_problem

ORDERS = ("as_given", "shuffled_blocks", "counterbalanced", "shuffled_trials")


def williams_rows(number: int) -> list[list[int]]:
    """Orders of the treatments 0 … number − 1: `number` rows, twice as many when it is odd."""
    zigzag = [(i + 1) // 2 if i % 2 else -i // 2 for i in range(number)]
    rows = [[(z + shift) % number for z in zigzag] for shift in range(number)]
    return rows if number % 2 == 0 else rows + [row[::-1] for row in rows]


def subject_number(subject: str) -> int:
    """The last number in a subject code that follows a letter, else the last one; 1 without.

    Numbers of year, study or group come first (`2026_S07`), those of a visit behind another
    separator (`S07_2`).
    """
    numbers = re.findall(r"[^\W\d_](\d+)", subject) or re.findall(r"\d+", subject)
    return int(numbers[-1]) if numbers else 1


def trial_conditions(
    conditions: Sequence[str], trials: int, order: str, seed: int, subject: str
) -> list[str]:
    """Condition of each trial of a session, `trials` of each.

    order: one of ORDERS. seed, subject: the same pair gives the same order; for counterbalanced
    blocks `subject_number` plus the seed chooses the row.
    """
    blocks = list(conditions)
    shuffled = random.Random(f"{seed} {subject}")
    if order == "shuffled_blocks":
        shuffled.shuffle(blocks)
    elif order == "counterbalanced":
        rows = williams_rows(len(blocks))
        blocks = [blocks[i] for i in rows[(subject_number(subject) - 1 + seed) % len(rows)]]
    result = [condition for condition in blocks for _ in range(trials)]
    if order == "shuffled_trials":
        shuffled.shuffle(result)
    return result


def order_text(given: Mapping[str, Any]) -> str:
    """What `subject`, `conditions`, `order` and `order_seed` come to, for the operator; empty for a
    subject that is no code yet, and for conditions that cannot be run."""
    order, subject = given["order"], given["subject"]
    if not is_subject(subject) or conditions_problem(given["conditions"]):
        return ""
    if order == "shuffled_trials":
        return "All trials in random order."
    blocks = ", ".join(
        trial_conditions(given["conditions"], 1, order, given["order_seed"], subject)
    )
    by = f", by the number {subject_number(subject)}" if order == "counterbalanced" else ""
    return f"Blocks: {blocks}{by}."
