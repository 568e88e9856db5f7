# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Quality of service of streams and of latched topics."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

AUTO, RELIABLE, BEST_EFFORT = "auto", "reliable", "best_effort"
"""Values of `qos_reliability`."""


def stream_qos(reliability: str, depth: int, publisher: bool) -> QoSProfile:
    """QoS of a data stream.

    AUTO publishes reliably and subscribes with best effort, as REP 2003 has it for sensor data:
    each matches whatever the other side wants.
    """
    reliable = publisher if reliability == AUTO else reliability == RELIABLE
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


LATCHED_QOS = QoSProfile(
    depth=10,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""QoS of `moisture`, and of readers of `model_events` and `trial`.

Late joiners receive the messages published before: a recorder that starts after the model records
the events that determine the model's state."""

EVENTS_QOS = QoSProfile(
    depth=200,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""QoS of the publisher of `model_events`: none may be lost, and late areas make bursts of them."""

STATE_QOS = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""QoS of publishers of a state, `trial` and `protocol/status`: late joiners receive the newest."""
