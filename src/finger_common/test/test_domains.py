# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A ROS domain is free when no process listens on its discovery port."""

import socket

import pytest

from finger_common.domains import free_domain, is_free
from finger_common.errors import FingerError


def test_a_domain_with_a_listener_is_not_given_out() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        domain = free_domain()
        listener.bind(("", 7400 + 250 * domain + 10))
        assert not is_free(domain)
        with pytest.raises(FingerError, match=f"from {domain} to {domain} is free"):
            free_domain([domain])
