# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled Kalman filters of the model's error in area, corrected by measured areas.

With φ = ln(F / 1 N) the error is

    ln A_true − ln A_model = h x,    h = (1, φ, 1, φ),    x = (m, g, d, e)

where m and g belong to the finger (they last over contacts), d and e to the contact (drawn anew at
each onset), and d drifts within a contact.

How much contacts of one finger differ is not known beforehand: presses of a simulated finger are
all alike, real ones scatter by 5 %. So a bank of such filters runs side by side, with SCALES times
the deviations of d and e and DRIFT_SCALES times the drift that the settings name. Each is weighted
by how well it predicted the areas measured so far (Bayesian model averaging: Hoeting et al., Stat.
Sci. 14(4), 1999); the estimate is the mixture's mean and variance.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit

SCALES = (0.1, 0.4, 1.5, 0.1, 0.4, 1.5)
"""Of the deviations of d and e, one for each filter."""
DRIFT_SCALES = (0.1, 0.1, 0.1, 2.0, 2.0, 2.0)
"""Of the drift, likewise."""

MEMORY_BETWEEN_CONTACTS = 0.95
"""Share of the logarithmic weights kept from one contact to the next: fingers dry and tire."""

ACCEPTED_OUTLIERS = 3
"""Outliers in a row after which the filters restart with a wide covariance."""

FILTERS = len(SCALES)

FILTER_BANK = np.dtype(
    [
        ("mean", "f8", (FILTERS, 4)),  # of x
        ("covariance", "f8", (FILTERS, 4, 4)),
        ("log_weight", "f8", (FILTERS,)),
        ("stamp", "i8"),  # ns, time of mean and covariance
        ("outliers", "i8"),  # in a row
    ]
)
"""State of the filters."""

FILTER_NOISE = np.dtype(
    [
        ("prior_variance", "f8"),  # of m
        ("slope_variance", "f8"),  # of g and e
        ("contact_variance", "f8"),  # of d
        ("drift_variance", "f8"),  # of d within 1 s
        ("model_variance", "f8"),  # of ln A by the reduced model itself
        ("outlier_limit", "f8"),  # standard deviations
    ]
)
"""Variances that the filters assume."""


@njit(cache=True)
def log_force(force):
    """φ = ln(F / 1 N), held below 0.05 N."""
    return math.log(max(force, 0.05))


@njit(cache=True)
def _widen(bank, noise):
    """Covariances as for a finger not seen before, all filters equally probable."""
    for k in range(FILTERS):
        square = SCALES[k] * SCALES[k]
        bank.covariance[k] = 0.0
        bank.covariance[k, 0, 0] = noise.prior_variance
        bank.covariance[k, 1, 1] = noise.slope_variance
        bank.covariance[k, 2, 2] = square * noise.contact_variance
        bank.covariance[k, 3, 3] = square * noise.slope_variance
        bank.log_weight[k] = 0.0


@njit(cache=True)
def initialise(bank, noise):
    """Filters as for a finger not seen before."""
    for k in range(FILTERS):
        bank.mean[k] = 0.0
    _widen(bank, noise)


@njit(cache=True)
def begin_contact(bank, noise, stamp):
    """Draw the contact's own errors d and e again."""
    for k in range(FILTERS):
        square = SCALES[k] * SCALES[k]
        bank.mean[k, 2:] = 0.0
        bank.covariance[k, 2:, :] = 0.0
        bank.covariance[k, :, 2:] = 0.0
        bank.covariance[k, 2, 2] = square * noise.contact_variance
        bank.covariance[k, 3, 3] = square * noise.slope_variance
        bank.log_weight[k] *= MEMORY_BETWEEN_CONTACTS
    bank.stamp = stamp
    bank.outliers = 0


@njit(cache=True)
def _expected_error(mean, phi):
    """h x with the filter's mean (4,)."""
    return mean[0] + mean[2] + (mean[1] + mean[3]) * phi


