"""Node that brings the lifecycle nodes of a launch file up in order and keeps them up; shell over `bring_up.BringUp`.

A node that a launch file restarts begins unconfigured; it is configured and activated again, and /diagnostics says
which nodes are not active.
"""

from __future__ import annotations

import time
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.clock import Clock, ClockType

from finger_common.diagnostics import WARN, Health
from finger_common.node import ManagedNode, main_of
from finger_common.parameters import Parameter, ParameterTable

from .bring_up import ACTIVE, ALL_ACTIVE, BringUp

PARAMETERS = ParameterTable(
    Parameter(
        "order",
        ["force camera moisture", "vision model"],
        "Names of the nodes, one group a line, in the order of their coming up.",
    ),
    Parameter(
        "patience",
        10.0,
        "How long a group waits for the one before it; a device that is not there must not hold up the rest.",
        "s",
        0.0,
        600.0,
    ),
    Parameter("retry", 5.0, "Time until a node that refused is tried again.", "s", 0.1, 600.0),
    Parameter(
        "answer_timeout",
        60.0,
        "Longest wait for a transition; compiling kernels at the first start takes a while.",
        "s",
        1.0,
        600.0,
    ),
)

STATE_TIMEOUT = 5.0
"""s to wait for a node's state; a node that was killed does not answer."""


class BringUpNode(ManagedNode):
    """Configures and activates other nodes."""

    TABLE = PARAMETERS
    NAME = "bring_up"

    def configure(self) -> None:
        values = self.values
        self._health = Health("lifecycle")
        self.healths = [self._health]
        groups = [line.split() for line in values["order"]]
        self._bring_up = BringUp(groups, values["patience"], values["retry"])
        nodes = self._bring_up.nodes
        self._state_clients = {n: self.create_client(GetState, f"{n}/get_state") for n in nodes}
        self._change_clients = {
            n: self.create_client(ChangeState, f"{n}/change_state") for n in nodes
        }
        self._states: dict[str, int] = {}
        self._asked: dict[str, tuple[float, Any]] = {}
        self._changing: dict[str, tuple[float, Any]] = {}
        self._complete = False

    def activate(self) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(0.25, self._look, clock=steady)

    def deactivate(self) -> None:
        self.destroy_timer(self._timer)

    def _look(self) -> None:
        now = time.monotonic()
        for node, client in self._state_clients.items():
            if node not in self._changing:
                self._ask_state(node, client, now)
        for node, transition in self._bring_up.steps(self._states, now):
            if node not in self._changing:
                self._change(node, transition, now)
        for node, (since, future) in list(self._changing.items()):
            if now - since > self.values["answer_timeout"]:
                future.cancel()
                del self._changing[node]
        self._tell()

    def _ask_state(self, node: str, client: Any, now: float) -> None:
        pending = self._asked.get(node)
        if pending is not None:
            if now - pending[0] > STATE_TIMEOUT:
                pending[1].cancel()
                del self._asked[node]
                self._states.pop(node, None)
            return
        if not client.service_is_ready():
            self._states.pop(node, None)
            return
        future = client.call_async(GetState.Request())
        self._asked[node] = (now, future)

        def answered(done: Any) -> None:
            if not done.cancelled():
                self._asked.pop(node, None)
                self._states[node] = done.result().current_state.id

        future.add_done_callback(answered)

    def _change(self, node: str, transition: int, now: float) -> None:
        future = self._change_clients[node].call_async(
            ChangeState.Request(transition=Transition(id=transition))
        )
        self._changing[node] = (now, future)
        # What was known before the change, or is being asked now, says nothing about the time after it.
        del self._states[node]
        asked = self._asked.pop(node, None)
        if asked is not None:
            asked[1].cancel()

        def answered(done: Any) -> None:
            if done.cancelled():
                return
            self._changing.pop(node, None)
            if not done.result().success:
                self._bring_up.failed(node, time.monotonic())

        future.add_done_callback(answered)

    def _tell(self) -> None:
        missing = [n for n in self._bring_up.missing(self._states) if n not in self._changing]
        known = {n for n, state in self._states.items() if state == ACTIVE}
        if len(known) == len(self._bring_up.nodes):
            self._health.recovered()
            if not self._complete:
                self._complete = True
                self.get_logger().info(f"{ALL_ACTIVE}: {', '.join(self._bring_up.nodes)}")
        elif missing and self._complete:
            # A state that is just being asked for is not known for a moment; only silence counts.
            gone = [n for n in missing if n in self._states or n not in self._asked]
            if gone:
                self._complete = False
                self.log_fault(self._health, "not_active", f"not active: {', '.join(gone)}", WARN)


main = main_of(BringUpNode)

if __name__ == "__main__":
    main()
