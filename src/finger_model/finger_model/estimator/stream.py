# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled core of the estimator: many wrench samples through model and filters in one call.

A measured area of stamp t corrects the filters at t, against the model's area at t from the
remembered samples. Measurements enter in the order of their stamps, so the prediction from t to now
is only the drift of the contact's error.
"""

from __future__ import annotations

import math
from collections import namedtuple
from typing import Any

import numpy as np

from finger_common import contact_threshold
from finger_common.flags import StateFlag

from ..compiled import njit
from ..reduced import kernels as rk
from . import area_filter

_names: Any = namedtuple("FLAG", StateFlag.__members__)  # type: ignore[misc]
FLAG: Any = _names(*map(int, StateFlag))
"""The bits of StateFlag as constants of compiled code."""

REMEMBERED = 8192
"""Samples remembered: fusion_delay may be 1 s at up to 8 kHz."""

SMALLEST_AREA = 5e-6
"""m²; below it a measured area is not compared with the model's."""

CONFIGURATION = np.dtype(
    [
        ("axis", "i8"),  # 0 x, 1 y, 2 z
        ("sign", "f8"),
        ("onset_force", "f8"),  # N
        ("liftoff_force", "f8"),  # N
        ("lateral_ratio", "f8"),
        ("gap_limit", "f8"),  # s
        ("fusion_delay", "i8"),  # ns
        ("area_stale_after", "f8"),  # s
        ("moisture_stale_after", "f8"),  # s
        ("moisture", "f8"),  # a.u., NaN before the first reading
        ("moisture_stamp", "i8"),  # ns
        ("flags", "i8"),  # of moisture and parameters
        ("noise", area_filter.FILTER_NOISE),
    ]
)
"""Settings and the parameters in use; the core only reads them."""

STREAM = np.dtype(
    [
        ("started", "?"),  # a valid sample was processed
        ("last_stamp", "i8"),  # ns, newest sample
        ("model_stamp", "i8"),  # ns, newest valid sample
        ("pending_flags", "i8"),  # of the next estimate
    ],
    align=True,
)
"""Where the stream of samples is; a reset keeps it."""

CONTACT = np.dtype(
    [
        ("touching", "?"),
        ("has_fused", "?"),  # an area was fused in this contact
        ("onset", "i8"),  # ns
        ("liftoff", "i8"),  # ns
        ("fused_stamp", "i8"),  # ns
        ("fused_area", "f8"),  # m²
    ],
    align=True,
)
"""The present contact, or the last one, and its latest fused measurement."""

COUNTERS = np.dtype(
    [("fused_areas", "i8"), ("rejected_areas", "i8"), ("gaps", "i8"), ("contacts", "i8")]
)
"""Counts since the start or the last reset."""

MEMORY = np.dtype(
    [
        ("next", "i8"),  # samples written so far
        ("stamp", "i8", (REMEMBERED,)),  # ns
        ("force", "f8", (REMEMBERED,)),  # N
        ("area", "f8", (REMEMBERED,)),  # m², of the model
    ]
)
"""Ring of past samples."""

STATE = np.dtype(
    [
        ("stream", STREAM),
        ("contact", CONTACT),
        ("counters", COUNTERS),
        ("filters", area_filter.FILTER_BANK),
        ("memory", MEMORY),
    ],
    align=True,
)
"""All that the core remembers beside the state of the reduced model."""

AREA = np.dtype([("stamp", "i8"), ("area", "f8"), ("sd", "f8")])
"""A measured area: stamp in ns, area and standard deviation in m²."""

_in_contact = njit(cache=True)(contact_threshold.in_contact)


@njit(cache=True)
def _follow_contact(config, state, normal_force, stamp):
    """Onset and lift-off by threshold with hysteresis."""
    contact = state.contact
    touching = _in_contact(contact.touching, normal_force, config.onset_force, config.liftoff_force)
    if touching and not contact.touching:
        area_filter.begin_contact(state.filters, config.noise, stamp)
        contact.onset = stamp
        contact.has_fused = False
        state.counters.contacts += 1
    elif contact.touching and not touching:
        contact.liftoff = stamp
    contact.touching = touching


