# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers and dates as people hold them in Python: lists, NumPy arrays, columns of pandas."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np

from .errors import InputError
from .stamps import NANOSECONDS


def _utc(date: Any) -> Any:
    """A date without its time zone, which NumPy does not take; others as they are."""
    if isinstance(date, datetime) and date.tzinfo is not None:
        return date.astimezone(timezone.utc).replace(tzinfo=None)
    return date


def column(values: Any, name: str) -> np.ndarray:
    """Numbers (n,) of a list, an array, a masked array or a column of pandas, also of one column
    (n, 1) or one number; dates as s since 1970, spans of time as s. What is masked or no date is
    NaN. Raises InputError, with the name, for anything else."""
    kind = getattr(getattr(values, "dtype", None), "kind", "")
    if not kind and isinstance(values, (list, tuple)) and values:
        first = values[0]
        if isinstance(first, (datetime, np.datetime64)):
            kind, values = "M", [_utc(value) for value in values]
        elif isinstance(first, (timedelta, np.timedelta64)):
            kind = "m"
    try:
        if kind in ("M", "m"):
            unit = "datetime64[ns]" if kind == "M" else "timedelta64[ns]"
            # pandas brings dates of a time zone to UTC itself.
            dates = (
                values.to_numpy(unit) if hasattr(values, "to_numpy") else np.asarray(values, unit)
            )
            found = np.where(np.isnat(dates), np.nan, dates.astype(np.int64) / NANOSECONDS)
        elif kind == "c":
            raise TypeError
        else:
            found = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} holds something else than numbers; convert it") from None
    if isinstance(values, np.ma.MaskedArray):
        found = np.where(np.ma.getmaskarray(values), np.nan, found)
    if found.size != max(found.shape, default=1):
        raise InputError(f"{name} has shape {found.shape}; give one column of it")
    return found.reshape(-1)
