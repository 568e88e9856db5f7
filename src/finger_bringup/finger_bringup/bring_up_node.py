# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node that brings the lifecycle nodes of the suite up in order and keeps them up.

A node that refuses or is restarted is configured and activated again; `/diagnostics` names the
nodes that are not active. A node that somebody deactivates, cleans up or shuts down is left alone
until they activate it again.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from finger_common.diagnostics import ERROR, STARTING, WARN, Health
from finger_common.node import HEARTBEAT, ManagedNode, main_of
from finger_common.settings import Settings, setting

from .bring_up import (
    ACTIVE,
    ALL_ACTIVE,
    CONFIGURE,
    FINALIZED,
    INACTIVE,
    UNCONFIGURED,
    BringUp,
)

STATE_TIMEOUT = 5.0
"""s without an answer after which a node's state is unknown: it was killed, or is not there."""
NEWS = 10.0
"""s between lines that name the nodes that are waited for."""
_STATES = {UNCONFIGURED: "unconfigured", INACTIVE: "inactive"}
STEP = 0.25
"""s between looks at the nodes."""
TURN = 1.0
"""s between questions to one of the active nodes whose heart beats, in turn: every question costs
two rounds of rclpy's executor, a millisecond or more beside the samples of a hand."""
UNHEARD = 2.5 * HEARTBEAT
"""s without a sign of life after which an active node is asked for its state: it may have been
restarted, or be no node of the suite."""
SILENT_AFTER = 1.25
"""s without a sign of life after which a node is reported as silent."""


def _namespace(node: str) -> str:
    """What stands before the last part of a node's name, with its slash."""
    return node[: node.rfind("/") + 1]


@dataclass(frozen=True)
class BringUpSettings(Settings):
    """Parameters of the node."""

    order: list = setting(
        ["force camera moisture", "vision model"],
        "Names of the nodes, one group a line, in the order of their coming up.",
    )
    patience: float = setting(
        10.0,
        "How long a group waits for the one before it, which may lack a device.",
        "s",
        0.0,
        600.0,
    )
    retry: float = setting(5.0, "Time until a node that refused is tried again.", "s", 0.1, 600.0)
    answer_timeout: float = setting(
        60.0,
        "Longest wait for a transition; compiling kernels at the first start takes a while.",
        "s",
        1.0,
        600.0,
    )


@dataclass(eq=False)
class _Node:
    """One of the nodes that are brought up: how it is asked, and what is known of it."""

    name: str
    get_state: Any
    change_state: Any
    transitions: Any
    """Polled subscription to the transitions that it reports."""
    state: int | None = None
    """Primary state, None while it is unknown."""
    last_sign: float | None = None
    """Time of its last answer or heartbeat, None before it ever answered."""
    asked: float = -math.inf
    """Time of the last question for its state."""
    question: tuple[float, Any] | None = None
    """The question that has no answer yet: its time and future."""
    change: tuple[float, Any] | None = None
    """The transition that was requested and has no answer yet: its time and future."""

    def is_silent(self, seconds: float, now: float) -> bool:
        """Whether it has answered once, and given no sign of life for so many s."""
        return self.last_sign is not None and now - self.last_sign > seconds


