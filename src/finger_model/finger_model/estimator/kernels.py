"""Compiled core of the estimator: many wrench samples through model and fusion in one call.

The error of the model is a filter's state: with φ = ln(F / 1 N),

    ln A_true − ln A_model = m + d + (g + e) φ

where m and g belong to the finger (they last over contacts), d and e to the contact (drawn anew at each onset), and
d wanders within a contact. A measured area of stamp t updates the filter at t, against the model's area at t from a
ring of past samples; since measurements enter in the order of their stamps, carrying the filter from t to now is
only the wandering of d.

How much contacts of one finger differ is not known beforehand: presses of a simulated finger are all alike, real ones
scatter by 5 %. So a bank of such filters runs side by side, with SCALES times the deviations of d and e and WANDERING
times the drift that the settings name, each weighted by how well it foretold the areas measured so far (Bayesian model
averaging: Hoeting et al., Stat. Sci. 14(4), 1999); the estimate is the mixture's mean and variance.

Everything the estimator remembers lies in three arrays (`model` of the reduced model, `real`, `whole`) and the ring,
so that a copy of them is a copy of the estimator.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..reduced import kernels as rk

# Columns of the output, floats.
(
    NORMAL_FORCE,
    LATERAL_FORCE,
    MODEL_AREA,
    MEASURED_AREA,
    MEASURED_AREA_AGE,
    FUSED_AREA,
    AREA_STDDEV,
    AREA_FORCE_SLOPE,
    RADIUS,
    INDENTATION,
    MEAN_PRESSURE,
    PEAK_PRESSURE,
    MOISTURE,
    MOISTURE_AGE,
) = range(14)
COLUMNS = 14
# Columns of the output, integers.
STAMP, FLAGS, IN_CONTACT, ONSET = range(4)
WHOLE_COLUMNS = 4

# Offsets of `cfg`: settings as floats.
(
    AXIS,
    SIGN,
    ONSET_FORCE,
    LIFTOFF_FORCE,
    LATERAL_RATIO,
    GAP_LIMIT,
    DELAY_NS,
    OUTLIER_LIMIT,
    AREA_STALE,
    MOISTURE_STALE,
    PRIOR_VARIANCE,
    CONTACT_VARIANCE,
    SLOPE_VARIANCE,
    DRIFT_VARIANCE,
    MODEL_VARIANCE,
    MOISTURE_VALUE,
) = range(16)
CFG_SIZE = 16

SCALES = (0.1, 0.4, 1.5, 0.1, 0.4, 1.5)
"""Of the deviations of d and e, one for each filter."""
WANDERING = (0.1, 0.1, 0.1, 2.0, 2.0, 2.0)
"""Of the wandering, likewise."""

# Offsets of `real`: the last measured area, then for each filter, STRIDE apart from BANK on, mean (4,) and covariance
# (4, 4) at FILTER_TIME and the logarithm of its weight.
MEASURED, BANK = 0, 1
MEAN, COVARIANCE, LOG_WEIGHT, STRIDE = 0, 4, 20, 21
REAL_SIZE = BANK + len(SCALES) * STRIDE

# Offsets of `whole` (int64).
(
    LAST_STAMP,
    MODEL_STAMP,
    STARTED,
    CONTACT,
    ONSET_STAMP,
    LIFTOFF_STAMP,
    FILTER_TIME,
    FUSED_STAMP,
    FUSED_IN_CONTACT,
    PENDING_FLAGS,
    RING_NEXT,
    RING_COUNT,
    REJECTED_IN_A_ROW,
    FUSED,
    REJECTED,
    GAPS,
    CONTACTS,
    STATE_FLAGS,
    MOISTURE_STAMP,
    HAS_MOISTURE,
) = range(20)
WHOLE_SIZE = 20

RING = 8192
"""Samples remembered: fusion_delay may be 1 s at up to 8 kHz."""

FLAG_FORCE_INVALID = 1
FLAG_FORCE_GAP = 2
FLAG_FORCE_OUT_OF_RANGE = 4
FLAG_LATERAL_LOAD = 8
FLAG_MOISTURE_STALE = 64
FLAG_AREA_MISSING = 256
FLAG_AREA_STALE = 512
FLAG_AREA_REJECTED = 2048
FLAG_MODEL_FAILED = 4096

_FORGETTING = 0.95
"""What remains of the filters' logarithmic weights from one contact to the next: fingers dry and tire."""
_SMALLEST_AREA = 5e-6
"""m²; below it a measured area is not compared with the model's."""


@njit(cache=True)
def load_shape(force):
    """φ = ln(F / 1 N), held below 0.05 N."""
    return math.log(max(force, 0.05))


