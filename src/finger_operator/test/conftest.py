# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of these tests; the helpers of this folder are importable by name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from study_rig import Rig


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """A session that has begun, before its first trial."""
    rig = Rig(tmp_path / "session")
    rig.run(0.5)
    rig.protocol.start(rig.now)
    return rig
