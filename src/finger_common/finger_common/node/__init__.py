"""The base of every node of the suite, over rclpy.

`managed`: the lifecycle node with described parameters, diagnostics and autostart. `polling`:
streams that a node reads when it needs them. `qos`: quality of service of latched topics.
`running`: a node as a process.
"""

from .managed import ManagedNode, NodeSettings
from .polling import POLLED_DEPTH, PolledSubscription
from .qos import LATCHED_QOS, STATE_QOS
from .running import main_of, run_node, use_large_shared_memory

__all__ = [
    "LATCHED_QOS",
    "POLLED_DEPTH",
    "STATE_QOS",
    "ManagedNode",
    "NodeSettings",
    "PolledSubscription",
    "main_of",
    "run_node",
    "use_large_shared_memory",
]
