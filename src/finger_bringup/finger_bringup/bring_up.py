# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which lifecycle node to configure or activate next, so that a suite comes up in order. No ROS.

Groups come up one after the other. A group may begin when all nodes of the groups before it are
active, or when `patience` has passed since the group before it began: a device that is not plugged
in must not hold up the rest. A node that refuses is tried again after `retry`. A node that was
restarted is unconfigured, and is brought up again. One that somebody else deactivates, cleans up or
shuts down is left to them until it is active again; only a new process follows a shutdown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = 1, 2, 3, 4
"""Primary states, numbered as in lifecycle_msgs/State."""

CONFIGURE, ACTIVATE = 1, 3
"""Transitions, numbered as in lifecycle_msgs/Transition."""

QUICKEST_RESTART = 0.6
"""s: a node that ends and runs again takes longer, by its imports and the pause before it."""

ALL_ACTIVE = "all nodes are active"
"""Begins the line of `bring_up` that launch files and tests wait for."""


class BringUp:
    """groups: node names in the order of their coming up. patience, retry: s."""

    def __init__(
        self, groups: Sequence[Sequence[str]], patience: float = 10.0, retry: float = 5.0
    ) -> None:
        self.groups = [list(group) for group in groups if group]
        self.patience = patience
        self.retry = retry
        self._began: list[float | None] = [None] * len(self.groups)
        self._not_before: dict[str, float] = {}
        self.refused: set[str] = set()
        """Nodes that refused a transition and have not been active since."""
        self._seen: dict[str, float] = {}
        """Time of the last answer of each node that has been active, or shut down, since it was
        started."""
        self._moved: dict[str, float] = {}
        """Time of the last transition that each node reported, until its state is known."""
        self.taken_down: dict[str, int] = {}
        """State of each node that somebody else took down."""

    @property
    def nodes(self) -> list[str]:
        """All nodes in order."""
        return [node for group in self.groups for node in group]

    def steps(self, states: Mapping[str, int], now: float) -> list[tuple[str, int]]:
        """(node, transition) to request now. states: primary state of each node that answers."""
        wanted = []
        for number, group in enumerate(self.groups):
            began = self._began[number]
            if began is None:
                began = self._began[number] = now
            for node in group:
                if now < self._not_before.get(node, now) or node in self.taken_down:
                    continue
                if states.get(node) == UNCONFIGURED:
                    wanted.append((node, CONFIGURE))
                elif states.get(node) == INACTIVE:
                    wanted.append((node, ACTIVATE))
            if self.missing(states, group) and now - began < self.patience:
                break
        return wanted

    def moved(self, node: str, now: float) -> None:
        """Note that a node reports a transition of its own: it runs, and was not restarted."""
        self._moved[node] = now

    def answered(self, node: str, state: int, asked: float, now: float) -> None:
        """Note the state that a node gives `now` in answer to a question of the time `asked`.

        A question that was asked shortly after the answer before reached the same process, so that
        a state below ACTIVE is somebody's wish; so it is after a transition that the node reported.
        A restarted node reports none, and answers later questions only.
        """
        if state in (ACTIVE, FINALIZED):
            self.refused.discard(node)
        if state == ACTIVE:
            self._seen[node] = now
            self.taken_down.pop(node, None)
            if asked >= self._moved.get(node, math.inf):
                del self._moved[node]
        elif state == FINALIZED or node in self._seen:
            reported = self._moved.pop(node, None) is not None
            soon = asked - self._seen.get(node, now) < QUICKEST_RESTART
            ended = self.taken_down.get(node) == FINALIZED
            if state == FINALIZED or (not ended and (state == INACTIVE or reported or soon)):
                self._seen[node] = now
                self.taken_down[node] = state
            else:
                del self._seen[node]
                self.taken_down.pop(node, None)

    def failed(self, node: str, now: float) -> None:
        """A transition was refused; it is tried again later."""
        self._not_before[node] = now + self.retry
        self.refused.add(node)

    def missing(self, states: Mapping[str, int], of: Sequence[str] | None = None) -> list[str]:
        """Nodes that should be active and are not, among all or those given."""
        return [
            n
            for n in (self.nodes if of is None else of)
            if states.get(n) != ACTIVE and n not in self.taken_down
        ]
