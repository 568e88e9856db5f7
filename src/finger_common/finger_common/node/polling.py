# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streams that a node reads when it needs them, without a callback for each message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from ..errors import InputError


class _NeverExecuted(CallbackGroup):
    """Group of entities that the executor leaves alone."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


POLLED_DEPTH = 200
"""Smallest number of samples that a polled stream keeps: it is read every 50 ms or so."""


class PolledSubscription:
    """Subscription whose messages a node reads when it needs them.

    For streams that need no immediate answer: a round of the executor costs far more than reading a
    message. QoS events are polled, too: Fast DDS wakes a wait for them again and again while
    messages are unread, which would keep a core busy.

    unreadable: counts messages that cannot be read, by topic and package of its type.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        qos: QoSProfile,
        unreadable: Counter[tuple[str, str]] | None = None,
        **options: Any,
    ) -> None:
        self.topic = topic
        self.qos = qos
        self._node = node
        self._type = message_type
        self.subscription = node.create_subscription(
            message_type,
            topic,
            lambda message: None,
            qos,
            callback_group=_NeverExecuted(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            **options,
        )
        package = message_type.__module__.partition(".")[0]
        self._source = self.subscription.topic_name, package
        self._unreadable = Counter() if unreadable is None else unreadable
        self._events: dict[QoSSubscriptionEventType, Any] = {}
        for kind in (
            QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
            QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
        ):
            # Not every middleware has both events.
            with suppress(UnsupportedEventTypeError):
                handle = rclpy_implementation.EventHandle(self.subscription.handle, kind)
                self._events[kind] = handle

    @property
    def handle(self) -> Any:
        """The middleware's subscription."""
        return self.subscription.handle

    def take(self) -> Iterator[tuple[bytes, dict[str, Any]]]:
        """Messages received since the last call, serialized, with their times.

        The mapping holds the middleware's `received_timestamp` and `source_timestamp` in ns.
        """
        while True:
            with self.subscription.handle:
                taken = self.subscription.handle.take_message(self._type, True)
            if taken is None:
                return
            yield taken

    def messages(self) -> Iterator[Any]:
        """Messages received since the last call, without those that cannot be read."""
        for raw, _ in self.take():
            if (message := self.read(raw)) is not None:
                yield message

    def read(self, raw: bytes, how: Callable[[bytes], Any] | None = None) -> Any:
        """A serialized message, or what `how` reads of it; None, and counted, where it cannot be
        read, as of a publisher that has another definition of the type.

        how: raises InputError for what it cannot read.
        """
        try:
            return deserialize_message(raw, self._type) if how is None else how(raw)
        except (InputError, rclpy_implementation.RMWError):
            self._unreadable[self._source] += 1
            return None

    def new_mismatches(self) -> int:
        """Publishers found since the last call whose QoS does not fit."""
        return self._new(QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS)

    def newly_lost(self) -> int:
        """Messages that the middleware lost since the last call."""
        return self._new(QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST)

    def _new(self, kind: QoSSubscriptionEventType) -> int:
        handle = self._events.get(kind)
        if handle is None:
            return 0
        with handle:
            event = handle.take_event()
        return max(event.total_count_change, 0) if event is not None else 0

    def destroy(self) -> None:
        """End the subscription."""
        for handle in self._events.values():
            handle.destroy_when_not_in_use()
        self._node.destroy_subscription(self.subscription)