class BringUpNode(ManagedNode):
    """Configures and activates other nodes."""

    SETTINGS = (BringUpSettings,)
    NAME = "bring_up"

    def configure(self) -> None:
        settings = self.settings(BringUpSettings)
        self._health = Health("lifecycle")
        self.healths = [self._health]
        groups = [line.split() for line in settings.order]
        self._answer_timeout = settings.answer_timeout
        self._bring_up = BringUp(groups, settings.patience, settings.retry)
        names = self._bring_up.nodes
        depth = QoSProfile(depth=100)
        self._nodes = {
            name: _Node(
                name,
                self.create_client(GetState, f"{name}/get_state"),
                self.create_client(ChangeState, f"{name}/change_state"),
                self.create_polled_subscription(
                    TransitionEvent, f"{name}/transition_event", depth, overridable=False
                ),
            )
            for name in names
        }
        self._beating = {
            space: self.create_polled_subscription(
                String, f"{space}heartbeat", depth, overridable=False
            )
            for space in {_namespace(name) for name in names}
        }
        self._complete = self._begun = False
        self._told = time.monotonic()

    def activate(self) -> None:
        self.create_steady_timer(STEP, self._step)

    def deactivate(self) -> None:
        self.destroy_active_interfaces()

    @property
    def _states(self) -> dict[str, int]:
        """Primary state of each node whose state is known."""
        return {n.name: n.state for n in self._nodes.values() if n.state is not None}

    def _step(self) -> None:
        now = time.monotonic()
        nodes = self._nodes.values()
        unheard = {node for node in nodes if node.is_silent(UNHEARD, now)}
        moved = self._hear(now)
        well = [node for node in nodes if node.state == ACTIVE and node not in unheard | moved]
        well.sort(key=lambda node: node.asked)
        asked = max((node.asked for node in well), default=-math.inf)
        later = set(well[1:] if now - asked >= TURN else well)
        for node in nodes:
            # A node that does not answer may have changed: on a busy machine replies get lost.
            if node not in later and (node.change is None or now - node.change[0] > STATE_TIMEOUT):
                self._request_state(node, now)
        self._advance(now)
        for node in nodes:
            if node.change is not None and now - node.change[0] > self._answer_timeout:
                self._forget_change(node)
        self._report()
        self._report_silent(now)

    def _hear(self, now: float) -> set[_Node]:
        """Take in heartbeats and transitions that came; nodes that somebody else changed."""
        for space, beating in self._beating.items():
            for message in beating.messages():
                node = self._nodes.get(space + message.data)
                if node is not None and node.last_sign is not None:
                    node.last_sign = now
        reporting = [node for node in self._nodes.values() if list(node.transitions.take())]
        moved = {node for node in reporting if node.change is None}
        for node in moved:
            self._bring_up.moved(node.name, now)
        return moved

    def _advance(self, now: float) -> None:
        """Request the transitions that are due."""
        for name, transition in self._bring_up.steps(self._states, now):
            node = self._nodes[name]
            # A service that was not discovered yet would never hear the request.
            if node.change is None and node.change_state.service_is_ready():
                self._change(node, transition, now)

    def _request_state(self, node: _Node, now: float) -> None:
        if node.is_silent(STATE_TIMEOUT, now):
            node.state = None
        if node.question is not None:
            since, future = node.question
            if now - since > STATE_TIMEOUT:
                future.cancel()
                node.question = None
            return
        if not node.get_state.service_is_ready():
            return
        future = node.get_state.call_async(GetState.Request())
        node.question = (now, future)
        node.asked = now

        def answered(done: Any) -> None:
            if not done.cancelled():
                node.question = None
                # A transition that the node reported came before this answer.
                self._hear(time.monotonic())
                node.last_sign = answered_at = time.monotonic()
                node.state = state = done.result().current_state.id
                self._bring_up.answered(node.name, state, now, answered_at)
                if state in (UNCONFIGURED, INACTIVE, ACTIVE):
                    # Asked long after the transition was requested: it ended, or never began.
                    self._forget_change(node)
                self._advance(time.monotonic())

        future.add_done_callback(answered)

    def _change(self, node: _Node, transition: int, now: float) -> None:
        target = INACTIVE if transition == CONFIGURE else ACTIVE
        future = node.change_state.call_async(
            ChangeState.Request(transition=Transition(id=transition))
        )
        node.change = (now, future)
        # An answer from before the change is no state of the time after it.
        node.state = None
        if node.question is not None:
            node.question[1].cancel()
            node.question = None

        def answered(done: Any) -> None:
            if done.cancelled():
                return
            node.change = None
            node.last_sign = now = time.monotonic()
            if done.result().success:
                node.state = target
                self._bring_up.answered(node.name, target, now, now)
            else:
                self._bring_up.failed(node.name, now)
            self._advance(now)

        future.add_done_callback(answered)

    def _forget_change(self, node: _Node) -> None:
        """Wait no longer for the answer to a transition."""
        if node.change is not None:
            node.change[1].cancel()
            node.change = None

    def _report(self) -> None:
        taken_down = self._bring_up.taken_down
        waiting = [
            f"{node} ({_STATES.get(state, 'changing')})"
            for node, state in taken_down.items()
            if state != FINALIZED
        ]
        ended = [node for node, state in taken_down.items() if state == FINALIZED]
        missing = self._bring_up.missing(self._states)
        refused = [node for node in missing if node in self._bring_up.refused]
        self._warn_of(
            "taken_down", "not active by request", waiting, "left so until activated again"
        )
        self._warn_of(
            "shut_down", "shut down", ended, "restart its process (with --compose: the whole one)"
        )
        self._warn_of("refused", "refused", refused, "the diagnostics of each say why")
        self._tell_starting(missing)
        if not missing:
            self._health.recovered("not_active")
            if not self._complete and not taken_down:
                self._complete = True
                self.get_logger().info(f"{ALL_ACTIVE}: {', '.join(self._bring_up.nodes)}")
        elif not self._complete:
            self._tell(missing)
        else:
            # A node's state is unknown while it changes and until it answers after that.
            now = time.monotonic()
            lost = [
                node.name
                for node in (self._nodes[name] for name in missing)
                if node.change is None
                and (node.state is not None or node.is_silent(STATE_TIMEOUT, now))
            ]
            if lost:
                self._complete = False
                self.log_fault(self._health, "not_active", f"not active: {', '.join(lost)}", WARN)

    def _warn_of(self, key: str, what: str, nodes: list[str], remedy: str) -> None:
        """Name the nodes of which it is true, as long as there are any."""
        if nodes:
            self.log_fault(self._health, key, f"{what}: {', '.join(nodes)}; {remedy}", WARN)
        else:
            self._health.recovered(key)

    def _tell_starting(self, missing: list[str]) -> None:
        """Name the nodes that are not up for the first time yet: they are no fault."""
        self._begun = self._begun or not missing
        if self._begun:
            self._health.activity = ""
            self._health.notes.pop(STARTING, None)
        else:
            self._health.activity = f"starting: {', '.join(missing)}"
            self._health.notes[STARTING] = " ".join(missing)

    def _tell(self, missing: list[str]) -> None:
        """Say now and then what is waited for, so that a slow start is no riddle."""
        now = time.monotonic()
        if now - self._told >= NEWS:
            self._told = now
            self.get_logger().info(f"waiting for: {', '.join(missing)}")

    def _report_silent(self, now: float) -> None:
        """Name nodes that do not answer, at once: they cannot report it themselves."""
        silent = [
            node.name
            for node in self._nodes.values()
            if node.is_silent(SILENT_AFTER, now) and node.change is None
        ]
        text = f"no answer from: {', '.join(silent)}"
        new = silent and self._health.faults.get("silent") != text
        if silent:
            self.log_fault(self._health, "silent", text, ERROR)
        if new or (not silent and self._health.recovered("silent")):
            self.publish_diagnostics()


main = main_of(BringUpNode)

if __name__ == "__main__":
    main()
