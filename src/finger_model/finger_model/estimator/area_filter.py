# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled Kalman filters of what is not known of a finger, corrected by measured areas.

With φ = ln(F / 1 N) the error of the model is

    ln A_true − ln A_model = h x − s w₀,    x = (gain, slope, w, moisture, d, e, f)
    h = (1, φ, s, u · (1, φ, s), 1, φ, β)

gain, slope and w = (stiffness, creep time, creep) belong to the finger and last over contacts; s =
∂ln A/∂w are sensitivities of the reduced model along the present history (`sensitivities`), which
runs at the shift w₀. moisture is the error of the reading in standard deviations of the population,
u what it does to the other coordinates. d, e and f belong to the contact (drawn anew at each
onset), and d drifts within a contact, in the end as far as from one contact to another. The numbers
of the finger describe presses up to TARGET_FORCE. In a contact that was pressed beyond it, d also
walks with φ, up and down, as they describe neither the areas there nor those after it that well.
The model ends at a force limit; φ is held there, and f is the exponent of the area over β =
ln(F / limit) beyond it, so that areas measured there tell little of the finger.

How much contacts of one finger differ is not known beforehand: presses of a simulated finger are
all alike, real ones scatter by 5 %. So a bank of such filters runs side by side, with SCALES times
the deviations of d and e and DRIFT_SCALES times the drift that the settings name. Each is weighted
by how well it predicted the areas measured so far (Bayesian model averaging: Hoeting et al., Stat.
Sci. 14(4), 1999); the estimate is the mixture's mean and variance.

An update finds the most probable error of the model given one area (iterated Kalman filter), which
lies between prediction and measurement whatever their ratio.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from ..paper import TARGET_FORCE
from .sensitivities import DIRECTIONS

SCALES = (0.1, 0.4, 1.5, 0.1, 0.4, 1.5)
"""Of the deviations of d and e, one for each filter."""
DRIFT_SCALES = (0.1, 0.1, 0.1, 2.0, 2.0, 2.0)
"""Of the drift, likewise."""

MEMORY_BETWEEN_CONTACTS = 0.95
"""Share of the logarithmic weights kept from one contact to the next: fingers dry and tire."""

LEAST_LOG_WEIGHT = -20.0
"""Of a filter against the most probable one: a long hold must not exclude the others for ever."""

ACCEPTED_OUTLIERS = 3
"""Outliers in a row after which the filters restart with a wide covariance."""

FILTERS = len(SCALES)

FIRST_TISSUE = 2
TISSUE = slice(FIRST_TISSUE, FIRST_TISSUE + DIRECTIONS)
FINGER_STATES = FIRST_TISSUE + DIRECTIONS
MOISTURE = FINGER_STATES
CONTACT = MOISTURE + 1
STATES = CONTACT + 3
"""Places in x: the finger's gain 0, slope 1 and tissue 2 to 4; moisture 5; contact 6 to 8."""

BEYOND_DEVIATION = 0.5
"""Of f: beyond the force limit the area may stay, or grow with the root of the force."""

MOST_BEYOND = math.log(2.0)
"""Of β: at larger forces the area hardly grows any more."""

GAIN_OF_INDENTATION = 0.5
"""ln δ answers to gains of the area by this: a larger finger has A ∝ L², δ ∝ L."""

BOUND_SD = 3.0
"""Standard deviations of the newest area by which an estimate may leave the span of prediction
and measurement."""

LEAST_FORCE = 0.05
"""N, below which φ is held."""

_ITERATIONS = 20

FILTER_BANK = np.dtype(
    [
        ("mean", "f8", (FILTERS, STATES)),  # of x
        ("covariance", "f8", (FILTERS, STATES, STATES)),
        ("log_weight", "f8", (FILTERS,)),
        ("start", "f8", (STATES,)),  # mixture's mean at the onset: the prediction
        ("measured", "?"),  # an area was fused in this contact
        ("newest", "f8"),  # ln of the newest fused area over the model's
        ("tolerance", "f8"),  # BOUND_SD deviations of it
        ("stamp", "i8"),  # ns, time of mean and covariance
        ("phi", "f8"),  # at that time; before an area of the contact, that of TARGET_FORCE
        ("load", "f8"),  # ln of the contact's largest force over TARGET_FORCE, 0 below
        ("moisture_stamp", "i8"),  # ns, until which the reading of the moisture has aged
        ("outliers", "i8"),  # in a row
        ("areas", "i8"),  # of this finger that were compared so far
        ("mean_nis", "f8"),  # running mean of squared normalised innovations, 1 when consistent
        ("mismatch", "?"),  # mean_nis is, or recently was, too large
    ],
    align=True,
)
"""State of the filters."""

