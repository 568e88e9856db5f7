# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What other nodes do to a node: QoS and types that do not fit, second publishers, a second of its
name."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, qos_check_compatible

from ..diagnostics import ERROR, MIXED_INPUT, WARN
from .polling import PolledSubscription

if TYPE_CHECKING:
    from .managed import ManagedNode

KEPT = DurabilityPolicy.TRANSIENT_LOCAL

REMEMBERED = 30.0
"""s for which the middleware may still show the publishers of a node that was killed, and after
which messages that could not be read are no longer told."""

OTHER_TYPE = "other_type"
"""Fault of topics whose publishers send another type than the node reads."""

PATIENCE = 10.0
"""s for which a node is active without simulated time until it is told."""


UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name that the middleware gives a publisher whose node it does not know."""


def publisher_name(info: Any) -> str:
    """Full name of the node of a publisher, of what the middleware tells of it."""
    if info.node_name == UNKNOWN_NODE:
        # One whose participant is not known yet, or a program without ROS.
        return "an unnamed node"
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


class StreamWatch:
    """Reports in a node's first health what harms its streams; `look` is called each second.

    published: publishers of streams. polled: subscriptions whose QoS events nobody else reads.
    unreadable: messages that could not be read, by topic and package of its type.
    read: topics (resolved names) that the node reads, each of which one publisher should give, with
    whether the node would mix several.
    """

    def __init__(self, node: ManagedNode) -> None:
        self.published: list[Any] = []
        self.polled: list[PolledSubscription] = []
        self.read: dict[str, Callable[[], bool]] = {}
        self.unreadable: Counter[tuple[str, str]] = Counter()
        self._unreadable_told: tuple[Counter[tuple[str, str]], float] = Counter(), 0.0
        self._node = node
        self._mismatches: dict[str, QoSProfile] = {}
        self._shared_since: dict[str, float] = {}
        self._timeless_since: float | None = None

    def look(self) -> None:
        """Report what is wrong now, and end the faults that are over."""
        for polled in self.polled:
            self.check_mismatch(polled)
        self._report_mismatches()
        self._report_other_types()
        self._report_namesake()
        self._report_second_publishers()
        self._report_mixed_inputs()
        self._report_unreadable()
        self._report_clock()

    def check_mismatch(self, polled: PolledSubscription) -> None:
        """Report publishers of a polled topic whose QoS is incompatible."""
        if polled.new_mismatches():
            self.report_mismatch(polled.topic, polled.qos)
        elif polled.topic in self._mismatches:
            self._mismatches[polled.topic] = polled.qos  # it may have been made anew

    def report_mismatch(self, topic: str, qos: QoSProfile) -> None:
        """Report that a publisher does not fit a subscription of this QoS, until it is gone."""
        self._mismatches[topic] = qos

    def _report_mismatches(self) -> None:
        """Name the publishers that do not fit, each with the policy that differs."""
        texts = []
        for topic, qos in list(self._mismatches.items()):
            offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
            unfit = [o for o in offers if qos_check_compatible(o, qos)[0] == QoSCompatibility.ERROR]
            if not unfit:
                del self._mismatches[topic]
                continue
            policy, remedy = "reliability", "set qos_reliability alike on both sides"
            if qos.durability == KEPT and any(o.durability != KEPT for o in unfit):
                policy, remedy = "durability", "publish it transient local"
            texts.append(
                f"a publisher of '{topic}' has another {policy} and exchanges no data with this "
                f"node: {remedy}"
            )
        self._tell("qos_mismatch", "; ".join(texts), WARN)

    def _report_other_types(self) -> None:
        """Name publishers of another type than the node reads: the middleware connects none."""
        types = dict(self._node.get_topic_names_and_types())
        texts = set()
        for subscription in self._node.subscriptions:
            kind: Any = subscription.msg_type
            topic = subscription.topic_name
            read = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
            if not set(types.get(topic, ())) - {read}:
                continue
            for info in self._node.get_publishers_info_by_topic(topic):
                if info.topic_type != read:
                    texts.add(
                        f"'{topic}' is published by {publisher_name(info)} as "
                        f"{info.topic_type}, and nothing of that is received: publish {read}"
                    )
        self._tell(OTHER_TYPE, "; ".join(sorted(texts)), WARN)

    def _report_namesake(self) -> None:
        """Report another node of this name, which answers the same requests, by its heartbeat."""
        own = self._node.get_fully_qualified_name()
        heartbeat = self._node.resolve_topic_name("heartbeat")
        text = ""
        if self._lasts_twice(
            heartbeat, [n for n in self._node.publishers_of(heartbeat) if n == own]
        ):
            text = (
                f"another {own} runs, and either answers requests: end one, or give it another "
                "namespace"
            )
        self._tell("namesake", text, ERROR)

    def _report_second_publishers(self) -> None:
        """Report other publishers of the node's streams: whoever reads them mixes both."""
        others: set[str] = set()
        for publisher in self.published:
            if self._node.count_publishers(publisher.topic_name) > 1:
                others |= self._other_publishers(publisher.topic_name)
            else:
                self._shared_since.pop(publisher.topic_name, None)
        text = ""
        if others:
            text = (
                f"also published by {', '.join(sorted(others))}: readers mix both; end one, or "
                "give it another namespace"
            )
        self._tell("second_publisher", text, ERROR)

    def _report_mixed_inputs(self) -> None:
        """Report topics that the node reads and several publish."""
        mixed = []
        for topic, mixes in self.read.items():
            several = self._node.count_publishers(topic) > 1  # costs less
            names = self._node.publishers_of(topic) if several else []
            if len(set(names)) > 1 or self._lasts_twice(topic, names):
                who = "this node mixes" if mixes() else "readers in other processes mix"
                mixed.append(f"{topic} is published by {' and '.join(sorted(names))}: {who} them")
        if mixed:
            mixed.append("end one, or give it another topic")
        self._tell(MIXED_INPUT, "; ".join(mixed), WARN)

    def _report_unreadable(self) -> None:
        """Report messages that could not be read, until none have come for a while."""
        found, now = self.unreadable.copy(), time.monotonic()
        if not found:
            return
        if found != self._unreadable_told[0]:
            self._unreadable_told = found, now
        notes = self._node.healths[0].notes
        notes["unreadable"] = ", ".join(f"{topic} {n}" for (topic, _), n in found.items())
        texts = [
            f"messages on '{topic}' cannot be read ({n} so far): is its publisher built with "
            f"another version of {package}, or does it not send plain CDR?"
            for (topic, package), n in found.items()
        ]
        recent = now - self._unreadable_told[1] < REMEMBERED
        self._tell("unreadable", "; ".join(texts) if recent else "", WARN)

    def _report_clock(self) -> None:
        """Report a simulated time that does not begin; it may wait for the node to be active."""
        now, text = time.monotonic(), ""
        simulated = self._node.get_parameter("use_sim_time").value
        if not (simulated and self._node.active) or self._node.get_clock().now().nanoseconds:
            self._timeless_since = None
        elif self._timeless_since is None:
            self._timeless_since = now
        elif now - self._timeless_since > PATIENCE:
            text = (
                "use_sim_time is true, and no time comes on /clock: start what publishes it, or "
                "set use_sim_time to false"
            )
        self._tell("no_clock", text, WARN)

    def _tell(self, key: str, text: str, level: int) -> None:
        """Report a fault of the node, none where the text is empty."""
        health = self._node.healths[0]
        if text:
            self._node.log_fault(health, key, text, level)
        else:
            health.recovered(key)

    def _other_publishers(self, topic: str) -> set[str]:
        """Topic and node of publishers of a stream of this node that are not this node's."""
        names = self._node.publishers_of(topic)
        own = self._node.get_fully_qualified_name()
        found = {f"{name} ({topic})" for name in names if name != own}
        if self._lasts_twice(topic, [name for name in names if name == own]):
            found.add(f"another {own} ({topic})")
        return found

    def _lasts_twice(self, topic: str, names: list[str]) -> bool:
        """Whether there have been several publishers, of one name, for a while: at first it may be
        what is left of a node that was killed and is now running again."""
        if len(names) < 2:
            self._shared_since.pop(topic, None)
            return False
        now = time.monotonic()
        return now - self._shared_since.setdefault(topic, now) > REMEMBERED
