# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said of areas and readings that come too late to be used."""

from __future__ import annotations

import pytest

from finger_model.lateness import Lateness


@pytest.mark.parametrize(
    ("lag", "says"),
    [
        (0.5, "0.5 s behind the force and left out: set the clocks of both alike, or raise fusion"),
        (5.0, "5 s behind the force and left out: set the clocks of both alike"),
        (-1.8e9, "57 years ahead of the force and left out: set the clocks of both alike"),
        (1.8e9, "57 years behind the force and left out: set the clocks of both alike"),
    ],
)
def test_most_that_are_late_are_told_with_a_remedy_that_can_help(lag: float, says: str) -> None:
    late = Lateness("contact areas")
    for _ in range(10):
        late.add(True, lag)
    said = late.look()
    assert f"contact areas are stamped {says}" in said
    assert ("fusion_delay" in said) is (lag == 0.5)
    for n in range(10):
        late.add(n < 5, lag)
    assert not late.look()
