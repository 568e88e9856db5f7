# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recorder node: writes the rig's topics into a bag, serialized as they come.

Node around `recorder.Recorder`. Subscriptions exist from activation on, so that a recording
misses nothing at its start; latched messages that came before are repeated at its head. `~/record`
starts and stops. A recording that was broken off a moment ago, as by a crash, goes on in a further
file of its bag, unless it was that of a guided trial.
"""

from __future__ import annotations

import copy
import importlib
import math
import re
import time
import unicodedata
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.qos import ReliabilityPolicy

from finger_common.cli import plain
from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import FingerError, InputError, listed
from finger_common.files import read_bytes, user_path
from finger_common.interface_text import message_text
from finger_common.node import LATCHED_QOS, ManagedNode, PolledSubscription, main_of
from finger_common.node.qos import RELIABLE
from finger_common.node.stream_watch import OTHER_TYPE
from finger_common.retry import Pauses
from finger_common.settings import Settings, setting
from finger_common.stamps import NANOSECONDS, seconds
from finger_common.subject_code import known_finger
from finger_msgs.srv import Record

from .cdr_layout import stamp_of_cdr
from .definitions import type_hash
from .recorder import Recorder, RecorderSettings, RecordingResult, Serialized
from .recording_marker import RecordingMarker
from .schema import CALIBRATION_ATTACHMENT, TOPICS, SessionMetadata, full_name, spec_of
from .stamp_gaps import StampGaps


@dataclass(frozen=True)
class RecordingSettings(Settings):
    """What the node records, and where to."""

    folder: str = setting(
        "",
        "Folder that bags without an absolute path go to; empty: the folder the node runs in.",
        runtime=True,
    )
    topics: list[str] = setting(
        list(TOPICS),
        "Topics to record; 'name' of the bag schema, or 'name=package/msg/Type' for others.",
    )
    bag_name: str = setting(
        "", "Name of a bag that is not named otherwise; empty: date and condition."
    )
    record_at_start: bool = setting(False, "Begin a bag as soon as the node is active.")
    calibration_file: str = setting("", "Plate calibration to attach to each bag.", runtime=True)
    attachments: list[str] = setting([""], "Further files to attach to each bag.", runtime=True)
    buffer_time: float = setting(
        4.0,
        "Stall of the recorder that the middleware bridges for each topic.",
        unit="s",
        minimum=0.1,
        maximum=60.0,
        advice="Raise it when 'lost' in the diagnostics grows; images of this time must fit in "
        "memory.",
    )


@dataclass(frozen=True)
class SessionSettings(Settings):
    """Metadata of each bag."""

    session: str = setting("", "Id of the session, for the bag's metadata.", runtime=True)
    subject: str = setting("", "Subject code, never a name.", runtime=True)
    condition: str = setting("", "Condition, where the bag holds only one.", runtime=True)
    rig: str = setting("", "Name of the rig, for the bag's metadata.", runtime=True)
    source: str = setting(
        "rig",
        "What makes the data, for the bag's metadata: 'rig' or 'simulated rig'.",
        runtime=True,
    )


_REMINDER = 10.0
"""s between error messages while an interrupted recording is not resumed."""
_PATIENCE, _SHORT = 20.0, 2.0
"""s of a recording after which it is told that nothing comes: while it runs, when it is stopped."""
_LONGEST_DELAY = 60.0
"""s that a message waits at most between its arrival and being taken."""

RESTART = 60.0
"""s within which a recorder that was killed is started again: the next one goes on with its bag."""

SLOW = 0.25
"""Share of `queue_limit` that waits, from which on the disk is too slow."""

POLL = 0.02
"""s between two polls; the middleware keeps messages and their time of arrival meanwhile."""


def message_class(message_type: str) -> Any:
    """Class of a type such as "std_msgs/msg/Header"; raises InputError when not installed."""
    package, _, name = message_type.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError):
        raise InputError(
            f"message type '{message_type}' is not installed; source its workspace or leave it out"
        ) from None


def _attached(settings: RecordingSettings) -> dict[str, Path]:
    """Files to attach by the name they get in a bag; raises InputError where two get one name."""
    files: dict[str, Path] = {}
    named = [(Path(file).name, file) for file in settings.attachments if file]
    if settings.calibration_file:
        named.append((CALIBRATION_ATTACHMENT, settings.calibration_file))
    for name, file in named:
        path = user_path(file)
        if files.setdefault(name, path) != path:
            raise InputError(
                f"parameters 'attachments' and 'calibration_file': {files[name]} and {path} would "
                f"both be attached as '{name}'; leave one out or rename it"
            )
    return files


@dataclass
class _Topic:
    """A topic that is recorded.

    name: absolute. rate: of its samples in Hz, as far as is known. steady: whether the schema fixes
    that rate, so that gaps between its stamps tell what is missing. latched: the newest messages of
    a latched topic, which are repeated at the head of a bag; others keep none. subscription: while
    the node is active; reliable: its QoS. newest: log time (ns) of the last message.
    """

    name: str
    type: str
    rate: float
    steady: bool
    latched: deque[Serialized]
    gaps: StampGaps | None = None
    subscription: PolledSubscription | None = None
    reliable: bool = False
    newest: int = 0

    @property
    def is_latched(self) -> bool:
        """Whether its newest messages count as long as no others come."""
        return bool(self.latched.maxlen)


class RecorderNode(ManagedNode):
    """Records topics into bags."""

    SETTINGS = (RecordingSettings, SessionSettings, RecorderSettings)
    NAME = "recorder"

    def configure(self) -> None:
        self._recorder = Recorder(self.settings(RecorderSettings), on_error=self._on_error)
        self.closing.callback(self._end_bag)
        self._topics: dict[str, _Topic] = {}
        self._definitions: dict[str, str] = {}
        """Definitions of types that `definitions` does not know, as installed."""
        topics = self.settings(RecordingSettings).topics
        if not topics:
            raise InputError("parameter 'topics' is empty; name what is recorded")
        for entry in topics:
            name, _, kind = entry.partition("=")
            spec = spec_of(name)
            if kind and spec is not None and spec.type != kind:
                spec = None
            if not kind and spec is None:
                raise InputError(
                    f"parameter 'topics': '{name}' is not in the bag schema; "
                    "add '=package/msg/Type'"
                )
            kind = kind or (spec.type if spec else "")
            message_class(kind)
            if not type_hash(kind):
                self._definitions[kind] = message_text(kind)
            full_name(name)  # refuses what ROS does not take
            absolute = self.resolve_topic_name(name)
            rate = (spec.rate if spec is not None else None) or 0.0
            kept: deque[Serialized] = deque(maxlen=spec.latched if spec is not None else 0)
            self._topics[absolute] = _Topic(absolute, kind, rate or 50.0, rate >= 5, kept)
        self._health = Health("recorder")
        self.healths = [self._health]
        self._health.notes["minimum_free"] = str(self.values["minimum_free"])
        self._lost_told = 0
        """Messages lost in the newest warning."""
        self._started = 0.0
        self._pauses = Pauses(1.0, 3.0)
        self._next_attempt = self._last_attempt = self._next_reminder = 0.0
        self._marker = self._marker_here()
        self._goes_on: dict[str, str] | None = None
        """Metadata with which another recorder would go on with what this one records."""
        self.create_service(Record, "~/record", self._on_record)

    def activate(self) -> None:
        for topic in self._topics.values():
            self._subscribe(topic, self.values["qos_reliability"] == RELIABLE)
        try:
            self._take_up()
        except FingerError:
            self._unsubscribe()
            raise
        # Steady time: recording continues when simulated time stands still or jumps.
        self.create_steady_timer(POLL, self._poll)
        self.create_steady_timer(1.0, self._each_second)

    def deactivate(self) -> None:
        self._end_bag()
        self._unsubscribe()

    def _take_up(self) -> None:
        """Go on with a recording that was broken off a moment ago, or begin one where that is
        wanted at the start; tell of one that is left as it is."""
        broken, at_start = self._marker.broken_off(), self.values["record_at_start"]
        text = "" if broken is None else f"the recording into {broken.bag} was broken off"
        if broken is not None:
            if broken.session is not None and broken.age < RESTART and self._may_be(broken.bag):
                try:
                    self._begin(broken.bag, broken.session, further=True)
                except InputError as error:
                    text += f", and cannot go on ({error})"
                else:
                    text += (
                        "; it goes on in a further file there, and 'finger-bag recover' joins them"
                    )
                    self.log_fault(self._health, "interrupted", text, WARN)
                    return
            text += "; 'finger-bag recover' completes it"
            if broken.session is None:  # whoever guides it must be able to go on
                self.log_fault(self._health, "broken_off", f"{text}, its trial is repeated", WARN)
            else:
                self.log_fault(self._health, "broken_off", f"NOT RECORDING: {text}", ERROR)
        if at_start:
            path = self._start("", None)
            if text:
                text += f", another one runs into {path}"
                self.log_fault(self._health, "interrupted", text, WARN)

    def _may_be(self, bag: Path) -> bool:
        """Whether a bag is the one that this node is to record at its start, if one is named."""
        named = self.values["bag_name"] if self.values["record_at_start"] else ""
        return not named or bag == (self._folder / user_path(named)).absolute()

    # Subscriptions ---------------------------------------------------------------------------

    def _subscribe(self, topic: _Topic, reliable: bool) -> None:
        if topic.is_latched:
            # Deeper than those of other readers: several messages may come between two polls.
            qos = copy.copy(LATCHED_QOS)
            qos.depth = max(qos.depth, math.ceil(50.0 * self.values["buffer_time"]))
        else:
            qos = self.stream_qos(max(20, math.ceil(topic.rate * self.values["buffer_time"])))
            if reliable:
                qos.reliability = ReliabilityPolicy.RELIABLE
        if topic.subscription is not None:
            topic.subscription.destroy()
        kind = message_class(topic.type)
        topic.subscription = self.create_polled_subscription(kind, topic.name, qos)
        topic.reliable = reliable or topic.is_latched

    def _unsubscribe(self) -> None:
        self.destroy_active_interfaces()
        for topic in self._topics.values():
            topic.subscription = None

    def _subscribed(self) -> Iterator[tuple[_Topic, PolledSubscription]]:
        for topic in self._topics.values():
            if topic.subscription is not None:
                yield topic, topic.subscription

    def _poll(self) -> None:
        """Take what has come."""
        for topic, subscription in self._subscribed():
            for cdr, info in subscription.take():
                self._take(topic, cdr, info)

    def _take(self, topic: _Topic, cdr: bytes, info: dict[str, Any]) -> None:
        # On a clock that steps of the system clock do not reach: a bag is read in this order.
        now = self.host_clock.now()
        earliest = now - round(_LONGEST_DELAY * NANOSECONDS)
        received = self.host_clock.of_stamp(info.get("received_timestamp") or None, earliest)
        # What the middleware had to send again keeps its place among its publisher's messages.
        received = topic.newest = max(received, topic.newest)
        sent = self.host_clock.of_stamp(info.get("source_timestamp") or None, 0)
        message = Serialized(topic.name, topic.type, cdr, received, min(sent, received))
        topic.latched.append(message)
        if self._recorder.put(message):
            if topic.gaps is not None and topic.subscription is not None:
                stamp = topic.subscription.read(cdr, stamp_of_cdr)
                if stamp is not None:
                    topic.gaps.add(stamp, seconds(received))
            self._health.sample()

    def _missing(self) -> dict[str, int]:
        """Messages missing between the stamps of topics, where there are any."""
        gaps = {topic.name: topic.gaps for topic in self._topics.values() if topic.gaps is not None}
        return {name: found.missing for name, found in gaps.items() if found.missing}

    # Each second -----------------------------------------------------------------------------

    def _each_second(self) -> None:
        self._check_middleware()
        self._note_bag()
        self._watch_interruption()
        self._watch_clock()
        self._note_accounts()
        if not self._recorder.recording:
            self._follow_publishers()

    def _check_middleware(self) -> None:
        """Note what the middleware lost, and publishers that it does not connect."""
        for topic, subscription in self._subscribed():
            lost = subscription.newly_lost()
            if lost and self._recorder.recording:
                self._recorder.note_lost(topic.name, lost)
            self.check_mismatch(subscription)

    def _note_bag(self) -> None:
        path = self._recorder.path if self._recorder.recording else None
        self._health.notes["recording"] = "no" if path is None else str(path)
        self._health.activity = "idle" if path is None else f"recording {path.name}"

    def _watch_clock(self) -> None:
        if warning := self.host_clock.step_warning("log times"):
            self.log_fault(self._health, "clock_step", warning, WARN)
        else:
            self._health.recovered("clock_step")

    def _note_accounts(self) -> None:
        """Say how many messages are recorded, wait, are lost and are missing."""
        recorder, notes = self._recorder, self._health.notes
        lost = recorder.lost
        notes["messages"] = str(sum(recorder.counts.values()))
        notes["waiting_bytes"] = str(recorder.waiting)
        for name, numbers in (("lost", lost), ("missing_stamps", self._missing())):
            notes[name] = ", ".join(f"{topic} {n}" for topic, n in numbers.items()) or "0"
        if sum(lost.values()) > self._lost_told:
            self._lost_told = sum(lost.values())
            self.log_fault(self._health, "lost", f"messages lost: {notes['lost']}", WARN)
        for key, text in (
            ("disk", self._behind()),
            ("force", self._without_force(recorder.counts)),
            (
                "nothing",
                self._nothing_came(recorder.counts, _PATIENCE) if recorder.recording else "",
            ),
        ):
            if text:
                self.log_fault(self._health, key, text, WARN)
            else:
                self._health.recovered(key)

    def _behind(self) -> str:
        """Sentence on a disk that is slower than what comes, or ""."""
        waiting, limit = self._recorder.waiting, self.values["queue_limit"]
        if waiting <= SLOW * limit:
            return ""
        return (
            f"the disk is too slow: {waiting / 1e6:.0f} MB wait for it, beyond {limit / 1e6:.0f} "
            "MB messages are lost; record to a faster disk, or fewer topics"
        )

    def _without_force(self, counts: dict[str, int]) -> str:
        """Sentence on a wrench that did not come although contact states made of it did, or ""."""
        for name in self._topics:
            namespace, _, last = name.rpartition("/")
            states = f"{namespace}/contact_state"
            if last == "wrench" and counts.get(states) and not counts.get(name):
                return (
                    f"'{states}' is recorded without its force: nothing came on '{name}'; name "
                    "the model's 'wrench_topic' in 'topics' in its place, as "
                    f"'name={TOPICS[last].type}'"
                )
        return ""

    def _nothing_came(self, counts: dict[str, int], after: float) -> str:
        """Sentence on a recording of more than `after` s without any stream, and where there are
        some, or ""."""
        if time.monotonic() - self._started <= after:
            return ""
        streams = [
            topic.name
            for topic in self._topics.values()
            if not topic.is_latched and topic.name not in TOPICS
        ]
        came = counts.keys() & {n for name in streams for n in (name, f"{name}/compressed")}
        steady = any(topic.steady for topic in self._topics.values())
        if not steady or any(counts[name] for name in came):
            return ""
        text = f"nothing came on {listed(streams, 3)}: "
        if other_type := self._health.faults.get(OTHER_TYPE):
            return text + other_type
        if any(map(self.count_publishers, streams)):
            return text + "they are published, but nothing is sent; activate their nodes"
        others = set()
        for name, kinds in self.get_topic_names_and_types():
            spec = spec_of(name)
            if spec is None or spec.latched or spec.name == name or spec.type not in kinds:
                continue
            if self.count_publishers(name):
                others.add(name.removesuffix(f"/{spec.name}") or "/")
        if others:
            return text + f"they are published in {listed(sorted(others))}; record there"
        return text + "nobody publishes such streams here; start the rig, in this ROS_DOMAIN_ID"

    def _follow_publishers(self) -> None:
        """Where every publisher offers it, reliable delivery costs nothing and loses nothing."""
        if self.values["qos_reliability"] == RELIABLE:
            return
        for topic, _ in self._subscribed():
            offers = self.get_publishers_info_by_topic(topic.name)
            if offers and not topic.is_latched:
                all_reliable = all(
                    o.qos_profile.reliability == ReliabilityPolicy.RELIABLE for o in offers
                )
                if all_reliable != topic.reliable:
                    self._subscribe(topic, all_reliable)

    def _watch_interruption(self) -> None:
        """Say again and again that nothing is recorded; resume as soon as that is possible."""
        recorder, now = self._recorder, time.monotonic()
        if not recorder.interrupted:
            return
        lost = sum(recorder.lost.values())
        text = f"NOT RECORDING, {lost} messages lost so far: {recorder.interrupted}"
        self._health.fault("recording", text, ERROR)
        # Before it is resumed: also a short interruption is reported.
        self.publish_diagnostics()
        if now >= self._next_reminder:
            self._next_reminder = now + _REMINDER
            self.get_logger().error(text)
        if now < self._next_attempt:
            return
        if now - self._last_attempt > 60.0:
            self._pauses.reset()
        self._last_attempt, self._next_attempt = now, now + self._pauses.next()
        try:
            path = recorder.resume()
        except InputError:  # the disk is full, or is not there
            return
        self._mark(path)
        self._put_latched()
        self._health.recovered("recording")
        lost = sum(recorder.lost.values())
        self.log_fault(
            self._health,
            "interrupted",
            f"the recording was interrupted, {lost} messages are lost; it continues in {path}",
            WARN,
        )

    # Recording -------------------------------------------------------------------------------

    def _on_record(self, request: Any, response: Any) -> Any:
        try:
            if request.command == Record.Request.COMMAND_START:
                if not self.active:
                    raise InputError("the node is not active; activate it first")
                path = self._start(request.path, request.trial)
                response.path, response.message = str(path), f"recording into {path}"
            elif request.command == Record.Request.COMMAND_STOP:
                if not self._recorder.started:
                    self._forget_broken_off()
                result = self._finish()
                response.path = str(result.path)
                response.message_count = result.message_count
                response.lost_count = result.lost_count
                response.message = (
                    result.error
                    or f"{result.message_count} messages recorded, {result.lost_count} lost"
                )
                for text in self._doubts(result):
                    response.message += f"; {text}"
                if result.error:
                    response.success = False
                    return response
            else:
                raise InputError(f"command {request.command} is not known; use 0 (stop), 1 (start)")
            response.success = True
        except FingerError as error:
            response.success, response.message = False, str(error)
        return response

    def _start(self, path: str, trial: Any) -> Path:
        session = self.settings(SessionSettings).to_dict()
        if trial is not None:
            named = {k: getattr(trial, k) for k in ("session", "subject", "condition")}
            named["finger"] = known_finger(trial.header.frame_id)
            session.update({k: text for k, text in named.items() if text})
            if trial.target_force > 0:
                session["target_force"] = f"{trial.target_force:g}"
        given = path or self.values["bag_name"]
        if given:
            target = self._folder / user_path(given)
        else:
            target = self._free_name(self._folder, session)
        if any(unicodedata.category(c) in ("Cc", "Zl", "Zp") for c in str(target)):
            raise InputError(
                f"bag '{plain(target)}': its name has a line feed or another control character; "
                "leave it out"
            )
        # Whoever guides a session makes another attempt at a trial that was broken off.
        return self._begin(target, session, guided=trial is not None and bool(trial.session))

    def _begin(
        self, target: Path, session: dict[str, str], guided: bool = False, further: bool = False
    ) -> Path:
        """Begin a bag, or a further file of one that was broken off.

        guided: it is not gone on with where it is broken off.
        """
        settings = self.settings(RecordingSettings)
        attachments = {
            name: read_bytes(file, "file to attach") for name, file in _attached(settings).items()
        }
        topics = {topic.name: topic.type for topic in self._topics.values()}
        # What came before the start does not belong to the bag.
        self._poll()
        self._check_middleware()
        if not self._recorder.started:  # else the start is refused, and these are of what runs
            for topic in self._topics.values():
                topic.gaps = StampGaps(topic.rate) if topic.steady else None
            self._lost_told = 0
            for key in ("recording", "interrupted", "lost"):
                self._health.recovered(key)
            self._started = time.monotonic()
        started = self._recorder.start(
            target,
            SessionMetadata.from_mapping(session),
            topics,
            attachments,
            self._definitions,
            further,
        )
        self._forget_broken_off()
        self._marker = self._marker_here()
        self._goes_on = None if guided else session
        self._mark(started)
        self._put_latched()
        self._note_bag()
        self.get_logger().info(f"recording into {started}")
        return started

    @staticmethod
    def _free_name(folder: Path, session: dict[str, Any]) -> Path:
        """Date and condition, and a number where that name is taken."""
        date = datetime.now().strftime("%Y%m%d_%H%M%S")
        condition = re.sub(r"[^\w-]+", "-", session["condition"])[:100]
        name = "_".join(part for part in (date, condition) if part)
        target, number = folder / name, 2
        while target.exists():
            target, number = folder / f"{name}_{number}", number + 1
        return target

    def _put_latched(self) -> None:
        """Repeat the latched messages at the head of a bag."""
        now = self.host_clock.now()
        for topic in self._topics.values():
            for message in topic.latched:
                self._recorder.put(message._replace(log_time_ns=now))

    def _marker_here(self) -> RecordingMarker:
        """Of this recorder, in the folder that it would record into now."""
        return RecordingMarker(self._folder, self._marker_name)

    @property
    def _folder(self) -> Path:
        """Folder that bags without an absolute path go to now."""
        return user_path(self.values["folder"])

    @property
    def _marker_name(self) -> str:
        """Of one recorder of a computer."""
        return f"{self.get_fully_qualified_name()}.{self.context.get_domain_id()}"

    def _mark(self, bag: Path) -> None:
        """Note that a bag is being written, for the node after a crash of this one."""
        try:
            self._marker.set(bag, self._goes_on)
        except OSError as error:
            self.get_logger().warning(
                f"the recording cannot be noted in 'folder' ({error}): after a crash of the "
                "recorder nobody would be told; give a folder that can be written",
                once=True,
            )

    def _forget_broken_off(self) -> None:
        """What the recorder writes is closed, or another recording follows on a broken one."""
        with suppress(OSError):
            self._marker.clear()
        self._health.recovered("broken_off")

    def _finish(self) -> RecordingResult:
        try:
            self._poll()
            self._check_middleware()
        finally:  # the bag is closed whatever came
            result = self._recorder.stop()
            self._forget_broken_off()
        missing, doubts = self._missing(), self._doubts(result)
        self._note_bag()
        # What is wrong with a bag that is closed keeps no other one from being begun.
        self._health.recovered("recording")
        if result.error:
            self.exit_code = 1
            text = (
                f"the recording is not complete: {result.error}; {result.lost_count} messages lost"
            )
            self._health.fault("interrupted", text, WARN)
            self.get_logger().error(text)
        self.get_logger().info(
            f"recorded {result.message_count} messages into {result.path}, "
            f"{result.lost_count} lost" + (f", stamps missing: {missing}" if missing else "")
        )
        for text in doubts:
            self.get_logger().warning(text)
        return result

    def _doubts(self, result: RecordingResult) -> list[str]:
        """What makes a bag of little use that was recorded as it should be."""
        nothing = "" if result.error else self._nothing_came(result.counts, _SHORT)
        if nothing and self.values["record_at_start"]:
            self.exit_code = 1
        return [text for text in (self._without_force(result.counts), nothing) if text]

    def _end_bag(self) -> None:
        """Finish the bag that was started, if there is one."""
        if self._recorder.started:
            self._finish()

    def _on_error(self, text: str) -> None:
        self._next_attempt = 0.0
        self._next_reminder = time.monotonic() + _REMINDER
        self.log_fault(self._health, "recording", f"NOT RECORDING: {text}", ERROR)


class RecordingCommand(RecorderNode):
    """The recorder of `finger-bag record`: a recording that cannot begin ends it."""

    ONE_TASK = True


main = main_of(RecorderNode)
record = main_of(RecordingCommand, "finger-bag")

if __name__ == "__main__":
    main()
