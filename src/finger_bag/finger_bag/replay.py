"""Replay without ROS: messages of a bag at their original spacing, as a plain iterator.

    for item in Replay(reader, rate=2.0):
        print(item.message.topic, item.lateness)

Spacing is that of the log time. Between two messages the iterator sleeps; it never skips one: when the reader of the
iterator is slow, messages come late, and `lateness` says by how much.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field

import numpy as np

from finger_common.errors import InputError

from .reader import BagMessage, BagReader


@dataclass(frozen=True)
class Played:
    """One message that is due now. bag_time_ns: log time, continued over loops. lateness: s behind its time."""

    message: BagMessage
    bag_time_ns: int
    lateness: float
    loop: int


@dataclass
class TimingError:
    """How late messages came (s)."""

    _late: list[float] = field(default_factory=list)

    def add(self, lateness: float) -> None:
        if len(self._late) < 5_000_000:
            self._late.append(lateness)

    def summary(self) -> dict[str, float]:
        """Number of messages; median, 99th percentile and maximum of the lateness in ms."""
        late = np.array(self._late) * 1e3
        if not len(late):
            return {"messages": 0}
        return {
            "messages": len(late),
            "p50_ms": float(np.median(late)),
            "p99_ms": float(np.percentile(late, 99)),
            "max_ms": float(late.max()),
        }


class Replay:
    """Iterator over the messages of a bag, each given when it is due.

    topics: absolute names, None for all. rate: 2.0 is twice as fast. offset: s after the begin of the bag to start at.
    duration: s of the bag to play, None for all. loop: begin again at the end. `pause`, `step`, `stop` may be called
    from other threads. on_time is called with the bag's time (ns) at least every `tick` seconds while playing, for a
    clock.
    """

    def __init__(
        self,
        reader: BagReader,
        topics: Collection[str] | None = None,
        rate: float = 1.0,
        offset: float = 0.0,
        duration: float | None = None,
        loop: bool = False,
        on_time: Callable[[int], None] | None = None,
        tick: float = 0.01,
        now: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not rate > 0:
            raise InputError(f"rate is {rate}, a number above 0 is needed")
        if offset < 0 or (duration is not None and not duration > 0):
            raise InputError("start offset and duration must not be negative; correct them")
        self.reader, self.topics, self.rate, self.loop = reader, topics, rate, loop
        self.timing = TimingError()
        self._on_time, self._tick, self._now, self._sleep = on_time, tick, now, sleep
        begin = reader.info.start_ns
        if begin is None:
            raise InputError(f"{reader.path}: bag holds no message; nothing to play")
        self._begin = begin + round(offset * 1e9)
        self._end = None if duration is None else self._begin + round(duration * 1e9)
        self._lock = threading.Condition()
        self._paused = False
        self._steps = 0
        self._stopped = False

    # Control ---------------------------------------------------------------------------------

    def pause(self, paused: bool | None = None) -> bool:
        """Pause or go on (None: the other one); gives whether it is paused now."""
        with self._lock:
            self._paused = not self._paused if paused is None else paused
            self._lock.notify_all()
            return self._paused

    def step(self) -> None:
        """Give one more message while paused."""
        with self._lock:
            self._steps += 1
            self._lock.notify_all()

    def stop(self) -> None:
        """End the iteration."""
        with self._lock:
            self._stopped = True
            self._lock.notify_all()

    # Iteration -------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Played]:
        shift, loop = 0, 0
        while not self._stopped:
            last = count = 0
            origin: tuple[float, int] | None = None
            for message in self.reader.messages(self.topics, self._begin, self._end):
                bag_time = message.log_time_ns + shift
                if origin is None:
                    origin = (self._now(), bag_time)
                    self._announce(bag_time)
                moved = self._wait(origin, bag_time)
                if self._stopped:
                    return
                origin = (origin[0] + moved, origin[1])
                due = origin[0] + (bag_time - origin[1]) * 1e-9 / self.rate
                lateness = max(0.0, self._now() - due)
                self.timing.add(lateness)
                last = bag_time
                count += 1
                yield Played(message, bag_time, lateness, loop)
            if not count:
                raise InputError(
                    f"{self.reader.path}: nothing to play; check topics, start offset and duration"
                )
            if not self.loop:
                return
            # The next round goes on one millisecond later, so that time never runs back.
            shift = last + 1_000_000 - self._begin
            loop += 1

    def _announce(self, bag_time: int) -> None:
        if self._on_time is not None:
            self._on_time(bag_time)

    def _wait(self, origin: tuple[float, int], bag_time: int) -> float:
        """Wait until bag_time is due; gives the seconds that pausing moved everything by."""
        moved = 0.0
        while True:
            with self._lock:
                if self._stopped:
                    return moved
                if self._paused:
                    began = self._now()
                    if self._steps:
                        # A step shows the message now; time stands at it.
                        self._steps -= 1
                        due = origin[0] + moved + (bag_time - origin[1]) * 1e-9 / self.rate
                        self._announce(bag_time)
                        return moved + (began - due)
                    self._lock.wait(0.1)
                    moved += self._now() - began
                    continue
            due = origin[0] + moved + (bag_time - origin[1]) * 1e-9 / self.rate
            left = due - self._now()
            if left <= 0:
                self._announce(bag_time)
                return moved
            if self._on_time is not None:
                self._announce(bag_time - round(left * self.rate * 1e9))
            # The last stretch is short, so that the sleep's own error stays small.
            self._sleep(min(left, self._tick))
