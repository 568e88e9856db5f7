"""Which lifecycle node to configure or activate next, so that a suite comes up in order and stays up. No ROS.

Groups come up one after the other: a group may begin when all nodes of the groups before it are active, or when
`patience` has passed since the one before it began (a device that is not plugged in must not hold up the rest). A
node that fails is tried again after `retry`; a node that was restarted is unconfigured again and is brought up again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

UNCONFIGURED, INACTIVE, ACTIVE = 1, 2, 3
"""Primary states, numbered as in lifecycle_msgs/State."""

ALL_ACTIVE = "all nodes are active"
"""Begins the line that says so; launch files wait for it."""

CONFIGURE, ACTIVATE = 1, 3
"""Transitions, numbered as in lifecycle_msgs/Transition."""


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
        """(node, transition) to request now. states: primary state by node, left out where a node does not answer."""
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
            waiting = any(states.get(node) != ACTIVE for node in group)
            if waiting and now - began < self.patience:
                break
        return wanted

    def failed(self, node: str, now: float) -> None:
        """A transition was refused; it is tried again later."""
        self._not_before[node] = now + self.retry

    def missing(self, states: Mapping[str, int]) -> list[str]:
        """Nodes that are not active."""
        return [node for node in self.nodes if states.get(node) != ACTIVE]