@njit(cache=True)
def _open(real, cfg):
    """Covariances as for a finger not seen before, all filters alike probable."""
    for k in range(len(SCALES)):
        at = BANK + k * STRIDE
        for i in range(16):
            real[at + COVARIANCE + i] = 0.0
        square = SCALES[k] * SCALES[k]
        real[at + COVARIANCE + 0] = cfg[PRIOR_VARIANCE]
        real[at + COVARIANCE + 5] = cfg[SLOPE_VARIANCE]
        real[at + COVARIANCE + 10] = square * cfg[CONTACT_VARIANCE]
        real[at + COVARIANCE + 15] = square * cfg[SLOPE_VARIANCE]
        real[at + LOG_WEIGHT] = 0.0


@njit(cache=True)
def reset_filter(real, cfg):
    """Filters as for a finger not seen before."""
    real[:] = 0.0
    _open(real, cfg)
    real[MEASURED] = math.nan


@njit(cache=True)
def _begin_contact(real, whole, cfg, stamp):
    """Draw the contact's own errors anew. Order of a filter's state: m, g, d, e."""
    for k in range(len(SCALES)):
        at = BANK + k * STRIDE
        for i in range(2, 4):
            real[at + MEAN + i] = 0.0
            for j in range(4):
                real[at + COVARIANCE + 4 * i + j] = 0.0
                real[at + COVARIANCE + 4 * j + i] = 0.0
        square = SCALES[k] * SCALES[k]
        real[at + COVARIANCE + 10] = square * cfg[CONTACT_VARIANCE]
        real[at + COVARIANCE + 15] = square * cfg[SLOPE_VARIANCE]
        real[at + LOG_WEIGHT] *= _FORGETTING
    real[MEASURED] = math.nan
    whole[CONTACT] = 1
    whole[CONTACTS] += 1
    whole[ONSET_STAMP] = stamp
    whole[FILTER_TIME] = stamp
    whole[FUSED_IN_CONTACT] = 0
    whole[REJECTED_IN_A_ROW] = 0


@njit(cache=True)
def _variance(real, at, shape):
    """Variance of m + d + (g + e) φ in the filter at real[at:]."""
    total = 0.0
    for i in range(4):
        hi = 1.0 if i % 2 == 0 else shape
        for j in range(4):
            hj = 1.0 if j % 2 == 0 else shape
            total += hi * hj * real[at + COVARIANCE + 4 * i + j]
    return total


@njit(cache=True)
def _bias(real, at, shape):
    """Mean of m + d + (g + e) φ in the filter at real[at:]."""
    return real[at] + real[at + 2] + (real[at + 1] + real[at + 3]) * shape


@njit(cache=True)
def _innovation(real, at, cfg, shape, model_area, area, sd):
    """Relative innovation of a measured area and its variance in the filter at real[at:].

    ln(area / predicted) to first order: unbiased for noise that adds to the area.
    """
    predicted = model_area * math.exp(_bias(real, at, shape))
    noise = (sd / predicted) ** 2 + cfg[MODEL_VARIANCE]
    return area / predicted - 1.0, _variance(real, at, shape) + noise


@njit(cache=True)
def _update(real, whole, cfg, shape, model_area, area, sd):
    """Kalman update of all filters with one measured area; false when none of them can explain it."""
    explained = False
    for k in range(len(SCALES)):
        innovation, total = _innovation(real, BANK + k * STRIDE, cfg, shape, model_area, area, sd)
        if innovation * innovation <= cfg[OUTLIER_LIMIT] ** 2 * total:
            explained = True
    if not explained:
        whole[REJECTED_IN_A_ROW] += 1
        if whole[REJECTED_IN_A_ROW] < 3:
            return False
        # The filters were too sure of themselves.
        _open(real, cfg)
    whole[REJECTED_IN_A_ROW] = 0
    gain = np.empty(4)
    largest = -math.inf
    for k in range(len(SCALES)):
        at = BANK + k * STRIDE
        innovation, total = _innovation(real, at, cfg, shape, model_area, area, sd)
        for i in range(4):
            gain[i] = 0.0
            for j in range(4):
                gain[i] += real[at + COVARIANCE + 4 * i + j] * (1.0 if j % 2 == 0 else shape)
        for i in range(4):
            real[at + MEAN + i] += gain[i] / total * innovation
            for j in range(4):
                real[at + COVARIANCE + 4 * i + j] -= gain[i] * gain[j] / total
        real[at + LOG_WEIGHT] -= 0.5 * (math.log(total) + innovation * innovation / total)
        largest = max(largest, real[at + LOG_WEIGHT])
    for k in range(len(SCALES)):
        real[BANK + k * STRIDE + LOG_WEIGHT] -= largest
    return True


