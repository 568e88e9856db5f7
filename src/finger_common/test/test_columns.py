# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Columns of numbers and dates: what is taken, and what is refused with one sentence."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest

from finger_common.columns import column
from finger_common.errors import InputError


@pytest.mark.parametrize(
    ("values", "numbers"),
    [
        ([1, 2.5], [1.0, 2.5]),
        (3, [3.0]),
        (np.array([[1.0], [2.0]]), [1.0, 2.0]),
        (np.ma.masked_array([1.0, -999.0], [False, True]), [1.0, np.nan]),
        (np.array([0, 1_500_000], "M8[us]"), [0.0, 1.5]),
        (np.array([0, 1500], "m8[ms]"), [0.0, 1.5]),
        (np.ma.masked_array(np.array([1, 2], "m8[s]"), [True, False]), [np.nan, 2.0]),
        ([np.timedelta64(250, "ms"), np.timedelta64("NaT", "ms")], [0.25, np.nan]),
        ([timedelta(seconds=2)], [2.0]),
        ([datetime(1970, 1, 2)], [86400.0]),
    ],
)
def test_numbers_and_dates_are_taken(values: Any, numbers: list[float]) -> None:
    np.testing.assert_array_equal(column(values, "time"), numbers)


@pytest.mark.filterwarnings("error")
def test_dates_of_a_time_zone_are_brought_to_utc() -> None:
    east = timezone(timedelta(hours=2))
    dates = [datetime(1970, 1, 2, 2, 0, 0, 500_000, east), datetime(1970, 1, 2)]
    np.testing.assert_array_equal(column(dates, "time"), [86400.5, 86400.0])


@pytest.mark.parametrize("values", ["much", ["a"], [1j], {"a": 1}, (x for x in (1.0, 2.0))])
def test_other_things_are_refused(values: Any) -> None:
    with pytest.raises(InputError, match="force holds something else than numbers; convert it"):
        column(values, "force")


def test_a_table_is_no_column() -> None:
    with pytest.raises(InputError, match=r"force has shape \(3, 2\); give one column of it"):
        column(np.ones((3, 2)), "force")