@njit(cache=True)
def _remember(memory, stamp, force, area):
    """Keep a sample in the ring."""
    at = memory.next % REMEMBERED
    memory.stamp[at] = stamp
    memory.force[at] = force
    memory.area[at] = area
    memory.next += 1


@njit(cache=True)
def _recall(memory, stamp):
    """Force (N) and model area (m²) at a past stamp; area NaN when it is no longer remembered."""
    count = min(memory.next, REMEMBERED)
    back = 0
    while back < count and memory.stamp[(memory.next - 1 - back) % REMEMBERED] > stamp:
        back += 1
    if back == count:
        return math.nan, math.nan
    at = (memory.next - 1 - back) % REMEMBERED
    force, area = memory.force[at], memory.area[at]
    if back > 0 and memory.stamp[at] < stamp:
        after = (at + 1) % REMEMBERED
        weight = (stamp - memory.stamp[at]) / (memory.stamp[after] - memory.stamp[at])
        force += weight * (memory.force[after] - force)
        area += weight * (memory.area[after] - area)
    return force, area


@njit(cache=True)
def _fuse(config, state, stamp, area, sd):
    """Correct the filters by an area measured at `stamp`; false when it cannot be used."""
    contact = state.contact
    if state.counters.contacts == 0 or stamp < contact.onset:
        return False
    if not contact.touching and stamp > contact.liftoff:
        return False
    force, model_area = _recall(state.memory, stamp)
    if not model_area >= SMALLEST_AREA or not area > 0.0 or not sd > 0.0:
        return False
    if not area_filter.correct(state.filters, config.noise, stamp, force, model_area, area, sd):
        return False
    contact.fused_stamp = stamp
    contact.fused_area = area
    contact.has_fused = True
    state.counters.fused_areas += 1
    return True


@njit(cache=True)
def _advance_model(net, par, finger, work, config, state, stamp, normal_force):
    """Reduced model to a valid sample; the contact and the remembered samples follow."""
    stream = state.stream
    dt = (stamp - stream.model_stamp) * 1e-9 if stream.started else 0.0
    stream.model_stamp = stamp
    stream.started = True
    rk.step(net, par, finger, work, dt, normal_force)
    if normal_force < config.liftoff_force and not math.isfinite(finger[0].indentation):
        # A model that could not follow a contact starts again from rest in the air.
        rk.rest(net, par, finger, work)
    _follow_contact(config, state, normal_force, stamp)
    _remember(state.memory, stamp, normal_force, finger[0].area)


@njit(cache=True)
def _write_contact(config, state, finger, normal_force, stamp, row):
    """Fields of the contact at a sample that the model followed."""
    row.indentation = finger.indentation
    row.model_area = row.area = row.area_stddev = row.area_force_slope = 0.0
    row.radius = row.mean_pressure = row.peak_pressure = 0.0
    if state.contact.touching:
        area, sd = area_filter.fused_area(
            state.filters, config.noise, normal_force, finger.area, stamp
        )
        row.model_area = finger.area
        row.area = area
        row.area_stddev = sd
        row.area_force_slope = finger.area_force_slope
        row.radius = math.sqrt(finger.area / math.pi)
        row.mean_pressure = normal_force / area if area > 0.0 else 0.0
        row.peak_pressure = finger.peak_pressure


@njit(cache=True)
def _write_unknown(row):
    """Fields of the contact at a sample that the model could not follow."""
    row.indentation = math.nan
    row.model_area = row.area = row.area_stddev = row.area_force_slope = math.nan
    row.radius = row.mean_pressure = row.peak_pressure = math.nan