@njit(cache=True)
def _fuse(real, whole, ring_stamp, ring, cfg, stamp, area, sd):
    """Correct the filter at `stamp` by one measured area; false when it cannot be used."""
    if whole[CONTACTS] == 0 or stamp < whole[ONSET_STAMP]:
        return False
    if whole[CONTACT] == 0 and stamp > whole[LIFTOFF_STAMP]:
        return False
    # Newest remembered sample at or before the stamp.
    count = whole[RING_COUNT]
    newest = whole[RING_NEXT] - 1
    back = 0
    while back < count and ring_stamp[(newest - back) % RING] > stamp:
        back += 1
    if back == count:
        return False
    at = (newest - back) % RING
    force, model_area = ring[at, 0], ring[at, 1]
    if back > 0 and ring_stamp[at] < stamp:
        after = (at + 1) % RING
        weight = (stamp - ring_stamp[at]) / (ring_stamp[after] - ring_stamp[at])
        force += weight * (ring[after, 0] - force)
        model_area += weight * (ring[after, 1] - model_area)
    if not model_area >= _SMALLEST_AREA or not area > 0.0 or not sd > 0.0:
        return False
    elapsed = max((stamp - whole[FILTER_TIME]) * 1e-9, 0.0)
    drift = cfg[DRIFT_VARIANCE] * elapsed
    for k in range(len(SCALES)):
        real[BANK + k * STRIDE + COVARIANCE + 10] += WANDERING[k] ** 2 * drift
    if not _update(real, whole, cfg, load_shape(force), model_area, area, sd):
        for k in range(len(SCALES)):
            real[BANK + k * STRIDE + COVARIANCE + 10] -= WANDERING[k] ** 2 * drift
        return False
    whole[FILTER_TIME] = max(stamp, whole[FILTER_TIME])
    whole[FUSED_STAMP] = stamp
    whole[FUSED_IN_CONTACT] = 1
    whole[FUSED] += 1
    real[MEASURED] = area
    return True


@njit(cache=True)
def _contact(real, whole, cfg, normal, stamp):
    """Onset and lift-off by threshold with hysteresis."""
    if whole[CONTACT] == 0:
        if normal >= cfg[ONSET_FORCE]:
            _begin_contact(real, whole, cfg, stamp)
    elif normal < cfg[LIFTOFF_FORCE]:
        whole[CONTACT] = 0
        whole[LIFTOFF_STAMP] = stamp


@njit(cache=True)
def fused_area(real, whole, cfg, force, model_area, stamp):
    """Best estimate of the area (m²) and its standard deviation at `stamp`."""
    shape = load_shape(force)
    drift = cfg[DRIFT_VARIANCE] * max((stamp - whole[FILTER_TIME]) * 1e-9, 0.0)
    weight = 0.0
    mean = 0.0
    square = 0.0
    for k in range(len(SCALES)):
        at = BANK + k * STRIDE
        w = math.exp(real[at + LOG_WEIGHT])
        bias = _bias(real, at, shape)
        weight += w
        mean += w * bias
        square += w * (_variance(real, at, shape) + WANDERING[k] ** 2 * drift + bias * bias)
    mean /= weight
    variance = max(square / weight - mean * mean, 0.0) + cfg[MODEL_VARIANCE]
    area = model_area * math.exp(mean)
    return area, area * math.sqrt(variance)


