# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said where areas and force do not show the same contacts."""

from __future__ import annotations

import pytest

from finger_model.area_watch import AreaWatch

T0, MS = 1_700_000_000_000_000_000, 1_000_000


def pressed(ms: int) -> bool:
    """Whether a finger presses: 1.5 s of every 3 s."""
    return 1000 <= ms % 3000 < 2500


def watched(
    seconds: int,
    lag: int = 0,
    gain: float = 1.0,
    shrink: int = 0,
    residue: float = 0.0,
    begin: int = 0,
    watch: AreaWatch | None = None,
) -> tuple[AreaWatch, dict[str, str]]:
    """A watch that has seen presses of 1 N at 500 Hz with areas of 50 mm² at 10 Hz, and what it
    says.

    lag: ms by which areas come later; gain: of the force; shrink: ms that areas are shorter at
    either end; residue: area (m²) where no finger is.
    """
    watch = watch or AreaWatch()
    said: dict[str, str] = {}
    for ms in range(1000 * begin, 1000 * (begin + seconds), 2):
        force = gain if pressed(ms) else 0.0
        watch.see_force(T0 + ms * MS, force, force >= 0.05)
        if ms % 100 == 40:
            seen = all(pressed(ms - lag + d) for d in (-shrink, shrink))
            watch.see_area(T0 + ms * MS, 50e-6 if seen else residue)
        if ms % 1000 == 0:
            said = {key: text for key, text in watch.look().items() if text}
    return watch, said


@pytest.mark.parametrize(("lag", "words"), [(500, "0.5 s later"), (-400, "0.4 s earlier")])
def test_areas_that_come_late_by_their_stamps_are_told_until_they_do_not(
    lag: int, words: str
) -> None:
    watch, said = watched(6, lag)
    assert not said, "after one contact"
    watch, said = watched(12, lag, begin=6, watch=watch)
    assert f"shows contacts {words} than the force" in said.pop("area_lag")
    assert not said
    _, said = watched(12, begin=18, watch=watch)
    assert not said


@pytest.mark.parametrize("shrink", [-300, 0, 300])
def test_contacts_that_are_seen_for_longer_or_shorter_are_no_lag(shrink: int) -> None:
    for lag in (0, 100):
        assert not watched(18, lag, shrink=shrink)[1]


def test_contacts_that_the_force_does_not_show_are_told_until_it_does() -> None:
    """As of a force in kN, a cable that is off, or another sensor's topic."""
    watch, said = watched(3, gain=0.001)
    assert not said
    watch, said = watched(3, gain=0.001, begin=3, watch=watch)
    told = said["area_alone"]
    assert told.startswith(
        "contact_area has shown a contact for 3 s, of 50 mm², and the force none"
    )
    assert "(0.001 N now)" in told and "unit (N)" in told
    _, said = watched(3, begin=6, watch=watch)
    assert not said


def test_a_contact_without_force_is_forgotten_after_a_minute() -> None:
    watch, _ = watched(6, gain=0.001)
    for second in range(6, 70):
        watch.see_force(T0 + 1000 * second * MS, 0.0, False)
        watch.see_area(T0 + 1000 * second * MS, 0.0)
    assert not any(watch.look().values())


def test_a_finger_that_rests_lightly_and_a_silent_force_are_not_told() -> None:
    light, silent = AreaWatch(), AreaWatch()
    light.see_force(T0, 0.04, False)
    silent.see_force(T0, 0.0, False)
    for n in range(1, 100):
        light.see_force(T0 + 100 * n * MS, 0.04, False)
        light.see_area(T0 + 100 * n * MS, 12e-6)
        silent.see_area(T0 + 100 * n * MS, 50e-6)
        assert not any(light.look().values())
    assert not any(silent.look().values())


def test_a_jump_of_time_begins_anew() -> None:
    watch, _ = watched(12, 500)
    watch.see_force(T0 - 10**12, 0.0, False)
    assert not any(watch.look().values())
