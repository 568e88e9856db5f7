# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Replay without ROS: messages of a bag at their original spacing, as a plain iterator.

    for item in replay(reader, ReplaySettings(rate=2.0)):
        print(item.message.topic, item.lateness)

Spacing is that of the log time. Between two messages the iterator sleeps. It never skips one: for a
slow consumer messages come late, and `lateness` is the delay.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue

import numpy as np

from finger_common.errors import InputError
from finger_common.settings import Settings, setting
from finger_common.stamps import nanoseconds, seconds

from .reader import BagMessage, BagReader

LOOP_GAP_NS = 1_000_000
"""Time between the last message of one round and the first of the next."""


LONGEST = 1e9
"""s above which no time of a replay is (32 years)."""


@dataclass(frozen=True)
class ReplaySettings(Settings):
    """What of a bag is replayed, and how fast."""

    rate: float = setting(1.0, "Speed; 2 is twice as fast.", minimum=1e-3, maximum=1e6)
    start: float = setting(
        0.0, "Start this long after the beginning of the bag.", "s", minimum=0.0, maximum=LONGEST
    )
    duration: float = setting(
        0.0, "Length of the part to play; 0: to the end.", "s", minimum=0.0, maximum=LONGEST
    )
    loop: bool = setting(False, "Begin again at the end.")


@dataclass(frozen=True)
class PlaySettings(ReplaySettings):
    """How it is published, too."""

    clock: bool = setting(False, "Publish the bag's time on /clock.")
    wait: float = setting(
        1.0, "Pause for subscribers to connect.", "s", minimum=0.0, maximum=LONGEST
    )
    reliability: str = setting(
        "reliable",
        "QoS reliability of streams; every reader hears reliable ones.",
        choices=("reliable", "best_effort"),
    )


class Pause:
    """Holds a replay that is under way; thread-safe."""

    def __init__(self) -> None:
        self.on = False
        """Whether no message is given."""
        self._steps: SimpleQueue[None] = SimpleQueue()

    def toggle(self) -> None:
        """Pause, or go on as if no time had passed."""
        self.on = not self.on

    def hold(self) -> None:
        """Pause."""
        self.on = True

    def resume(self) -> None:
        """Go on as if no time had passed."""
        self.on = False

    def step(self) -> None:
        """Give the next message, and none after it."""
        self.on = True
        self._steps.put(None)

    def take_step(self) -> bool:
        """Whether a message was asked for that was not given yet."""
        with suppress(Empty):
            self._steps.get_nowait()
            return True
        return False


@dataclass(frozen=True)
class Played:
    """One message that is due now.

    bag_time_ns: log time, continued over loops. lateness: s behind its time.
    """

    message: BagMessage
    bag_time_ns: int
    lateness: float


def replay(
    reader: BagReader,
    settings: ReplaySettings | None = None,
    topics: Collection[str] | None = None,
    on_time: Callable[[int], None] = lambda bag_time_ns: None,
    tick: float = 0.05,
    pause: Pause | None = None,
    now: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Played]:
    """Messages of a bag, each when it is due.

    topics: absolute names, None for all. on_time is called with the bag's time (ns) for each
    message and at least every `tick` seconds, for a clock. pause: stops the bag's time. Raises
    InputError when there is nothing to play.
    """
    settings, pause = settings or ReplaySettings(), pause or Pause()
    begin = reader.info.start_ns
    if begin is None:
        raise InputError(f"{reader.path}: bag holds no message; nothing to play")
    first = begin + nanoseconds(settings.start)
    end = first + nanoseconds(settings.duration) if settings.duration else None
    shift = 0
    while True:
        last = None
        for message in reader.messages(topics, first, end):
            bag_time = message.log_time_ns + shift
            if last is None:
                origin, origin_time = now(), bag_time
            due = origin + seconds(bag_time - origin_time) / settings.rate
            while pause.on or due > now():
                before, paused = now(), pause.on
                step = paused and pause.take_step()
                left = 0.0 if step else max(due - before, 0.0)
                if not step:
                    on_time(bag_time - nanoseconds(left * settings.rate))
                    sleep(tick if paused else min(left, tick))
                if paused:  # the bag's time stood still, or went to the message
                    shifted = now() + left - due
                    origin, due = origin + shifted, due + shifted
                if step:
                    break
            on_time(bag_time)
            last = bag_time
            yield Played(message, bag_time, max(0.0, now() - due))
        if last is None:
            raise InputError(
                f"{reader.path}: nothing to play; check topics, start offset and duration"
            )
        if not settings.loop:
            return
        # The next round begins a little later, so that time never runs back.
        shift = last + LOOP_GAP_NS - first


def lateness_text(lateness: Collection[float]) -> str:
    """Number of messages with median, 99th percentile and maximum of how late (s) they came."""
    if not lateness:
        return "nothing was played"
    late = np.fromiter(lateness, float) * 1e3
    return (
        f"{len(late)} messages; late by {np.median(late):.2f} ms (median), "
        f"{np.percentile(late, 99):.2f} ms (99th percentile), {late.max():.2f} ms (worst)"
    )