@njit(cache=True)
def stream(
    w,
    p,
    model,
    real,
    whole,
    ring_stamp,
    ring,
    cfg,
    stamps,
    forces,
    areas_stamp,
    areas,
    out,
    out_whole,
):
    """Take wrench samples (n,), (n, 3) of increasing stamps, and the measured areas that become due.

    areas_stamp (k,) in ascending order, areas (k, 2): area and standard deviation (m²). Fills out (n, COLUMNS) and
    out_whole (n, WHOLE_COLUMNS); returns the number of areas taken.
    """
    axis = int(cfg[AXIS])
    delay = np.int64(cfg[DELAY_NS])
    taken = 0
    for i in range(len(stamps)):
        stamp = stamps[i]
        flags = whole[STATE_FLAGS] | whole[PENDING_FLAGS]
        whole[PENDING_FLAGS] = 0
        normal = cfg[SIGN] * forces[i, axis]
        a, b = forces[i, (axis + 1) % 3], forces[i, (axis + 2) % 3]
        lateral = math.sqrt(a * a + b * b)
        valid = math.isfinite(normal) and math.isfinite(lateral)
        if whole[STARTED] and (stamp - whole[LAST_STAMP]) * 1e-9 > cfg[GAP_LIMIT]:
            flags |= FLAG_FORCE_GAP
            whole[GAPS] += 1
        whole[LAST_STAMP] = stamp
        if valid:
            dt = (stamp - whole[MODEL_STAMP]) * 1e-9 if whole[STARTED] else 0.0
            whole[MODEL_STAMP] = stamp
            whole[STARTED] = 1
            rk.advance(w, p, model, dt, normal)
            rk.outputs(w, p, model)
            if normal < cfg[LIFTOFF_FORCE] and not math.isfinite(model[rk.INDENTATION]):
                # A model that could not follow a contact starts again from rest in the air.
                rk.rest(w, p, model)
                rk.outputs(w, p, model)
            if normal > p[rk.FORCE_LIMIT]:
                flags |= FLAG_FORCE_OUT_OF_RANGE
            if lateral > cfg[LATERAL_RATIO] * max(normal, 0.0) and normal >= cfg[LIFTOFF_FORCE]:
                flags |= FLAG_LATERAL_LOAD
            _contact(real, whole, cfg, normal, stamp)
            at = whole[RING_NEXT] % RING
            ring_stamp[at] = stamp
            ring[at, 0] = normal
            ring[at, 1] = model[rk.AREA]
            whole[RING_NEXT] += 1
            whole[RING_COUNT] = min(whole[RING_COUNT] + 1, RING)
        else:
            flags |= FLAG_FORCE_INVALID
        while taken < len(areas_stamp) and areas_stamp[taken] + delay <= stamp:
            if not _fuse(
                real,
                whole,
                ring_stamp,
                ring,
                cfg,
                areas_stamp[taken],
                areas[taken, 0],
                areas[taken, 1],
            ):
                whole[REJECTED] += 1
                flags |= FLAG_AREA_REJECTED
            taken += 1
        row = out[i]
        if valid and not math.isfinite(model[rk.AREA]):
            flags |= FLAG_MODEL_FAILED
        if not valid or not math.isfinite(model[rk.AREA]):
            for column in range(COLUMNS):
                row[column] = math.nan
            row[NORMAL_FORCE] = normal
            row[LATERAL_FORCE] = lateral
        else:
            row[NORMAL_FORCE] = normal
            row[LATERAL_FORCE] = lateral
            row[INDENTATION] = model[rk.INDENTATION]
            if whole[CONTACT]:
                model_area = model[rk.AREA]
                area, sd = fused_area(real, whole, cfg, normal, model_area, stamp)
                row[MODEL_AREA] = model_area
                row[FUSED_AREA] = area
                row[AREA_STDDEV] = sd
                row[AREA_FORCE_SLOPE] = model[rk.SLOPE]
                row[RADIUS] = math.sqrt(model_area / math.pi)
                row[MEAN_PRESSURE] = normal / area if area > 0.0 else 0.0
                row[PEAK_PRESSURE] = model[rk.PEAK]
            else:
                row[MODEL_AREA] = 0.0
                row[FUSED_AREA] = 0.0
                row[AREA_STDDEV] = 0.0
                row[AREA_FORCE_SLOPE] = 0.0
                row[RADIUS] = 0.0
                row[MEAN_PRESSURE] = 0.0
                row[PEAK_PRESSURE] = 0.0
        row[MEASURED_AREA] = math.nan
        row[MEASURED_AREA_AGE] = math.nan
        if whole[CONTACT]:
            if whole[FUSED_IN_CONTACT]:
                age = (stamp - whole[FUSED_STAMP]) * 1e-9
                row[MEASURED_AREA] = real[MEASURED]
                row[MEASURED_AREA_AGE] = age
                if age > cfg[AREA_STALE]:
                    flags |= FLAG_AREA_STALE
            else:
                flags |= FLAG_AREA_MISSING
        row[MOISTURE] = cfg[MOISTURE_VALUE]
        row[MOISTURE_AGE] = math.nan
        if whole[HAS_MOISTURE]:
            row[MOISTURE_AGE] = (stamp - whole[MOISTURE_STAMP]) * 1e-9
            if row[MOISTURE_AGE] > cfg[MOISTURE_STALE]:
                flags |= FLAG_MOISTURE_STALE
        else:
            row[MOISTURE] = math.nan
        out_whole[i, STAMP] = stamp
        out_whole[i, FLAGS] = flags
        out_whole[i, IN_CONTACT] = whole[CONTACT]
        out_whole[i, ONSET] = whole[ONSET_STAMP]
    return taken
