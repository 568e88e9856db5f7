# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which lifecycle node to configure or activate next, so that a suite comes up in order. No ROS.

Groups come up one after the other. A group may begin when all nodes of the groups before it are
active, or when `patience` has passed since the group before it began: a device that is not plugged
in must not hold up the rest. A node that refuses is tried again after `retry`. A node that was
restarted is unconfigured, and is brought up again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

UNCONFIGURED, INACTIVE, ACTIVE = 1, 2, 3
"""Primary states, numbered as in lifecycle_msgs/State."""

CONFIGURE, ACTIVATE = 1, 3
"""Transitions, numbered as in lifecycle_msgs/Transition."""

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
                if now < self._not_before.get(node, now):
                    continue
                if states.get(node) == UNCONFIGURED:
                    wanted.append((node, CONFIGURE))
                elif states.get(node) == INACTIVE:
                    wanted.append((node, ACTIVATE))
            if self.missing(states, group) and now - began < self.patience:
                break
        return wanted

    def failed(self, node: str, now: float) -> None:
        """A transition was refused; it is tried again later."""
        self._not_before[node] = now + self.retry

    def missing(self, states: Mapping[str, int], of: Sequence[str] | None = None) -> list[str]:
        """Nodes that are not active, among all or those given."""
        return [n for n in (self.nodes if of is None else of) if states.get(n) != ACTIVE]
