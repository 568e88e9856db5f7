"""The example that turns the wrench of a sensor at an angle."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest


def test_a_press_along_the_leaning_normal_comes_out_along_z(
    module_of: Callable[[str], Any],
) -> None:
    turned = module_of("examples/turn_wrench.py").turned
    angle = math.radians(20.0)
    normal = 0.0, math.sin(angle), math.cos(angle)
    assert turned(normal, angle) == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    assert turned((0.3, 0.0, 0.0), angle) == pytest.approx((0.3, 0.0, 0.0))
