# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of these tests: files to import."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from import_files import ABOUT, FRAMES, TIME, area_at, csv, force_at


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Settings that name a force and an area file as the contract has them."""
    return {
        "force": csv(tmp_path / "force.csv", "time_s,force_n", TIME, force_at(TIME)),
        "area": csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area_at(FRAMES)),
        **ABOUT,
    }