@njit(cache=True)
def _variance(covariance, phi):
    """h P hᵀ with the filter's covariance P (4, 4)."""
    total = 0.0
    for i in range(4):
        hi = 1.0 if i % 2 == 0 else phi
        for j in range(4):
            hj = 1.0 if j % 2 == 0 else phi
            total += hi * hj * covariance[i, j]
    return total


@njit(cache=True)
def _innovation(bank, k, noise, phi, model_area, area, sd):
    """Relative innovation of a measured area and its variance in filter k.

    ln(area / predicted) to first order: unbiased for noise that adds to the area.
    """
    predicted = model_area * math.exp(_expected_error(bank.mean[k], phi))
    measurement_variance = (sd / predicted) ** 2 + noise.model_variance
    return area / predicted - 1.0, _variance(bank.covariance[k], phi) + measurement_variance


@njit(cache=True)
def _is_outlier(bank, noise, phi, model_area, area, sd):
    """Whether no filter of the bank explains the measured area."""
    for k in range(FILTERS):
        innovation, total = _innovation(bank, k, noise, phi, model_area, area, sd)
        if innovation * innovation <= noise.outlier_limit**2 * total:
            return False
    return True


@njit(cache=True)
def _add_drift(bank, drift):
    """Add `drift`, scaled for each filter, to the variance of d."""
    for k in range(FILTERS):
        bank.covariance[k, 2, 2] += DRIFT_SCALES[k] ** 2 * drift


@njit(cache=True)
def _drift_until(bank, noise, stamp):
    """Variance that d gains until `stamp`, in the filter of drift scale 1."""
    return noise.drift_variance * max((stamp - bank.stamp) * 1e-9, 0.0)


@njit(cache=True)
def _update(bank, noise, phi, model_area, area, sd):
    """Kalman update of all filters, and of their weights by the likelihood of the innovation."""
    gain = np.empty(4)
    largest = -math.inf
    for k in range(FILTERS):
        innovation, total = _innovation(bank, k, noise, phi, model_area, area, sd)
        for i in range(4):
            gain[i] = 0.0
            for j in range(4):
                gain[i] += bank.covariance[k, i, j] * (1.0 if j % 2 == 0 else phi)
        for i in range(4):
            bank.mean[k, i] += gain[i] / total * innovation
            for j in range(4):
                bank.covariance[k, i, j] -= gain[i] * gain[j] / total
        bank.log_weight[k] -= 0.5 * (math.log(total) + innovation * innovation / total)
        largest = max(largest, bank.log_weight[k])
    for k in range(FILTERS):
        bank.log_weight[k] -= largest


@njit(cache=True)
def correct(bank, noise, stamp, force, model_area, area, sd):
    """Predict to `stamp` and update with an area measured then; false when it is an outlier.

    force (N) and model_area (m²) are those of the stamp; area, sd in m².
    """
    phi = log_force(force)
    drift = _drift_until(bank, noise, stamp)
    _add_drift(bank, drift)
    if _is_outlier(bank, noise, phi, model_area, area, sd):
        bank.outliers += 1
        if bank.outliers < ACCEPTED_OUTLIERS:
            _add_drift(bank, -drift)
            return False
        # The filters were too confident.
        _widen(bank, noise)
    bank.outliers = 0
    _update(bank, noise, phi, model_area, area, sd)
    bank.stamp = max(stamp, bank.stamp)
    return True


@njit(cache=True)
def fused_area(bank, noise, force, model_area, stamp):
    """Best estimate of the area (m²) and its standard deviation at `stamp`."""
    phi = log_force(force)
    drift = _drift_until(bank, noise, stamp)
    weight = 0.0
    mean = 0.0
    square = 0.0
    for k in range(FILTERS):
        w = math.exp(bank.log_weight[k])
        error = _expected_error(bank.mean[k], phi)
        weight += w
        mean += w * error
        square += w * (
            _variance(bank.covariance[k], phi) + DRIFT_SCALES[k] ** 2 * drift + error * error
        )
    mean /= weight
    variance = max(square / weight - mean * mean, 0.0) + noise.model_variance
    area = model_area * math.exp(mean)
    return area, area * math.sqrt(variance)
