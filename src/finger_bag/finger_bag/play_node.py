"""Publishing a bag over the middleware: `finger-bag play`. Imports rclpy, so only that command imports this module.

Serialized messages are published as they are. With `clock`, /clock carries the bag's time, so that nodes with
`use_sim_time` run in it.
"""

from __future__ import annotations

import contextlib
import select
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import rclpy
import yaml
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from finger_common.errors import InputError
from finger_common.node import use_large_shared_memory

from .definitions import type_hash
from .reader import BagReader
from .recorder_node import message_class
from .replay import Replay

CLOCK_TICK = 0.005
"""s between /clock messages: what a timer of a node that runs in the bag's time may be late."""


STREAM_DEPTH, IMAGE_DEPTH = 2000, 50
"""Messages kept for a reader that has fallen behind."""


def qos_of(text: str, reliability: str | None, depth: int = STREAM_DEPTH) -> QoSProfile:
    """Quality of service a topic was recorded with; `reliability` replaces it on streams."""
    profile = QoSProfile(
        depth=depth, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE
    )
    try:
        stored = yaml.safe_load(text)
        first = stored[0] if isinstance(stored, list) and stored else {}
        # rosbag2 writes numbers up to metadata version 8 and names from 9 on.
        if str(first.get("durability")).lower() in ("1", "transient_local"):
            profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
            return profile
        if str(first.get("reliability")).lower() in ("2", "best_effort"):
            profile.reliability = ReliabilityPolicy.BEST_EFFORT
    except (yaml.YAMLError, AttributeError, KeyError, TypeError):
        pass
    if reliability is not None:
        profile.reliability = (
            ReliabilityPolicy.RELIABLE
            if reliability == "reliable"
            else ReliabilityPolicy.BEST_EFFORT
        )
    return profile


def play(
    reader: BagReader,
    topics: Sequence[str] | None = None,
    *,
    rate: float = 1.0,
    offset: float = 0.0,
    duration: float | None = None,
    loop: bool = False,
    clock: bool = False,
    paused: bool = False,
    wait: float = 1.0,
    reliability: str | None = None,
    keys: bool = True,
) -> dict[str, float]:
    """Publish a bag; gives the timing error (see TimingError.summary).

    wait: s to let subscribers find the publishers before the first message. keys: space pauses, s steps, q ends, when
    standard input is a terminal. Topics whose type is not installed are left out with a line on standard error.
    Raises InputError when nothing can be played.
    """
    use_large_shared_memory()
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("bag_player")
        publishers = _publishers(node, reader, topics, reliability)
        clock_publisher = node.create_publisher(Clock, "/clock", 10) if clock else None

        def tell(bag_time: int) -> None:
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(bag_time, 1_000_000_000)
            if clock_publisher is not None:
                clock_publisher.publish(message)

        replay = Replay(
            reader,
            list(publishers),
            rate,
            offset,
            duration,
            loop,
            on_time=_throttled(tell, CLOCK_TICK) if clock else None,
            tick=CLOCK_TICK if clock else 0.05,
        )
        time.sleep(wait)
        replay.pause(paused)
        with _keyboard(replay) if keys else contextlib.nullcontext():
            try:
                for item in replay:
                    publisher, expected = publishers[item.message.topic]
                    if item.message.type == expected:
                        publisher.publish(item.message.raw)
            except KeyboardInterrupt:
                replay.stop()
        # Reliable readers fetch what is still on its way.
        for publisher, _ in publishers.values():
            with contextlib.suppress(Exception):
                publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=2))
        return replay.timing.summary()
    finally:
        rclpy.try_shutdown()


def _throttled(tell: Any, interval: float) -> Any:
    last = [0.0]

    def throttled(bag_time: int) -> None:
        now = time.perf_counter()
        if now - last[0] >= interval * 0.9:
            last[0] = now
            tell(bag_time)

    return throttled


def _publishers(
    node: Any, reader: BagReader, topics: Sequence[str] | None, reliability: str | None
) -> dict[str, tuple[Any, str]]:
    found: dict[str, tuple[Any, str]] = {}
    for name, topic in reader.info.topics.items():
        if (topics is not None and name not in topics) or topic.count == 0:
            continue
        try:
            kind = message_class(topic.type)
            if not reader.decoder(name, topic.type).standard and type_hash(topic.type):
                raise InputError(f"its definition of '{topic.type}' differs from the installed one")
        except InputError as error:
            print(f"finger-bag: topic '{name}' is not played: {error}", file=sys.stderr)
            continue
        depth = IMAGE_DEPTH if "Image" in topic.type else STREAM_DEPTH
        publisher = node.create_publisher(kind, name, qos_of(topic.qos, reliability, depth))
        found[name] = (publisher, topic.type)
    if not found:
        raise InputError(f"{reader.path}: no topic to play; check --topics")
    return found


@contextlib.contextmanager
def _keyboard(replay: Replay) -> Iterator[None]:
    """Keys while playing, when standard input is a terminal."""
    if not sys.stdin.isatty():
        yield
        return
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    done = threading.Event()

    def listen() -> None:
        while not done.is_set():
            if not select.select([sys.stdin], [], [], 0.1)[0]:
                continue
            key = sys.stdin.read(1)
            if key == " ":
                print("paused" if replay.pause() else "playing", file=sys.stderr)
            elif key == "s":
                replay.step()
            elif key == "q":
                replay.stop()

    thread = threading.Thread(target=listen, daemon=True)
    tty.setcbreak(sys.stdin)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(1)
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
