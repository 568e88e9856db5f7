# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recorder node: writes the rig's topics into a bag, serialized as they come.

Node around `recorder.Recorder`. Subscriptions exist from activation on, so that a recording
misses nothing at its start; latched messages that came before are repeated at its head. `~/record`
starts and stops.
"""

from __future__ import annotations

import copy
import importlib
import math
import re
import time
from collections import deque
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.qos import ReliabilityPolicy

from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import FingerError, InputError
from finger_common.files import read_bytes
from finger_common.interface_text import message_text
from finger_common.node import LATCHED_QOS, ManagedNode, PolledSubscription, main_of
from finger_common.retry import Pauses
from finger_common.settings import Settings, setting
from finger_common.stamps import NANOSECONDS, seconds
from finger_msgs.srv import Record

from .cdr_layout import stamp_of_cdr
from .definitions import type_hash
from .recorder import Recorder, RecorderSettings, Serialized
from .schema import CALIBRATION_ATTACHMENT, TOPICS, SessionMetadata
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
_LONGEST_DELAY = 60.0
"""s that a message waits at most between its arrival and being taken."""

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
        path = Path(file).expanduser()
        if files.setdefault(name, path) != path:
            raise InputError(
                f"parameters 'attachments' and 'calibration_file': {files[name]} and {path} would "
                f"both be attached as '{name}'; leave one out or rename it"
            )
    return files


class RecorderNode(ManagedNode):
    """Records topics into bags."""

    SETTINGS = (RecordingSettings, SessionSettings, RecorderSettings)
    NAME = "recorder"

    def configure(self) -> None:
        self._recorder = Recorder(self.settings(RecorderSettings), on_error=self._on_error)
        self._topics: dict[str, tuple[str, int, str]] = {}
        self._names: dict[str, str] = {}
        self._definitions: dict[str, str] = {}
        """Definitions of types that `definitions` does not know, as installed."""
        for entry in self.settings(RecordingSettings).topics:
            name, _, kind = entry.partition("=")
            spec = TOPICS.get(name)
            if not kind and spec is None:
                raise InputError(
                    f"parameter 'topics': '{name}' is not in the bag schema; "
                    "add '=package/msg/Type'"
                )
            kind = kind or (spec.type if spec else "")
            message_class(kind)
            if not type_hash(kind):
                self._definitions[kind] = message_text(kind)
            absolute = self.resolve_topic_name(name)
            # The schema fixes the period of streams; others are not checked for gaps.
            stream = "stamped" if spec is not None and (spec.rate or 0) >= 5 else ""
            self._names[absolute] = name
            self._topics[absolute] = (kind, spec.latched if spec is not None else 0, stream)
        self._health = Health("recorder")
        self.healths = [self._health]
        self._subs: dict[str, tuple[PolledSubscription, bool]] = {}
        self._latched: dict[str, deque[Serialized]] = {}
        self._gaps: dict[str, StampGaps] = {}
        self._announced: dict[str, int] = {}
        self._newest: dict[str, int] = {}
        """Log time of the last message of each topic."""
        self._pauses = Pauses(1.0, 3.0)
        self._next_attempt = self._last_attempt = self._next_reminder = 0.0
        self._service = self.create_service(Record, "~/record", self._on_record)

    def activate(self) -> None:
        for topic in self._topics:
            self._subscribe(topic, self.values["qos_reliability"] == "reliable")
        if self.values["record_at_start"]:
            try:
                self._start("", None)
            except FingerError:
                self._unsubscribe()
                raise
        # Steady time: recording continues when simulated time stands still or jumps.
        self._rounds = [
            self.create_steady_timer(POLL, self._poll),
            self.create_steady_timer(1.0, self._each_second),
        ]

    def deactivate(self) -> None:
        for timer in self._rounds:
            self.destroy_timer(timer)
        if self._recorder.started:
            self._finish()
        self._unsubscribe()

    def cleanup(self) -> None:
        service = self.__dict__.pop("_service", None)
        if service is not None:
            self.destroy_service(service)

    # Subscriptions ---------------------------------------------------------------------------

    def _subscribe(self, topic: str, reliable: bool) -> None:
        kind, latched, _ = self._topics[topic]
        if latched:
            # Deeper than those of other readers: several messages may come between two polls.
            qos = copy.copy(LATCHED_QOS)
            qos.depth = max(qos.depth, math.ceil(50.0 * self.values["buffer_time"]))
            self._latched.setdefault(topic, deque(maxlen=latched))
        else:
            spec = TOPICS.get(self._names[topic])
            rate = (spec.rate if spec is not None else None) or 50.0
            qos = self.stream_qos(max(20, math.ceil(rate * self.values["buffer_time"])))
            if reliable:
                qos.reliability = ReliabilityPolicy.RELIABLE
        old = self._subs.pop(topic, None)
        if old is not None:
            old[0].destroy()
        subscription = self.create_polled_subscription(message_class(kind), topic, qos)
        self._subs[topic] = (subscription, reliable or bool(latched))

    def _unsubscribe(self) -> None:
        for subscription, _ in self._subs.values():
            subscription.destroy()
        self._subs.clear()

    def _poll(self) -> None:
        """Take what has come."""
        for topic, (subscription, _) in self._subs.items():
            kind, latched, _ = self._topics[topic]
            for cdr, info in subscription.take():
                self._take(topic, kind, latched, cdr, info)

    def _take(self, topic: str, kind: str, latched: int, cdr: bytes, info: dict[str, Any]) -> None:
        # On a clock that steps of the system clock do not reach: a bag is read in this order.
        now = self._host_clock.now()
        earliest = now - round(_LONGEST_DELAY * NANOSECONDS)
        received = self._host_clock.of_stamp(info.get("received_timestamp") or None, earliest)
        # What the middleware had to send again keeps its place among its publisher's messages.
        received = self._newest[topic] = max(received, self._newest.get(topic, 0))
        sent = self._host_clock.of_stamp(info.get("source_timestamp") or None, 0)
        message = Serialized(topic, kind, cdr, received, min(sent, received))
        if latched:
            self._latched[topic].append(message)
        if self._recorder.put(message):
            gaps = self._gaps.get(topic)
            if gaps is not None:
                gaps.add(stamp_of_cdr(cdr), seconds(received))
            self._health.sample()

    def _check_middleware(self) -> None:
        """Note what the middleware lost, and publishers that it does not connect."""
        for topic, (subscription, _) in self._subs.items():
            lost = subscription.newly_lost()
            if lost and self._recorder.recording:
                self._recorder.note_lost(topic, lost)
            if subscription.new_mismatches():
                self.log_fault(
                    self._health,
                    "qos_mismatch",
                    f"a publisher of '{topic}' has a QoS that does not fit and is not recorded; "
                    "set qos_reliability alike on both sides",
                    WARN,
                )

    def _each_second(self) -> None:
        self._check_middleware()
        recorder = self._recorder
        lost = recorder.lost
        notes = self._health.notes
        notes["recording"] = str(recorder.path) if recorder.recording else "no"
        path = recorder.path if recorder.recording else None
        self._health.activity = f"recording {path.name}" if path is not None else "idle"
        self._watch_interruption()
        step = self._host_clock.step()
        if abs(step) > 0.05:
            self.log_fault(
                self._health,
                "clock_step",
                f"the system clock was stepped by {step:+.3f} s; log times continue as before, "
                "restart all nodes to follow it",
                WARN,
            )
        notes["messages"] = str(sum(recorder.counts.values()))
        notes["waiting_bytes"] = str(recorder.waiting)
        notes["lost"] = ", ".join(f"{t} {n}" for t, n in lost.items()) or "0"
        gaps = {t: g.missing for t, g in self._gaps.items() if g.missing}
        notes["missing_stamps"] = ", ".join(f"{t} {n}" for t, n in gaps.items()) or "0"
        if lost and sum(lost.values()) > self._announced.get("lost", 0):
            self._announced["lost"] = sum(lost.values())
            self.log_fault(self._health, "lost", f"messages lost: {notes['lost']}", WARN)
        if recorder.recording:
            return
        for topic, (_, reliable) in list(self._subs.items()):
            # Where every publisher offers it, reliable delivery costs nothing and loses nothing.
            offers = self.get_publishers_info_by_topic(topic)
            always = self.values["qos_reliability"] == "reliable" or self._topics[topic][1] > 0
            if offers and not always:
                all_reliable = all(
                    o.qos_profile.reliability == ReliabilityPolicy.RELIABLE for o in offers
                )
                if all_reliable != reliable:
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
                path = self._start(request.path, request.trial)
                response.path, response.message = str(path), f"recording into {path}"
            elif request.command == Record.Request.COMMAND_STOP:
                result = self._finish()
                response.path = str(result.path)
                response.message_count = result.message_count
                response.lost_count = result.lost_count
                response.message = (
                    result.error
                    or f"{result.message_count} messages recorded, {result.lost_count} lost"
                )
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
        settings = self.settings(RecordingSettings)
        session = self.settings(SessionSettings).to_dict()
        if trial is not None:
            named = {k: getattr(trial, k) for k in ("session", "subject", "condition")}
            session.update({k: text for k, text in named.items() if text})
            if trial.target_force > 0:
                session["target_force"] = f"{trial.target_force:g}"
        folder = Path(settings.folder).expanduser()
        given = path or settings.bag_name
        target = folder / Path(given).expanduser() if given else self._free_name(folder, session)
        attachments = {
            name: read_bytes(file, "file to attach") for name, file in _attached(settings).items()
        }
        topics = {t: kind for t, (kind, _, _) in self._topics.items()}
        # What came before the start does not belong to the bag.
        self._poll()
        self._check_middleware()
        if not self._recorder.started:  # else the start is refused, and these are of what runs
            self._gaps = {t: StampGaps() for t, (_, _, stream) in self._topics.items() if stream}
            self._announced.clear()
            self._health.recovered()
        started = self._recorder.start(
            target, SessionMetadata.from_mapping(session), topics, attachments, self._definitions
        )
        self._put_latched()
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
        now = self._host_clock.now()
        for messages in self._latched.values():
            for message in messages:
                self._recorder.put(message._replace(log_time_ns=now))

    def _finish(self) -> Any:
        self._poll()
        self._check_middleware()
        result = self._recorder.stop()
        missing = {t: g.missing for t, g in self._gaps.items() if g.missing}
        if result.error:
            self.exit_code = 1
            self.get_logger().error(
                f"the recording is not complete: {result.error}; {result.lost_count} messages lost"
            )
        self.get_logger().info(
            f"recorded {result.message_count} messages into {result.path}, "
            f"{result.lost_count} lost" + (f", stamps missing: {missing}" if missing else "")
        )
        return result

    def _on_error(self, text: str) -> None:
        self._next_attempt = 0.0
        self._next_reminder = time.monotonic() + _REMINDER
        self.log_fault(self._health, "recording", f"NOT RECORDING: {text}", ERROR)


main = main_of(RecorderNode)

if __name__ == "__main__":
    main()
