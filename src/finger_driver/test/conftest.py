# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of the driver tests; the helpers of this folder are importable by name."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from device_process import Observer

from finger_driver.simulators.netft import NetFtOptions, NetFtSimulator


@pytest.fixture
def box() -> Iterator[NetFtSimulator]:
    """A box in this process."""
    simulator = NetFtSimulator(NetFtOptions(port=0, http_port=0)).start()
    yield simulator
    simulator.stop()


@pytest.fixture
def observer(ros_domain: int) -> Iterator[Observer]:
    """A node in this process, in a domain of the test's own."""
    observer = Observer(ros_domain)
    yield observer
    observer.close()
