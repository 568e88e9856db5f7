# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Names of conditions: one rule and one sentence."""

from __future__ import annotations

import pytest

from finger_common.condition_name import (
    SESSION_NAME,
    check_condition_name,
    same_but_for_spelling,
)
from finger_common.errors import InputError


@pytest.mark.parametrize(
    "name", ["", "dry", "very dry", "trocken, 20 % (links)", "x" * 64, "naß", "_x"]
)
def test_names_that_name_files_everywhere(name: str) -> None:
    assert check_condition_name(name, "condition") == name


@pytest.mark.parametrize(
    "name", ["..", "/dry", "dry/left", "-dry", " dry", "dry ", "x ", "x" * 65, "dry\n"]
)
def test_other_names_are_refused_with_the_rule(name: str) -> None:
    with pytest.raises(InputError, match=r"^condition .* is not valid; use letters.*a digit or _$"):
        check_condition_name(name, "condition")


@pytest.mark.parametrize("name", ["dry_pull", "dry-2", "0"])
def test_a_name_of_a_session_is_one_of_a_bag(name: str) -> None:
    assert SESSION_NAME.fullmatch(name)
    assert not SESSION_NAME.fullmatch(f"{name},")


def test_the_first_names_that_differ_in_case_alone() -> None:
    assert same_but_for_spelling(["dry", "Moist", "dry", "moist", "DRY"]) == ("Moist", "moist")
    assert same_but_for_spelling(["dry", "moist", "dry"]) is None


def test_the_first_names_that_differ_in_spaces_alone() -> None:
    assert same_but_for_spelling(["very dry", "dry", "Very  dry"]) == ("very dry", "Very  dry")
    assert same_but_for_spelling(["", "dry", "dry "]) == ("dry", "dry ")
    assert same_but_for_spelling(["very dry", "verydry"]) is None
