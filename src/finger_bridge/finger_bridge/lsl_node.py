# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node between the suite and the Lab Streaming Layer (LSL), for EEG, eye tracking, stimuli.

It sends topics as LSL streams named by their full topic (`/finger/wrench`), and publishes LSL
streams of other programs as topics. The LSL time of a sample is its header stamp; diagnostics give
the bound of the error of that mapping for each stream. Needs `pip install pylsl`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import WrenchStamped

from finger_common.diagnostics import WARN, Health
from finger_common.errors import FingerError, InputError, known_names
from finger_common.node import (
    LATCHED_QOS,
    POLLED_DEPTH,
    STATE_QOS,
    ManagedNode,
    PolledSubscription,
    main_of,
)
from finger_common.settings import Settings, setting
from finger_common.stamps import fill_time, header_stamp, seconds
from finger_msgs.msg import ContactArea, ContactState, Moisture, Trial

from .lsl import STREAMS, ClockMap, Receiver, Sender, fill_message, require

TYPES: dict[str, Any] = {
    "wrench": WrenchStamped,
    "contact_area": ContactArea,
    "moisture": Moisture,
    "contact_state": ContactState,
    "trial": Trial,
}

POLL = 0.01
"""s between readings of the topics that are sent."""
LARGEST_AGE = 60.0
"""s between a sample's time and now, beyond which its clock is not LSL's."""


@dataclass(frozen=True)
class LslSettings(Settings):
    """Parameters of the LSL node."""

    send: list[str] = setting(
        list(STREAMS),
        "Topics to send as LSL streams: wrench, contact_area, moisture, "
        "contact_state, trial; one empty text for none.",
    )
    receive: list[str] = setting(
        [""],
        "LSL streams to publish, as 'topic=name of the stream', such as "
        "'moisture=Corneometer'; wrench, contact_area, moisture or trial.",
    )

    @property
    def sent(self) -> list[str]:
        """Topics that are sent."""
        return [topic for topic in self.send if topic]

    @property
    def received(self) -> dict[str, str]:
        """Names of streams by topic."""
        pairs = (entry.partition("=") for entry in self.receive if entry)
        return {topic.strip(): name.strip() for topic, _, name in pairs}

    def validate(self) -> None:
        topics = [entry.partition("=")[0].strip() for entry in self.receive if entry]
        for topic in topics:
            if topics.count(topic) > 1:
                raise InputError(f"receive: '{topic}' is there twice; name one stream for it")
        for topic in self.sent:
            if topic not in STREAMS:
                raise InputError(
                    f"parameter 'send': '{topic}' is no stream; {known_names(topic, STREAMS)}"
                )
        can = [topic for topic, stream in STREAMS.items() if stream.needed]
        for topic, name in self.received.items():
            if topic not in can or not name:
                raise InputError(
                    f"parameter 'receive': '{topic}={name}' is not understood; give 'topic=name of "
                    f"the stream'. {known_names(topic, can).capitalize()}"
                )
            if topic in self.sent:
                raise InputError(
                    f"'{topic}' is in 'send' and in 'receive'; take it out of one of them"
                )


class LslNode(ManagedNode):
    """Sends and receives while active."""

    SETTINGS = (LslSettings,)
    NAME = "lsl"

    def configure(self) -> None:
        require()
        self._settings = self.settings(LslSettings)
        if self.get_parameter("use_sim_time").value:
            raise InputError("LSL has the time of the host; set 'use_sim_time' to false")
        self._clocks = ClockMap(self.host_clock.now)
        self._health = Health("lsl")
        self._health.notes["clock_error_s"] = f"{self._clocks.error:.1e}"
        streams = {topic: Health(f"from LSL '{n}'") for topic, n in self._settings.received.items()}
        self._incoming = streams
        self.healths = [self._health, *streams.values()]
        self._outputs: dict[str, Any] = {}
        for topic in self._settings.received:
            qos = STATE_QOS if topic == "trial" else self.stream_qos()
            self._outputs[topic] = self.create_stream_publisher(TYPES[topic], topic, qos)

    def activate(self) -> None:
        self._senders: dict[str, tuple[Sender, PolledSubscription]] = {}
        for topic in self._settings.sent:
            qos = self.stream_qos(max(self.values["qos_depth"], POLLED_DEPTH))
            chosen = LATCHED_QOS if topic == "trial" else qos
            sender = Sender(STREAMS[topic], self.resolve_topic_name(topic), self._clocks)
            polled = self.create_polled_subscription(TYPES[topic], topic, chosen)
            self._senders[topic] = sender, polled
        self._receivers = [self._receiver(t, n) for t, n in self._settings.received.items()]
        self.create_steady_timer(POLL, self._send)
        for receiver in self._receivers:
            receiver.start()

    def deactivate(self) -> None:
        self.destroy_active_interfaces()
        for receiver in self._receivers:
            receiver.stop()
        self._senders.clear()

    def _send(self) -> None:
        for sender, subscription in self._senders.values():
            sender.repeat_marker()
            for message in subscription.messages():
                sender.send(header_stamp(message), message)
                self._health.sample()
            if lost := subscription.newly_lost():
                self._health.count("lost", lost)
        # Steps reach neither clock of the mapping, but those of drivers that start later.
        self._health.notes["system_clock_step_s"] = f"{self.host_clock.step():.3f}"

    def _receiver(self, topic: str, name: str) -> Receiver:
        stream, health = STREAMS[topic], self._incoming[topic]
        publisher, message_type = self._outputs[topic], TYPES[topic]

        def publish(stamp_ns: int, sample: Sequence[Any], error: float) -> None:
            ahead = seconds(stamp_ns - self.host_clock.now())
            if abs(ahead) > LARGEST_AGE:
                text = (
                    f"samples of LSL stream '{name}' are stamped {abs(ahead):.3g} s "
                    f"{'ahead' if ahead > 0 else 'late'}, and are left out; stamp them with LSL's "
                    "local_clock()"
                )
                self.log_fault(health, "clock", text, WARN)
                return
            message = message_type(check_fields=True)
            try:
                fill_message(stream, message, sample)
            except FingerError as problem:
                self.log_fault(health, "malformed", str(problem), WARN)
                return
            fill_time(message.header.stamp, stamp_ns)
            message.header.frame_id = f"lsl {name}"
            health.recovered("clock")
            health.recovered("malformed")
            health.sample()
            health.notes["clock_error_s"] = f"{error:.1e}"
            publisher.publish(message)

        def problem(text: str) -> None:
            if text:
                self.log_fault(health, "stream", text, WARN)
            else:
                health.recovered("stream")

        return Receiver(stream, name, self._clocks, publish, problem)


main = main_of(LslNode)

if __name__ == "__main__":
    main()