FILTER_NOISE = np.dtype(
    [
        ("prior_mean", "f8", (FINGER_STATES,)),
        ("prior_covariance", "f8", (FINGER_STATES, FINGER_STATES)),
        ("moisture_direction", "f8", (FINGER_STATES,)),  # u
        ("moisture_variance", "f8"),  # of the reading's error in population variances
        ("moisture_wander", "f8"),  # its growth in 1 s
        ("slope_variance", "f8"),  # of e
        ("contact_variance", "f8"),  # of d
        ("drift_variance", "f8"),  # of d within 1 s, at first
        ("drift_limit", "f8"),  # what it grows to in the end
        ("walk_variance", "f8"),  # of d over 1 in φ, in a contact whose load is 1
        ("model_variance", "f8"),  # of ln A by the reduced model itself
        ("gain_variance", "f8"),  # of the factor that all measured areas share
        ("outlier_limit", "f8"),  # standard deviations
    ]
)
"""Variances that the filters assume."""

NIS_MEMORY, NIS_PRIOR_COUNT = 0.85, 2
"""Share of the running mean of the normalised innovation squared (NIS) kept from one area to the
next, but of the first areas of a finger the plain mean with so many that were as expected: the
filters soon adapt to what the model does not know, and only the first ones show it."""
MISMATCH, MATCH = 3.0, 2.0
"""The model is another finger's from the first on, and this one's again below the second."""
MOST_NIS = 25.0
"""One innovation counts for this at most, so that one wild area is soon forgotten."""


@njit(cache=True)
def observation_row(noise, force, limit, sensitivity, gain, h):
    """Fill h (9,): answer of ln A (gain 1) or ln δ (its gain) with sensitivities (3,) to x.

    force: N, of which φ is held below LEAST_FORCE and above the model's `limit` (N).
    """
    phi = math.log(min(max(force, LEAST_FORCE), limit))
    h[0] = gain
    h[1] = gain * phi
    moisture = gain * (noise.moisture_direction[0] + noise.moisture_direction[1] * phi)
    for j in range(DIRECTIONS):
        h[FIRST_TISSUE + j] = sensitivity[j]
        moisture += noise.moisture_direction[FIRST_TISSUE + j] * sensitivity[j]
    h[MOISTURE] = moisture
    h[CONTACT] = gain
    h[CONTACT + 1] = gain * phi
    h[CONTACT + 2] = gain * min(math.log(max(force / limit, 1.0)), MOST_BEYOND)


@njit(cache=True)
def _draw_contact(bank, noise, k):
    """Covariance of d, e and f of filter k as at an onset."""
    square = SCALES[k] * SCALES[k]
    bank.covariance[k, CONTACT:, :] = 0.0
    bank.covariance[k, :, CONTACT:] = 0.0
    bank.covariance[k, CONTACT, CONTACT] = square * noise.contact_variance
    bank.covariance[k, CONTACT + 1, CONTACT + 1] = square * noise.slope_variance
    bank.covariance[k, CONTACT + 2, CONTACT + 2] = BEYOND_DEVIATION**2


@njit(cache=True)
def _widen(bank, noise):
    """Covariances as for a finger not seen before, all filters equally probable."""
    for k in range(FILTERS):
        bank.covariance[k] = 0.0
        for i in range(FINGER_STATES):
            for j in range(FINGER_STATES):
                bank.covariance[k, i, j] = noise.prior_covariance[i, j]
        bank.covariance[k, MOISTURE, MOISTURE] = noise.moisture_variance
        _draw_contact(bank, noise, k)
        bank.log_weight[k] = 0.0


@njit(cache=True)
def initialise(bank, noise, moisture_stamp):
    """Filters as for a finger not seen before; moisture_stamp: ns, of the reading in use."""
    for k in range(FILTERS):
        bank.mean[k] = 0.0
        for i in range(FINGER_STATES):
            bank.mean[k, i] = noise.prior_mean[i]
    _widen(bank, noise)
    bank.areas = 0
    bank.mean_nis = 1.0
    bank.mismatch = False
    bank.measured = False
    bank.moisture_stamp = moisture_stamp
    mixture_mean(bank, bank.start)


@njit(cache=True)
def copy_knowledge(source, target):
    """Copy what the bank `source` knows of the finger into the bank `target`."""
    target.mean[:] = source.mean
    target.covariance[:] = source.covariance
    target.log_weight[:] = source.log_weight
    target.areas = source.areas
    target.mean_nis = source.mean_nis
    target.mismatch = source.mismatch
    target.moisture_stamp = source.moisture_stamp


