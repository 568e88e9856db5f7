# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Publishing a bag over the middleware, for `finger-bag play`. Imports rclpy.

rosbag2's own player is not on PyPI, and this one also plays where only the suite is installed. With
`clock`, /clock carries the bag's time, so that nodes with `use_sim_time` run in it. A model node
that listens does not read the recorded events: it runs with its own settings and decides by arrival
which areas and readings are late, so its states can differ from the recorded ones. `finger-bag
process` repeats the recorded states, bit for bit.
"""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import textwrap
import threading
import time
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from finger_common.cli import one_line, plain
from finger_common.errors import InputError, listed
from finger_common.files import parse_yaml
from finger_common.node import begin_ros
from finger_common.stamps import fill_time

from .definitions import type_hash
from .pause_keys import pause_keys
from .reader import BagReader
from .recorder_node import message_class
from .replay import Pause, PlaySettings, replay
from .schema import spec_of

CLOCK_TICK = 0.005
"""s between /clock messages: what a timer of a node in the bag's time may be late."""

TELL_AFTER = 5.0
"""s without a subscriber of an awaited topic after which it is said."""

STREAM_DEPTH, IMAGE_DEPTH = 2000, 50
"""Messages kept for a reader that has fallen behind."""


def qos_of(
    text: str, reliability: str, depth: int = STREAM_DEPTH, latched: bool = False
) -> QoSProfile:
    """Quality of service to play a topic with: latched if it was recorded so or is to be, and
    reliable, which every reader hears, unless `reliability` asks for best effort on streams."""
    profile = QoSProfile(
        depth=depth, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE
    )
    stored: Any = {}
    with contextlib.suppress(InputError, TypeError, LookupError):
        stored = parse_yaml("profiles:\n" + textwrap.indent(text, " "), "QoS")["profiles"][0]
    stored = stored if isinstance(stored, dict) else {}
    # rosbag2 writes numbers up to metadata version 8 and names from 9 on.
    if latched or str(stored.get("durability")).lower() in ("1", "transient_local"):
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    elif reliability == "best_effort":
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    return profile


def play(
    reader: BagReader,
    settings: PlaySettings,
    topics: Sequence[str] | None = None,
    awaited: Sequence[str] = (),
) -> Collection[float]:
    """Publish a bag until its end, Ctrl-C or SIGTERM; gives how late (s) each message was.

    The keys of `pause_keys` and the services of `_served` pause it.

    topics: absolute names, None for all. Topics whose type is not installed are left out with a
    line on standard error. awaited: those of them that must have a subscriber before it begins: on
    a busy machine the middleware takes seconds to connect. Raises InputError when nothing can be
    played, and for an awaited topic that is not.
    """
    begin_ros([])
    on_sigterm = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        node = rclpy.create_node("bag_player")
        publishers = _publishers(node, reader, topics, settings.reliability)
        clock_publisher = node.create_publisher(Clock, "/clock", 10) if settings.clock else None
        message, published = Clock(), 0.0

        def publish_clock(bag_time_ns: int) -> None:
            nonlocal published
            if clock_publisher is not None and time.perf_counter() - published >= 0.9 * CLOCK_TICK:
                published = time.perf_counter()
                fill_time(message.clock, bag_time_ns)
                clock_publisher.publish(message)

        tick = CLOCK_TICK if settings.clock else 0.05
        lateness = array("f")
        _await_subscribers(reader, {name: pair[0] for name, pair in publishers.items()}, awaited)
        time.sleep(settings.wait)
        pause = Pause()
        with contextlib.suppress(KeyboardInterrupt), pause_keys(pause), _served(node, pause):
            for item in replay(reader, settings, list(publishers), publish_clock, tick, pause):
                publisher, expected = publishers[item.message.topic]
                if item.message.type == expected:
                    publisher.publish(item.message.raw)
                lateness.append(item.lateness)
        # Reliable readers fetch what is still on its way.
        for publisher, _ in publishers.values():
            with contextlib.suppress(Exception):
                publisher.wait_for_all_acked(Duration(seconds=2))
        return lateness
    finally:
        signal.signal(signal.SIGTERM, on_sigterm)
        rclpy.try_shutdown()


def _await_subscribers(
    reader: BagReader, publishers: Mapping[str, Any], awaited: Sequence[str]
) -> None:
    """Return when each awaited topic has a subscriber, and say it where none comes."""
    for name in awaited:
        if name not in publishers:
            raise InputError(f"{reader.path}: topic '{plain(name)}' is awaited, but not played")
    told = time.monotonic() + TELL_AFTER
    while unheard := [name for name in awaited if not publishers[name].get_subscription_count()]:
        if time.monotonic() > told:
            told = math.inf
            print(f"finger-bag: nobody listens to {listed(unheard)} yet", file=sys.stderr)
        time.sleep(0.05)


@contextlib.contextmanager
def _served(node: Any, pause: Pause) -> Iterator[None]:
    """Services that pause the replay, named as those of rosbag2's player, while this lasts; their
    message is "paused" or "plays"."""

    def serve(name: str, action: Callable[[], None]) -> None:
        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            action()
            response.success = True
            response.message = "paused" if pause.on else "plays"
            return response

        node.create_service(Trigger, f"~/{name}", answer)

    serve("pause", pause.hold)
    serve("resume", pause.resume)
    serve("toggle_paused", pause.toggle)
    serve("is_paused", lambda: None)
    serve("play_next", pause.step)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.5)

    thread = threading.Thread(target=spin, name="services")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        executor.wake()
        thread.join()
        executor.shutdown()


def _publishers(
    node: Any, reader: BagReader, topics: Sequence[str] | None, reliability: str
) -> dict[str, tuple[Any, str]]:
    found: dict[str, tuple[Any, str]] = {}
    for name, topic in reader.info.topics.items():
        if (topics is not None and name not in topics) or topic.count == 0:
            continue
        try:
            kind = message_class(topic.type)
            if not reader.decoder(name, topic.type).standard and type_hash(topic.type):
                raise InputError(
                    f"its definition of '{topic.type}' differs from the installed one; install the "
                    "version that recorded it, or use 'finger-bag process', which needs no ROS"
                )
        except InputError as error:
            reason = one_line(error)
            print(f"finger-bag: topic '{plain(name)}' is not played: {reason}", file=sys.stderr)
            continue
        depth = IMAGE_DEPTH if "Image" in topic.type else STREAM_DEPTH
        # The recorder hears readings of the probe as volatile ones, and stores them so, though the
        # probe's node latches them and the model node wants it.
        spec = spec_of(name)
        latched = spec is not None and spec.rate is None
        qos = qos_of(topic.qos, reliability, depth, latched)
        publisher = node.create_publisher(kind, name, qos)
        found[name] = (publisher, topic.type)
    if not found:
        raise InputError(f"{reader.path}: no topic to play; check --topics")
    return found
