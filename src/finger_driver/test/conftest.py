# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of the driver tests; the helpers of this folder are importable by name."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from device_process import Observer


@pytest.fixture
def observer(ros_domain: int) -> Iterator[Observer]:
    """A node in this process, in a domain of the test's own."""
    observer = Observer(ros_domain)
    yield observer
    observer.close()
