# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said of wrenches with wrong stamps, of several sensors, and of another normal axis."""

from __future__ import annotations

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