@njit(cache=True)
def _write_measurement(config, contact, stamp, row):
    """Latest fused area and its age; returns the flags."""
    row.measured_area = row.measured_area_age = math.nan
    if not contact.touching:
        return 0
    if not contact.has_fused:
        return FLAG.AREA_MISSING
    age = (stamp - contact.fused_stamp) * 1e-9
    row.measured_area = contact.fused_area
    row.measured_area_age = age
    return FLAG.AREA_STALE if age > config.area_stale_after else 0


@njit(cache=True)
def _write_moisture(config, stamp, row):
    """Moisture reading in use and its age; returns the flags."""
    row.moisture = config.moisture
    row.moisture_age = math.nan
    if math.isnan(config.moisture):
        return 0
    row.moisture_age = (stamp - config.moisture_stamp) * 1e-9
    return FLAG.MOISTURE_STALE if row.moisture_age > config.moisture_stale_after else 0


@njit(cache=True)
def process(net, par, finger, work, configuration, states, stamps, forces, areas, rows):
    """Process wrench samples of increasing stamps, and the measured areas that come due.

    net, par, finger, work: records of the reduced model; configuration (1,), states (1,):
    CONFIGURATION, STATE; stamps (n,), forces (n, 3): ns, N; areas (k,): AREA in the order of their
    stamps. Fills rows (n,) of
    ESTIMATE_DTYPE but for `parameter_set`; returns the number of areas used up.
    """
    config, state = configuration[0], states[0]
    stream = state.stream
    used = 0
    for i in range(len(stamps)):
        stamp = stamps[i]
        row = rows[i]
        flags = config.flags | stream.pending_flags
        stream.pending_flags = 0
        normal_force = config.sign * forces[i, config.axis]
        a, b = forces[i, (config.axis + 1) % 3], forces[i, (config.axis + 2) % 3]
        lateral_force = math.sqrt(a * a + b * b)
        valid = math.isfinite(normal_force) and math.isfinite(lateral_force)
        if stream.started and (stamp - stream.last_stamp) * 1e-9 > config.gap_limit:
            flags |= FLAG.FORCE_GAP
            state.counters.gaps += 1
        stream.last_stamp = stamp
        if valid:
            _advance_model(net, par, finger, work, config, state, stamp, normal_force)
            if normal_force > par[0].force_limit:
                flags |= FLAG.FORCE_OUT_OF_RANGE
            if (
                lateral_force > config.lateral_ratio * max(normal_force, 0.0)
                and normal_force >= config.liftoff_force
            ):
                flags |= FLAG.LATERAL_LOAD
        else:
            flags |= FLAG.FORCE_INVALID
        while used < len(areas) and areas[used].stamp + config.fusion_delay <= stamp:
            if not _fuse(config, state, areas[used].stamp, areas[used].area, areas[used].sd):
                state.counters.rejected_areas += 1
                flags |= FLAG.AREA_REJECTED
            used += 1
        failed = not math.isfinite(finger[0].area)
        if valid and failed:
            flags |= FLAG.MODEL_FAILED
        if valid and not failed:
            _write_contact(config, state, finger[0], normal_force, stamp, row)
        else:
            _write_unknown(row)
        row.stamp_ns = stamp
        row.normal_force = normal_force
        row.lateral_force = lateral_force
        row.in_contact = state.contact.touching
        row.onset_ns = state.contact.onset
        flags |= _write_measurement(config, state.contact, stamp, row)
        flags |= _write_moisture(config, stamp, row)
        row.flags = flags
    return used


@njit(cache=True)
def initialise_filters(configuration, states):
    """Filters as for a finger not seen before, with no area fused."""
    area_filter.initialise(states[0].filters, configuration[0].noise)
    states[0].contact.has_fused = False


@njit(cache=True)
def fused_areas(configuration, states, forces, model_areas, out):
    """Best estimate of areas (n,) under forces (n,), with the error of the model known so far."""
    filters, noise = states[0].filters, configuration[0].noise
    for i in range(len(forces)):
        out[i] = 0.0
        if model_areas[i] > 0.0:
            area, _ = area_filter.fused_area(
                filters, noise, forces[i], model_areas[i], filters.stamp
            )
            out[i] = area
