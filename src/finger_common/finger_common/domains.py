# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ROS domains that no other program on this machine uses."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterable

from .errors import FingerError

DOMAINS = range(1, 101)
"""Domains whose ports lie below those that Linux assigns by itself."""


def is_free(domain: int) -> bool:
    """Whether the domain's discovery port is unused (RTPS: 7400 + 250 domain + 10)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


def free_domain(candidates: Iterable[int] = DOMAINS) -> int:
    """One of the candidates, at random, that is free; raises FingerError when none is."""
    candidates = list(candidates)
    random.SystemRandom().shuffle(candidates)
    for domain in candidates:
        if is_free(domain):
            return domain
    raise FingerError(
        f"no ROS domain from {min(candidates)} to {max(candidates)} is free; end other ROS "
        "programs on this machine"
    )
