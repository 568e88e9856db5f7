# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said of wrenches with wrong stamps, of several sensors, and of another normal axis."""

from __future__ import annotations

import math

from finger_model.wrench_watch import WrenchWatch

T0, MS = 1_700_000_000_000_000_000, 1_000_000


class Watched:
    """A watch with a clock that goes a second from look to look."""

    def __init__(self) -> None:
        self.now = 0.0
        self.watch = WrenchWatch(lambda: self.now)

    def look(self) -> dict[str, str]:
        self.now += 1.0
        return {key: said for key, said in self.watch.look("-z").items() if said}


def test_samples_that_are_left_out_for_their_stamps_are_told() -> None:
    watched = Watched()
    assert not watched.look()
    for n in range(500):
        watched.watch.add(0, "sensor", n > 0)
    said = watched.look()["wrench_stamps"]
    assert said.startswith("500 wrench messages a second arrive, all stamped 0, and are left out")
    for _ in range(500):
        watched.watch.add(T0, "sensor", True)
    assert "all stamped alike" in watched.look()["wrench_stamps"]
    for n in range(500):
        watched.watch.add(T0 - n * MS, "sensor", n % 2 == 0)
    assert "50% are stamped no later than the one before" in watched.look()["wrench_stamps"]
    for n in range(500):  # a few, as where a datagram overtook another
        watched.watch.add(T0 + n * MS, "sensor", n % 50 == 0)
    assert not watched.look()


def test_another_frame_is_told_once_and_two_of_them_always() -> None:
    watched = Watched()
    watched.watch.add(T0, "one", False)
    assert not watched.look()
    watched.watch.add(T0 + MS, "other", False)
    assert "in the frames 'one' and 'other'" in watched.look()["wrench_frames"]
    watched.watch.add(T0 + 2 * MS, "other", False)
    assert not watched.look()
    for _ in range(2):
        for n, frame in enumerate(("one", "other")):
            watched.watch.add(T0 + n * MS, frame, False)
        assert "wrench_frames" in watched.look()


def test_of_many_frames_the_first_are_named_shortened() -> None:
    watched = Watched()
    for n in range(500):
        watched.watch.add(T0 + n * MS, f"frame_{n}" + "x" * 200, False)
    said = watched.look()["wrench_frames"]
    assert "'frame_0xxx" in said and "'frame_2xxx" in said and "frame_3" not in said
    assert "…' and 497 more: let one sensor publish the topic" in said and len(said) < 250


def test_a_force_across_the_normal_axis_is_told_when_it_lasts() -> None:
    watched = Watched()
    for n in range(1500):
        watched.watch.see(T0 + n * MS, 0.01, 1.0)
    assert not watched.look()
    for n in range(1500, 2500):
        watched.watch.see(T0 + n * MS, 0.01, 1.0)
    said = watched.look()["normal_axis"]
    assert said.startswith("a force of 1.00 N lies across normal_axis (-z), 0.01 N along it")
    watched.watch.see(T0 + 2500 * MS, 0.5, 1.0)  # the friction of a finger
    assert not watched.look()
    for n in range(5000):
        watched.watch.see(T0 + n * MS, 0.01, 0.3)
    assert not watched.look()


def presses(
    watched: Watched, number: int, force: tuple[float, float], offset: float = 0.0, at: float = 0.0
) -> None:
    """Half-sines of 1 s every 2 s from a time (s); force: N along and across the axis at the peak,
    offset: N along it at rest."""
    for n in range(2000 * number):
        shape = max(math.sin(math.pi * n / 1000), 0.0)
        along, across = offset + force[0] * shape, force[1] * shape
        watched.watch.see(T0 + round(at * 1000 + n) * MS, along, across)


def test_short_presses_across_the_normal_axis_are_told_until_one_along_it() -> None:
    watched = Watched()
    presses(watched, 2, (0.02, 1.0))
    assert not watched.look()
    presses(watched, 2, (0.02, 1.0), at=4.0)
    assert "lies across normal_axis" in watched.look()["normal_axis"]
    presses(watched, 1, (0.5, 0.1), at=8.0)
    assert not watched.look()


def test_a_normal_axis_of_opposite_sign_is_told_after_a_few_presses() -> None:
    watched = Watched()
    presses(watched, 2, (-1.0, 0.2))
    assert not watched.look()
    presses(watched, 1, (-1.0, 0.2), at=4.0)
    said = watched.look()["normal_axis"]
    assert said.startswith("the normal force went below zero 3 times, to -1.00 N")
    assert "has normal_axis (-z) the opposite sign? Set it to +z" in said
    assert watched.look()
    watched.watch.forget()  # it was set
    assert not watched.look()
    presses(watched, 3, (-1.0, 0.2), at=6.0)
    assert watched.look()
    presses(watched, 1, (0.5, 0.1), at=12.0)
    assert not watched.look()


def test_presses_of_opposite_sign_are_told_though_the_plate_sticks() -> None:
    watched = Watched()
    for n in range(3):
        presses(watched, 1, (-1.0, 0.2), at=3.0 * n)
        for k in range(50):
            watched.watch.see(T0 + (3000 * n + 2000 + k) * MS, 0.1, 0.0)
    assert "opposite sign" in watched.look()["normal_axis"]


def test_an_untared_sensor_and_pulls_are_not_taken_for_the_opposite_sign() -> None:
    untared = Watched()
    presses(untared, 20, (0.0, 0.0), offset=-0.7)
    assert not untared.look()
    presses(untared, 20, (0.5, 0.1), offset=-0.7, at=40.0)
    assert not untared.look()

    sticking = Watched()  # each press ends with a pull
    for n in range(20):
        presses(sticking, 1, (0.5, 0.1), at=4.0 * n)
        presses(sticking, 1, (-0.8, 0.1), at=4.0 * n + 2.0)
        assert not sticking.look()

    pulled = Watched()  # for long, or seldom
    presses(pulled, 2, (-2.0, 0.1))
    for n in range(5000):
        pulled.watch.see(T0 + (4000 + n) * MS, 0.0, 0.0)
    assert not pulled.look()
    for n in range(70):
        pulled.watch.see(T0 + (9 + n) * 1000 * MS, 0.0, 0.0)
    presses(pulled, 2, (-2.0, 0.1), at=80.0)
    assert not pulled.look()