@njit(cache=True)
def new_reading(bank, noise, stamp):
    """The moisture's error as after a new reading of this stamp (ns), or without one."""
    for k in range(FILTERS):
        bank.mean[k, MOISTURE] = 0.0
        bank.covariance[k, MOISTURE, :] = 0.0
        bank.covariance[k, :, MOISTURE] = 0.0
        bank.covariance[k, MOISTURE, MOISTURE] = noise.moisture_variance
    bank.moisture_stamp = stamp
    mixture_mean(bank, bank.start)


@njit(cache=True)
def shift_contact(bank, own, newest):
    """The model's ln A moved within a contact: add `own` to d, and `newest` to the newest area's
    logarithm over the model's."""
    for k in range(FILTERS):
        bank.mean[k, CONTACT] += own
    bank.newest += newest
    mixture_mean(bank, bank.start)


@njit(cache=True)
def mixture_mean(bank, out):
    """Mean of x (9,) over the filters."""
    total = 0.0
    out[:] = 0.0
    for k in range(FILTERS):
        w = math.exp(bank.log_weight[k])
        total += w
        for i in range(STATES):
            out[i] += w * bank.mean[k, i]
    for i in range(STATES):
        out[i] /= total


@njit(cache=True)
def begin_contact(bank, noise, stamp):
    """Draw the contact's own errors d, e and f again; the reading of the moisture has aged."""
    aged = noise.moisture_wander * max((stamp - bank.moisture_stamp) * 1e-9, 0.0)
    for k in range(FILTERS):
        bank.mean[k, CONTACT:] = 0.0
        _draw_contact(bank, noise, k)
        bank.covariance[k, MOISTURE, MOISTURE] += min(
            aged, max(1.0 - bank.covariance[k, MOISTURE, MOISTURE], 0.0)
        )
        bank.log_weight[k] *= MEMORY_BETWEEN_CONTACTS
    bank.stamp = stamp
    bank.moisture_stamp = max(stamp, bank.moisture_stamp)
    bank.phi, bank.load = math.log(TARGET_FORCE), 0.0
    bank.outliers = 0
    bank.measured = False
    mixture_mean(bank, bank.start)


@njit(cache=True)
def _product(h, x):
    total = 0.0
    for i in range(STATES):
        total += h[i] * x[i]
    return total


@njit(cache=True)
def _variance(covariance, h):
    """h P hᵀ with the filter's covariance P (9, 9)."""
    total = 0.0
    for i in range(STATES):
        row = 0.0
        for j in range(STATES):
            row += h[j] * covariance[i, j]
        total += h[i] * row
    return total


@njit(cache=True)
def _most_probable(area, sd, predicted, variance):
    """Error v of ln `predicted` of prior variance `variance`, given a measured area (m²).

    Minimises ((area − predicted eᵛ)/sd)² + v²/variance by Newton's method within the bracket of
    prediction (0) and measurement. Returns v and its variance after the measurement.
    """
    low, high = 0.0, math.log(area / predicted)
    if low > high:
        low, high = high, low
    v = 0.5 * (low + high)
    curvature = 1.0
    for _ in range(_ITERATIONS):
        expected = predicted * math.exp(v)
        slope = (expected - area) * expected / (sd * sd) + v / variance
        curvature = expected * expected / (sd * sd) + 1.0 / variance
        if slope > 0.0:
            high = v
        else:
            low = v
        v -= slope / curvature
        if not low <= v <= high:
            v = 0.5 * (low + high)
    return v, 1.0 / curvature


@njit(cache=True)
def _normalised_innovation_squared(bank, k, noise, h, offset, model_area, area, sd):
    """Square of the innovation over its deviation in filter k."""
    predicted = model_area * math.exp(_product(h, bank.mean[k]) - offset)
    variance = _variance(bank.covariance[k], h) + noise.model_variance
    # In the logarithm the deviation of an area that is much smaller than predicted is its own.
    relative = sd / math.sqrt(max(area, 0.1 * sd) * predicted)
    innovation = math.log(max(area, 0.1 * sd) / predicted)
    return innovation * innovation / (variance + relative * relative)


@njit(cache=True)
def record_peak_load(bank, force):
    """The contact's force is `force` (N) now; the largest one is kept."""
    bank.load = max(bank.load, math.log(max(force / TARGET_FORCE, 1.0)))


@njit(cache=True)
def _drift_until(bank, noise, k, stamp, phi):
    """Variance that d of filter k gains until `stamp` and `phi`: by time that of a process of
    Ornstein and Uhlenbeck, by force that of a walk."""
    walked = DRIFT_SCALES[k] ** 2 * noise.drift_variance * max((stamp - bank.stamp) * 1e-9, 0.0)
    load = max(bank.load, phi - math.log(TARGET_FORCE))
    by_force = noise.walk_variance * load * abs(phi - bank.phi)
    return by_force - noise.drift_limit * math.expm1(-walked / noise.drift_limit)


