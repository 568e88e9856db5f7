# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The base of every node of the suite, over rclpy.

`managed`: the lifecycle node with described parameters, diagnostics and autostart. `polling`:
streams that a node reads when it needs them. `waiting`: streams that the nodes of a process wait
for in one thread. `heartbeat`: the heartbeats of these nodes. `jobs`: what other threads let a node
do in its own. `local`: samples between nodes of one process. `serialized`: messages as bytes.
`qos`: quality of service of latched topics. `stream_watch`: what other nodes do to a node's
streams. `parameter_requests`: setting another node's parameters. `running`: a node as a process.
"""

from .fields import message_of
from .heartbeat import HEARTBEAT
from .jobs import Jobs
from .local import LocalPublisher, LocalSubscription
from .managed import FrameSettings, ManagedNode, NodeSettings
from .parameter_requests import refusal_of, set_request
from .polling import POLLED_DEPTH, PolledSubscription
from .qos import EVENTS_QOS, LATCHED_QOS, STATE_QOS
from .running import begin_ros, main_of, run_node, use_large_shared_memory
from .serialized import FixedMessage, Listeners
from .waiting import WaitedSubscription

__all__ = [
    "EVENTS_QOS",
    "HEARTBEAT",
    "LATCHED_QOS",
    "POLLED_DEPTH",
    "STATE_QOS",
    "FixedMessage",
    "FrameSettings",
    "Jobs",
    "Listeners",
    "LocalPublisher",
    "LocalSubscription",
    "ManagedNode",
    "NodeSettings",
    "PolledSubscription",
    "WaitedSubscription",
    "begin_ros",
    "main_of",
    "message_of",
    "refusal_of",
    "run_node",
    "set_request",
    "use_large_shared_memory",
]
