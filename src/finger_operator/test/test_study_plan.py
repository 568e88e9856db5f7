# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Plans of a study: the order of its trials, its texts, and what is refused."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from study_rig import Rig

from finger_common.errors import InputError
from finger_common.guided_presses import PRESS_BY_NAME
from finger_operator.conditions import new_conditions
from finger_operator.protocol import Protocol
from finger_operator.status import session_status
from finger_operator.study_plan import PREPARATIONS, StudyPlan, parse_preparations
from finger_operator.trial_order import ORDERS, order_text, trial_conditions


def test_an_edited_preparation_keeps_those_of_other_sessions(rig: Rig) -> None:
    """The page writes all texts that the status has."""
    texts = {"dry": "Wipe.", "greasy": "Oil."}
    plan = StudyPlan("S01", "S01_a", conditions=("dry",), preparations=texts)
    protocol = Protocol(plan, rig.folder / "other", rig.take, rig.limits)
    assert session_status(protocol)["preparations"] == texts


def test_a_calibration_keeps_the_texts_of_the_study(tmp_path: Path) -> None:
    plan = StudyPlan("S01", "S01_a", preparations={"dry": "Wash."}).for_calibration("S01_b")
    assert plan.preparations == {"dry": "Wash."}
    press = plan.conditions[0]
    assert plan.preparation(press) == PRESS_BY_NAME[press].text
    protocol = Protocol(plan, tmp_path, lambda effect: None)
    with pytest.raises(InputError, match="presses are fixed"):
        protocol.set_preparation(press, "Press as you like.")


def test_preparation_texts_can_be_edited_and_survive(rig: Rig) -> None:
    assert session_status(rig.protocol)["preparation"] == PREPARATIONS["dry"]
    rig.protocol.set_preparation("dry", "Talcum powder.")
    assert session_status(rig.protocol)["preparation"] == "Talcum powder."
    again = Protocol.resume_from(rig.folder, lambda e: None, rig.now)
    assert again.plan.preparation("dry") == "Talcum powder."
    with pytest.raises(InputError, match="moist"):
        rig.protocol.set_preparation("moist", "x")
    with pytest.raises(InputError, match="characters"):
        rig.protocol.set_preparation("dry", " ")
    assert parse_preparations(["wet: Dip in water."])["wet"] == "Dip in water."
    with pytest.raises(InputError, match="condition: text"):
        parse_preparations(["no colon"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"subject": "Maria"}, "never a name"),
        ({"subject": "../S1"}, "code"),
        ({"session": "a/b"}, "folder"),
        ({"conditions": ()}, "no condition"),
        ({"conditions": ("dry", "dry")}, "twice"),
        ({"conditions": ("d y",)}, "is not valid in a session"),
        ({"conditions": ("dry; natural",)}, "and _, and commas between conditions"),
        (
            {"conditions": ("natrual", "Natural", "natural")},
            "conditions 'Natural' and 'natural' differ in case or spaces alone; "
            "write one name in one way",
        ),
        ({"trials": 0}, "trials"),
        ({"readings": -1}, "readings"),
        ({"target_force": 0.0}, "target_force"),
    ],
)
def test_plans_that_cannot_be_run_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        StudyPlan(**{"subject": "S01", "session": "a", **change})


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("natrual", "natural"),
        ("Natural", "natural"),
        ("DRY", "dry"),
        ("natrual_pull", "natural_pull"),
        ("gresy", "Greasy"),
        ("cold", ""),
    ],
)
def test_a_new_condition_is_told_with_the_name_that_may_be_meant(name: str, meant: str) -> None:
    known = [*PREPARATIONS, "Greasy_pull"]
    sentence = f"'{name}' is a new condition without a preparation text."
    told = f"{sentence} Write {meant} if that is meant." if meant else sentence
    assert new_conditions(["dry", name, "moist"], known) == told
    assert new_conditions([name, name], known) == f"{told} {told}"
    assert new_conditions([name], [*known, name]) == ""
    assert new_conditions(["dry", "natural_pull", "Greasy", "no name; at all"], known) == ""
    assert new_conditions(["Greasy"], [*known, "greasy"]) == "", "both were used before"


def test_counterbalanced_orders_put_every_condition_equally_often_at_each_place() -> None:
    for number in (2, 3, 4):
        conditions = [f"c{i}" for i in range(number)]
        rows = number if number % 2 == 0 else 2 * number
        orders = [
            trial_conditions(conditions, 1, "counterbalanced", 0, f"S{i + 1:02d}")
            for i in range(rows)
        ]
        places = Counter((place, c) for order in orders for place, c in enumerate(order))
        pairs = Counter(pair for order in orders for pair in pairwise(order))
        assert len(places) == number**2 and len(set(places.values())) == 1
        assert len(pairs) == number * (number - 1) and len(set(pairs.values())) == 1


@pytest.mark.parametrize("code", ["2026_S{:02d}", "E2_P{}", "G1S{:02d}", "S{}", "S{}_1"])
def test_the_last_number_of_a_code_counterbalances(code: str) -> None:
    def of(number: int) -> list[str]:
        return trial_conditions("abc", 1, "counterbalanced", 0, code.format(number))

    assert Counter("".join(of(n)) for n in range(1, 13)) == dict.fromkeys(
        ("abc", "bca", "cab", "bac", "cba", "acb"), 2
    )
    given = {"subject": code.format(2), "conditions": ["a", "b", "c"], "order_seed": 0}
    assert order_text({**given, "order": "counterbalanced"}) == (
        f"Blocks: {', '.join(of(2))}, by the number 2."
    )
    assert order_text({**given, "order": "as_given"}) == "Blocks: a, b, c."
    assert order_text({**given, "order": "as_given", "subject": "Maria"}) == ""
    for wrong in (["a; b"], ["a", "A"], ["a", "a"]):
        assert order_text({**given, "order": "as_given", "conditions": wrong}) == "", wrong


@pytest.mark.parametrize("order", ORDERS)
def test_orders_hold_every_trial_and_follow_from_seed_and_subject(order: str) -> None:
    conditions = ["dry", "natural", "moist"]

    def of(seed: int, subject: str) -> list[str]:
        return trial_conditions(conditions, 5, order, seed, subject)

    assert Counter(of(1, "S01")) == dict.fromkeys(conditions, 5)
    assert of(1, "S01") == of(1, "S01")
    different = {tuple(of(seed, f"S{n:02d}")) for seed in range(5) for n in range(1, 6)}
    assert len(different) == 1 if order == "as_given" else len(different) >= 3
    if order != "shuffled_trials":
        assert all(len(set(of(2, "S03")[i : i + 5])) == 1 for i in (0, 5, 10)), "blocks"
