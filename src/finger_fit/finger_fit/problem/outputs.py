# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a model gives for trials: areas at their frames, and indentations where they were
measured."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from finger_common.errors import InputError

from .trials import FitTrial

_batch_lock = threading.Lock()
"""The compiled kernels of a batch share one pool of threads and do not nest."""


def batch_areas(
    model: Any, parameters: np.ndarray, drives: Sequence[tuple[np.ndarray, ...]]
) -> list[np.ndarray]:
    """`AreaModel.batch` of a model, one call at a time."""
    with _batch_lock:
        return model.batch(parameters, drives)


def batch_contacts(
    model: Any, parameters: np.ndarray, drives: Sequence[tuple[np.ndarray, ...]]
) -> list[np.ndarray]:
    """Areas and indentations (2, P, f) of each trial, as `ReducedModel.contacts` gives them, one
    call at a time; raises InputError for a model without indentations."""
    if not hasattr(model, "contacts"):
        raise InputError(
            "the trials have a measured indentation, but the model gives none; leave it out with "
            "indentation_sd=0"
        )
    with _batch_lock:
        return model.contacts(parameters, drives)


def trial_outputs(
    model: Any, parameters: np.ndarray, trials: Sequence[FitTrial]
) -> list[np.ndarray]:
    """Areas in m² at the frames of each trial, then its indentations in m: (P, k + q) per trial.

    parameters (P, D). Raises InputError for a model without indentations where they are needed.
    """
    if not any(len(t.indentation) for t in trials):
        return batch_areas(model, parameters, [t.drive.to_model(t.frames) for t in trials])
    rows = [np.union1d(t.frames, t.drive.indentation_rows) for t in trials]
    drives = [t.drive.to_model(wanted) for t, wanted in zip(trials, rows)]
    found = batch_contacts(model, parameters, drives)
    return [
        np.concatenate(
            [
                areas[:, np.searchsorted(wanted, t.frames)],
                indentations[:, np.searchsorted(wanted, t.drive.indentation_rows)],
            ],
            axis=1,
        )
        for t, wanted, (areas, indentations) in zip(trials, rows, found)
    ]


def in_rows(parts: Sequence[np.ndarray], trials: Sequence[FitTrial]) -> np.ndarray:
    """Rows (…, n + q) of parts as of `trial_outputs`: the areas of all trials, then their
    indentations."""
    areas = [part[..., : len(t.frames)] for part, t in zip(parts, trials)]
    indentations = [part[..., len(t.frames) :] for part, t in zip(parts, trials)]
    return np.concatenate([*areas, *indentations], axis=-1)


def slope_between(ends: np.ndarray, middle: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Slope (…, n) of a model's outputs by differences, from those above and below: ends (2, …, n),
    at steps (2, …) from the middle (n,). To one side where the model cannot carry the load on the
    other, zero where it can on neither."""
    usable = np.isfinite(ends) & np.isfinite(middle)
    ends = np.where(usable, ends, np.where(np.isfinite(middle), middle, 0.0))
    span = (steps[..., None] * usable).sum(axis=0)
    return (ends[0] - ends[1]) / np.where(span > 0.0, span, 1.0)