@njit(cache=True)
def _predict(bank, noise, stamp, phi, sign):
    """Add the drift until `stamp` and `phi` to the variance of d; sign −1 takes it off again."""
    for k in range(FILTERS):
        drift = _drift_until(bank, noise, k, stamp, phi)
        bank.covariance[k, CONTACT, CONTACT] += sign * drift


@njit(cache=True)
def _kalman_update(bank, noise, h, offset, model_area, area, sd):
    """Iterated Kalman update of all filters, and of their weights by the likelihood."""
    gain = np.empty(STATES)
    largest = -math.inf
    for k in range(FILTERS):
        predicted = model_area * math.exp(_product(h, bank.mean[k]) - offset)
        for i in range(STATES):
            gain[i] = 0.0
            for j in range(STATES):
                gain[i] += bank.covariance[k, i, j] * h[j]
        total = _product(h, gain) + noise.model_variance
        v, after = _most_probable(area, sd, predicted, total)
        misfit = (area - predicted * math.exp(v)) / sd
        for i in range(STATES):
            bank.mean[k, i] += gain[i] / total * v
            for j in range(STATES):
                bank.covariance[k, i, j] -= gain[i] * gain[j] / total * (1.0 - after / total)
        # Laplace's approximation of the evidence.
        bank.log_weight[k] -= 0.5 * (misfit * misfit + v * v / total - math.log(after / total))
        largest = max(largest, bank.log_weight[k])
    for k in range(FILTERS):
        bank.log_weight[k] = max(bank.log_weight[k] - largest, LEAST_LOG_WEIGHT)


@njit(cache=True)
def update(bank, noise, stamp, h, offset, model_area, area, sd):
    """Predict to `stamp` and update with an area measured then; false when it is an outlier.

    h (9,), offset = s w₀ and model_area (m²) are those of the stamp; area, sd in m².
    """
    phi = h[CONTACT + 1] / h[CONTACT]
    _predict(bank, noise, stamp, phi, 1.0)
    least = math.inf
    for k in range(FILTERS):
        least = min(
            least, _normalised_innovation_squared(bank, k, noise, h, offset, model_area, area, sd)
        )
    bank.areas += 1
    share = max(1.0 - NIS_MEMORY, 1.0 / (NIS_PRIOR_COUNT + bank.areas))
    bank.mean_nis += share * (min(least, MOST_NIS) - bank.mean_nis)
    bank.mismatch = bank.mean_nis > (MATCH if bank.mismatch else MISMATCH)
    if least > noise.outlier_limit**2:
        bank.outliers += 1
        if bank.outliers < ACCEPTED_OUTLIERS:
            _predict(bank, noise, stamp, phi, -1.0)
            return False
        # The filters were too confident.
        _widen(bank, noise)
    bank.outliers = 0
    _kalman_update(bank, noise, h, offset, model_area, area, sd)
    bank.measured = True
    bank.newest = math.log(area / model_area)
    bank.tolerance = math.log1p(BOUND_SD * sd / area)
    bank.stamp = max(stamp, bank.stamp)
    bank.phi = phi
    return True


@njit(cache=True)
def estimate(bank, noise, h, offset, stamp, bounded):
    """Mean and variance of the error h x − offset at `stamp`, of the mixture.

    bounded: keep the mean within prediction and newest measurement.
    """
    phi = h[CONTACT + 1] / h[CONTACT]
    weight = 0.0
    mean = 0.0
    square = 0.0
    for k in range(FILTERS):
        w = math.exp(bank.log_weight[k])
        if w < 1e-6:
            continue
        error = _product(h, bank.mean[k]) - offset
        weight += w
        mean += w * error
        drift = h[CONTACT] * h[CONTACT] * _drift_until(bank, noise, k, stamp, phi)
        square += w * (_variance(bank.covariance[k], h) + drift + error * error)
    mean /= weight
    variance = max(square / weight - mean * mean, 0.0) + noise.model_variance
    variance += noise.gain_variance * h[CONTACT] * h[CONTACT]
    if bounded and bank.measured:
        predicted = _product(h, bank.start) - offset
        low = min(predicted, bank.newest - bank.tolerance)
        high = max(predicted, bank.newest + bank.tolerance)
        held = min(max(mean, low), high)
        variance += (mean - held) ** 2
        mean = held
    return mean, variance


@njit(cache=True)
def deviation_of(variance):
    """Relative standard deviation about the median of a quantity whose logarithm has `variance`."""
    if variance > 4.0:
        variance = 4.0
    return math.sqrt(math.exp(2.0 * variance) - 2.0 * math.exp(0.5 * variance) + 1.0)
