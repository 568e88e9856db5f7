# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of these tests: session bags as in the tests of finger_bag, and files to import."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "finger_bag" / "test"))

from import_files import ABOUT, FRAMES, TIME, area_at, csv, force_at
from session_bags import write_session


@pytest.fixture
def session(tmp_path: Path) -> Callable[..., Path]:
    """Function that writes a session bag into the test's folder."""

    def write(name: str = "session", **options: Any) -> Path:
        return write_session(tmp_path / name, **options)

    return write


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Settings that name a force and an area file as the contract has them."""
    return {
        "force": csv(tmp_path / "force.csv", "time_s,force_n", TIME, force_at(TIME)),
        "area": csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area_at(FRAMES)),
        **ABOUT,
    }
