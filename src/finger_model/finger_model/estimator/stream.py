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

from .. import force_noise
from ..compiled import njit
from ..delayed import REMEMBERED
from ..finger_prior import PRIOR_FORCES
from ..pose.correction import LARGEST_DEPTH
from ..reduced import kernels as rk
from ..sensor_air import SILENCE
from . import area_filter, sensitivities

_names: Any = namedtuple("FLAG", StateFlag.__members__)  # type: ignore[misc]
FLAG: Any = _names(*map(int, StateFlag))
"""The bits of StateFlag as constants of compiled code."""

INDENTATION_DEVIATION = 0.01
PEAK_DEVIATION = 0.03
"""Relative errors of the reduced model's indentation and peak pressure themselves."""

SLOWEST_TOUCH = 2.0
"""s from half the onset force to it, beyond which it is the tare that drifts."""
EMPTY_AREAS = 3
"""Areas without contact in a row at which the force is not believed."""
EMPTY_TIME = 0.5
"""s of them under more than QUIET_FORCE, which no camera overlooks, at which it is the tare."""
QUIET_FORCE, QUIET_BAND, QUIET_TIME = 0.15, 0.02, 5.0
"""N, N, s: below the first a force that stays within the second for the third is an offset."""
PULLED_TIME = 1.0
"""s; a plate that a finger lets go of does not pull for longer."""
REST_TIME = 0.5
"""s near zero after which such a force is tared."""
SHORT_REST = 0.1
"""s near zero on both sides of a contact that show that its finger came and went."""

SMALLEST_AREA = 5e-6
"""m²; below it a measured area is not compared with the model's."""

_LOG_PRIOR_FORCES = np.log(PRIOR_FORCES)

CONFIGURATION = np.dtype(
    [
        ("axis", "i8"),  # 0 x, 1 y, 2 z
        ("sign", "f8"),
        ("onset_force", "f8"),  # N
        ("liftoff_force", "f8"),  # N
        ("lateral_ratio", "f8"),
        ("gap_limit", "f8"),  # s
        ("fusion_delay", "i8"),  # ns
        ("zero_variance", "f8"),  # N², of the zero of the normal force
        ("area_stale_after", "f8"),  # s
        ("moisture_stale_after", "f8"),  # s
        ("moisture", "f8"),  # a.u., NaN before the first reading
        ("moisture_stamp", "i8"),  # ns
        ("flags", "i8"),  # of moisture and parameters
        ("noise", area_filter.FILTER_NOISE),
        ("peak", "f8", (2, len(PRIOR_FORCES))),  # mean and deviation of ln (peak over mean
        # pressure) over the model's, at PRIOR_FORCES
        ("indentation", "f8", (2, len(PRIOR_FORCES))),  # the same of the indentation over that
        # which follows from the area
        ("pose", "f8", (4,)),  # see _pose_gain; zeros for a round pad on a level plate
    ]
)
"""Settings and the parameters in use; the core only reads them."""

STREAM = np.dtype(
    [
        ("started", "?"),  # a valid sample was processed
        ("last_stamp", "i8"),  # ns, newest sample
        ("model_stamp", "i8"),  # ns, newest valid sample
        ("pending_flags", "i8"),  # of the next estimate
        ("measured", force_noise.MEASURED),
        ("forces", "f8", (2,)),  # N, the two newest that were measured
        ("noise_variance", "f8"),  # N², of a sample
        ("noise_time", "f8"),  # s, over which it was averaged
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
        ("last_unloaded", "i8"),  # ns, newest sample below half the onset force; 0 for none
        ("onset_unseen", "?"),  # the contact did not begin as a finger's does
        ("exceeded_limit", "?"),  # the force has been beyond the model's limit
        ("constants_outdated", "?"),  # the model has constants from before the last change of them
        ("empty_areas", "i8"),  # areas in a row that show no contact
        ("seen_force", "f8"),  # N, at the newest area of this contact; 0 for none
        ("empty_since", "i8"),  # ns, stamp of the first of them under more than QUIET_FORCE
        ("quiet_since", "i8"),  # ns, since when the force is nearly constant
        ("quiet_force", "f8"),  # N
        ("negative_since", "i8"),  # ns, since when the force is negative; 0 while it is not
        ("offset_suspected", "?"),  # no finger's for certain, and not at rest near zero since
        ("loaded", "i8"),  # ns, newest sample beyond the onset force, of either sign
        ("end_unseen", "?"),  # a contact was under way at a silence, and nothing has shown since
        # whether it is: no area of a contact or of an empty plate, and no rest near zero
        ("from_rest", "?"),  # the contact began as a finger's does, from near zero
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
        ("sensitivity", "f8", (REMEMBERED, sensitivities.DIRECTIONS)),  # of ln area
    ]
)
"""Ring of past samples."""

STATE = np.dtype(
    [
        ("stream", STREAM),
        ("contact", CONTACT),
        ("counters", COUNTERS),
        ("filters", area_filter.FILTER_BANK),
        ("before", area_filter.FILTER_BANK),  # at the onset of the present contact, or later: what
        # is known of the finger if the rest of the contact tells nothing
        ("sensitivities", sensitivities.SENSITIVITIES),
        ("memory", MEMORY),
    ],
    align=True,
)
"""All that the core remembers beside the state of the reduced model."""

NO_CONTACT = -1.0
"""In place of an area: the camera saw none."""
LEAST_AREA, LARGEST_AREA = 1e-7, 1e-3
"""m² between which an area may be that of a finger; a deviation that is larger tells nothing."""

LEAST_NOISE = 1e-3
"""N, of a sample of the force: none has less."""

LEAST_DEVIATION = 1e-3
"""Of an area, relative: none is known better."""

AREA = np.dtype([("stamp", "i8"), ("area", "f8"), ("sd", "f8")])
"""A measured area: stamp in ns, area and standard deviation in m²."""

_in_contact = njit(cache=True)(contact_threshold.in_contact)


@njit(cache=True)
def _offset_suspected(contact, stamp):
    """Whether the force of the present contact, or that in the air, is hardly a finger's."""
    if contact.end_unseen or contact.offset_suspected:
        return True
    if not contact.touching:
        return False
    quiet = contact.quiet_force < QUIET_FORCE and (stamp - contact.quiet_since) * 1e-9 > QUIET_TIME
    return (
        contact.onset_unseen
        or contact.empty_areas >= EMPTY_AREAS
        or (quiet and not contact.has_fused)
    )


@njit(cache=True)
def _check_negative_force(config, state, normal_force, stamp):
    """A force that is negative for long comes from the tare, until it rests near zero again."""
    contact = state.contact
    if abs(normal_force) > config.onset_force:
        contact.loaded = stamp
    elif (stamp - contact.loaded) * 1e-9 > REST_TIME:
        contact.offset_suspected = contact.end_unseen = False
    elif (
        contact.from_rest and not contact.touching and (stamp - contact.loaded) * 1e-9 > SHORT_REST
    ):
        contact.end_unseen = False
    if normal_force > -config.onset_force:
        contact.negative_since = 0
    elif contact.negative_since == 0:
        contact.negative_since = stamp
    elif not contact.offset_suspected and (stamp - contact.negative_since) * 1e-9 > PULLED_TIME:
        contact.offset_suspected = True
        if state.counters.contacts > 0:
            # The last contact was already with this tare.
            area_filter.copy_knowledge(state.before, state.filters)


@njit(cache=True)
def _update_contact(config, state, normal_force, stamp, silent):
    """Onset and lift-off by threshold with hysteresis; true at an onset.

    silent: no sample came for SILENCE before this one. What is held then is another contact: the
    force may have another tare, and nobody saw what happened. So it may also be held where the
    force shows no contact.
    """
    contact = state.contact
    touching = _in_contact(contact.touching, normal_force, config.onset_force, config.liftoff_force)
    begins = touching and (silent or not contact.touching)
    if contact.touching and (silent or not touching):
        contact.liftoff = stamp
        if contact.exceeded_limit or _offset_suspected(contact, stamp):
            # What was learned from a force that was none, or beyond the model's, is forgotten, and
            # areas of this contact that are still under way teach nothing.
            area_filter.copy_knowledge(state.before, state.filters)
            contact.liftoff = contact.onset - 1
    if silent:
        contact.end_unseen |= contact.touching
        contact.empty_areas = 0
        contact.from_rest = False
        before = state.memory.force[(state.memory.next - 1) % REMEMBERED]
        if abs(before) > config.onset_force:
            contact.loaded = stamp  # the silence was no rest
    if begins:
        area_filter.copy_knowledge(state.filters, state.before)
        area_filter.begin_contact(state.filters, config.noise, stamp)
        rise = (stamp - contact.last_unloaded) * 1e-9
        contact.onset_unseen = silent or contact.last_unloaded == 0 or rise > SLOWEST_TOUCH
        rest = (contact.last_unloaded - contact.loaded) * 1e-9
        contact.from_rest = not contact.onset_unseen and rest > SHORT_REST
        contact.exceeded_limit = False
        contact.seen_force = 0.0
        contact.empty_areas = 0
        contact.quiet_since = stamp
        contact.onset = stamp
        contact.has_fused = False
        state.counters.contacts += 1
    contact.touching = touching
    if normal_force < 0.5 * config.onset_force:
        contact.last_unloaded = stamp
    if abs(normal_force - contact.quiet_force) > QUIET_BAND:
        contact.quiet_since, contact.quiet_force = stamp, normal_force
    _check_negative_force(config, state, normal_force, stamp)
    return begins


@njit(cache=True)
def _limit(model):
    """Force (N) up to which the model knows the contact: the force that it holds where it cannot
    follow."""
    if model.states[0].failed:
        return max(model.states[0].force, area_filter.LEAST_FORCE)
    return model.constants[0].force_limit


@njit(cache=True)
def _is_beyond(model, normal_force):
    """Whether the model holds another force than this one (N)."""
    return model.states[0].failed != 0 or normal_force > model.constants[0].force_limit


@njit(cache=True)
def _check_force_limit(state, beyond, stamp):
    """From a force `beyond` the model's on, a contact tells nothing of the finger: neither the area
    there, nor what the tissue has gone through, is the model's."""
    contact = state.contact
    if contact.touching and beyond and not contact.exceeded_limit:
        contact.exceeded_limit = True
        if not _offset_suspected(contact, stamp):
            area_filter.copy_knowledge(state.filters, state.before)


@njit(cache=True)
def _pose_gain(config, area):
    """Area of the pad in its pose over `area` (m²), that of a round one on a level plate, and the
    derivative of its logarithm by that of `area`."""
    pose = config.pose
    if pose[3] == 0.0 or not area > 0.0:
        return 1.0, 0.0
    s = min(pose[3] * math.sqrt(area), LARGEST_DEPTH)
    slope = 0.5 * s * (pose[1] + 2.0 * pose[2] * s) if s < LARGEST_DEPTH else 0.0
    return math.exp(pose[0] + s * (pose[1] + s * pose[2])), slope


@njit(cache=True)
def _at_force(values, force):
    """Mean and deviation at a force (N) of config's peak or indentation `values` (2, n)."""
    phi = math.log(max(force, PRIOR_FORCES[0]))
    mean = np.interp(phi, _LOG_PRIOR_FORCES, values[0])
    return mean, np.interp(phi, _LOG_PRIOR_FORCES, values[1])


@njit(cache=True)
def _remember(memory, stamp, force, area, sensitivity):
    """Keep a sample in the ring."""
    at = memory.next % REMEMBERED
    memory.stamp[at] = stamp
    memory.force[at] = force
    memory.area[at] = area
    for j in range(sensitivities.DIRECTIONS):
        memory.sensitivity[at, j] = sensitivity[j]
    memory.next += 1


@njit(cache=True)
def _recall(memory, stamp, sensitivity):
    """Force (N) and model area (m²) at a past stamp; area NaN when it is no longer remembered.

    Fills sensitivity (3,), that of the area.
    """
    count = min(memory.next, REMEMBERED)
    back = 0
    while back < count and memory.stamp[(memory.next - 1 - back) % REMEMBERED] > stamp:
        back += 1
    if back == count:
        return math.nan, math.nan
    at = (memory.next - 1 - back) % REMEMBERED
    force, area = memory.force[at], memory.area[at]
    for j in range(sensitivities.DIRECTIONS):
        sensitivity[j] = memory.sensitivity[at, j]
    if back > 0 and memory.stamp[at] < stamp:
        after = (at + 1) % REMEMBERED
        weight = (stamp - memory.stamp[at]) / (memory.stamp[after] - memory.stamp[at])
        force += weight * (memory.force[after] - force)
        area += weight * (memory.area[after] - area)
        for j in range(sensitivities.DIRECTIONS):
            sensitivity[j] += weight * (memory.sensitivity[after, j] - sensitivity[j])
    return force, area


@njit(cache=True)
def _offset(state, sensitivity):
    """s w₀: what the shift of the model has already taken of its error."""
    total = 0.0
    for j in range(sensitivities.DIRECTIONS):
        total += sensitivity[j] * state.sensitivities.shift[j]
    return total


@njit(cache=True)
def _fuse(config, state, stamp, area, sd, limit):
    """Correct the filters by an area measured at `stamp`; false when it cannot be used.

    limit: force (N) the model was built for.
    """
    contact = state.contact
    if state.counters.contacts == 0 or stamp < contact.onset:
        return False
    if not contact.touching and stamp > contact.liftoff:
        if area == NO_CONTACT:
            contact.empty_areas += 1
        elif area > 0.0:
            contact.empty_areas = 0
            if contact.end_unseen:  # a force near zero is then no rest
                contact.from_rest = False
                contact.loaded = max(contact.loaded, stamp)
        if contact.empty_areas >= EMPTY_AREAS:
            contact.end_unseen = False
        return False
    sensitivity = np.zeros(sensitivities.DIRECTIONS)
    force, model_area = _recall(state.memory, stamp, sensitivity)
    if not model_area >= SMALLEST_AREA:
        return False
    if area == NO_CONTACT:
        if contact.empty_areas == 0 or force <= QUIET_FORCE:
            contact.empty_since = stamp
        contact.empty_areas += 1
        empty_time = (stamp - contact.empty_since) * 1e-9
        # A finger that began as one does may come into the picture late, or be lost in a hold; one
        # that was lifted was small, or pressed harder, when it was last seen.
        lifted = force < 0.5 * contact.seen_force
        lifted |= contact.seen_force > 0.0 and contact.fused_area < 0.5 * model_area
        if (
            (contact.onset_unseen or lifted)
            and contact.empty_areas >= EMPTY_AREAS
            and empty_time >= EMPTY_TIME
        ):
            contact.offset_suspected = True
        return False
    if not LEAST_AREA < area < LARGEST_AREA or not 0.0 < sd < LARGEST_AREA:
        return False
    sd = max(sd, LEAST_DEVIATION * area)
    h = np.empty(area_filter.STATES)
    area_filter.observation_row(config.noise, force, limit, sensitivity, 1.0, h)
    offset = _offset(state, sensitivity)
    if not area_filter.update(state.filters, config.noise, stamp, h, offset, model_area, area, sd):
        return False
    contact.empty_areas = 0
    contact.onset_unseen = False
    if contact.touching:
        contact.end_unseen = False
    contact.seen_force = force
    contact.fused_stamp = stamp
    contact.fused_area = area
    contact.has_fused = True
    state.counters.fused_areas += 1
    return True


@njit(cache=True)
def _apply_constants(model, state):
    """Constants of the finger and its perturbed copies from `model.base`."""
    if state.contact.constants_outdated:
        state.contact.constants_outdated = False
        for j in range(1 + sensitivities.DIRECTIONS):
            # The states are of these.
            before = model.constants[j].fraction.copy()
            model.constants[j] = model.base[0]
            model.constants[j].fraction[:] = before
    sensitivities.set_constants(model, state.sensitivities)


@njit(cache=True)
def _update_noise(stream, stamp, normal, a, b):
    """Update the noise of the normal force (N) by a valid sample of it and of the lateral ones."""
    dt = (stamp - stream.measured.stamp) * 1e-9
    if not force_noise.take_sample(stream.measured, stamp, normal, a, b):
        return
    rough = force_noise.roughness(normal, stream.forces[0], stream.forces[1])
    stream.forces[1], stream.forces[0] = stream.forces[0], normal
    if 0.0 < dt <= force_noise.LONGEST_PERIOD:
        stream.noise_variance, stream.noise_time = force_noise.averaged(
            stream.noise_variance, stream.noise_time, rough, LEAST_NOISE**2, dt
        )


@njit(cache=True)
def _advance_model(model, config, state, stamp, normal_force):
    """Reduced model to a valid sample; the contact and the remembered samples follow."""
    stream = state.stream
    dt = 0.0
    if stream.started:
        dt = (stamp - stream.model_stamp) * 1e-9
    else:
        state.sensitivities.stamp[:] = stamp - 1
    stream.model_stamp = stamp
    stream.started = True
    rk.step(model.networks, model.constants[:1], model.states[:1], model.work, dt, normal_force)
    lost = model.states[0].failed != 0 or not math.isfinite(model.states[0].indentation)
    if normal_force < config.liftoff_force and lost:
        # A model that could not follow a contact starts again from rest in the air.
        sensitivities.reset(model)
        state.sensitivities.stamp[:] = stamp
    begins = _update_contact(config, state, normal_force, stamp, dt > SILENCE)
    if begins:
        # What the last contacts told of the finger moves the model itself, so that sensitivities
        # are those of this finger.
        sensitivities.advance_perturbed(model, state.sensitivities, stamp, normal_force, True)
        sensitivities.set_shift(state.sensitivities, state.filters.start[area_filter.TISSUE])
        _apply_constants(model, state)
        sensitivities.evaluate(model, state.sensitivities, normal_force)
    else:
        sensitivities.advance_perturbed(model, state.sensitivities, stamp, normal_force, False)
    area_filter.record_peak_load(state.filters, min(normal_force, _limit(model)))
    _check_force_limit(state, _is_beyond(model, normal_force), stamp)
    gain, _ = _pose_gain(config, model.states[0].area)
    _remember(
        state.memory, stamp, normal_force, gain * model.states[0].area, state.sensitivities.area
    )


@njit(cache=True)
def _force_variances(config, state, normal_force, exponent):
    """Variances of ln A and of ln(F/A) by noise and zero of the force; exponent: d ln A / d ln F.

    A force that is wrong by dF moves the model's area by exponent · dF/F, and F/A by the rest. A
    wrong zero is in the force of the newest area of this contact too, which took its part out of
    the area.
    """
    share = exponent
    if state.contact.has_fused and state.contact.seen_force > 0.0:
        share *= 1.0 - normal_force / state.contact.seen_force
    square = max(normal_force, area_filter.LEAST_FORCE) ** 2
    noise, zero = state.stream.noise_variance / square, config.zero_variance / square
    of_area = noise * exponent * exponent + zero * share * share
    return of_area, noise * (1.0 - exponent) ** 2 + zero * (1.0 - share) ** 2


@njit(cache=True)
def _write_contact(config, state, finger, normal_force, limit, stamp, row):
    """Fields of the contact at a sample that the model followed, to its `limit` of force (N)."""
    row.indentation = finger.indentation
    row.model_area = row.area = row.area_stddev = row.area_force_slope = 0.0
    row.radius = row.mean_pressure = row.peak_pressure = 0.0
    row.radius_stddev = row.mean_pressure_stddev = row.peak_pressure_stddev = 0.0
    row.indentation_stddev = INDENTATION_DEVIATION * abs(finger.indentation)
    if not state.contact.touching or not finger.area > 0.0:
        return
    noise, filters = config.noise, state.filters
    h = np.empty(area_filter.STATES)
    area_filter.observation_row(noise, normal_force, limit, state.sensitivities.area, 1.0, h)
    offset = _offset(state, state.sensitivities.area)
    error, variance = area_filter.estimate(filters, noise, h, offset, stamp, True)
    own_gain, slope = _pose_gain(config, finger.area)
    area = finger.area * own_gain * math.exp(error)
    row.model_area = finger.area * own_gain
    row.area = area
    row.area_force_slope = finger.area_force_slope * own_gain * (1.0 + slope) * math.exp(error)
    of_area, of_pressure = _force_variances(
        config, state, normal_force, row.area_force_slope * normal_force / area
    )
    row.area_stddev = area * area_filter.deviation_of(variance + of_area)
    row.radius = math.sqrt(area / math.pi)
    row.radius_stddev = row.radius * area_filter.deviation_of(0.25 * (variance + of_area))
    pressure = normal_force / area
    variance += of_pressure
    row.mean_pressure = pressure
    row.mean_pressure_stddev = pressure * area_filter.deviation_of(variance)
    peak_mean, peak_sd = _at_force(config.peak, normal_force)
    row.peak_pressure = finger.peak_pressure * math.exp(peak_mean - error) / own_gain
    if normal_force > limit:
        # The model's force ends there; as the mean pressure does, it grows on with the force.
        row.peak_pressure *= normal_force / limit
    row.peak_pressure_stddev = row.peak_pressure * area_filter.deviation_of(
        variance + PEAK_DEVIATION * PEAK_DEVIATION + peak_sd * peak_sd
    )
    # Gains and the contact's own error: half in length (see GAIN_OF_INDENTATION), and that half
    # uncertain.
    gain = area_filter.GAIN_OF_INDENTATION
    area_filter.observation_row(
        noise, normal_force, limit, state.sensitivities.indentation, gain, h
    )
    offset = _offset(state, state.sensitivities.indentation)
    deeper, spread = area_filter.estimate(filters, noise, h, offset, stamp, False)
    h[area_filter.TISSUE] = h[area_filter.MOISTURE] = 0.0
    shared, _ = area_filter.estimate(filters, noise, h, 0.0, stamp, False)
    mean, sd = _at_force(config.indentation, normal_force)
    spread += shared * shared + INDENTATION_DEVIATION * INDENTATION_DEVIATION + sd * sd
    row.indentation = finger.indentation * math.exp(mean + deeper)
    row.indentation_stddev = row.indentation * area_filter.deviation_of(spread)


@njit(cache=True)
def _inflate_deviations(row):
    """Deviations as large as the values: there may be no contact at all."""
    row.area_stddev = max(row.area_stddev, row.area)
    row.radius_stddev = max(row.radius_stddev, row.radius)
    row.indentation_stddev = max(row.indentation_stddev, row.indentation)
    row.mean_pressure_stddev = max(row.mean_pressure_stddev, row.mean_pressure)
    row.peak_pressure_stddev = max(row.peak_pressure_stddev, row.peak_pressure)


@njit(cache=True)
def _write_unknown(row):
    """Fields of the contact at a sample that the model could not follow."""
    row.indentation = math.nan
    row.model_area = row.area = row.area_stddev = row.area_force_slope = math.nan
    row.radius = row.mean_pressure = row.peak_pressure = math.nan
    row.radius_stddev = row.indentation_stddev = math.nan
    row.mean_pressure_stddev = row.peak_pressure_stddev = math.nan


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
def process(model, configuration, states, stamps, forces, areas, rows):
    """Process wrench samples of increasing stamps, and the measured areas that come due.

    model: ModelRecords with the copies of `sensitivities`; configuration (1,), states (1,):
    CONFIGURATION, STATE; stamps (n,), forces (n, 3): ns, N; areas (k,): AREA in the order of their
    stamps, all due by the last sample. Fills rows (n,) of ESTIMATE_DTYPE but for `parameter_set`.
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
            _advance_model(model, config, state, stamp, normal_force)
            _update_noise(state.stream, stamp, normal_force, a, b)
            if _is_beyond(model, normal_force):
                flags |= FLAG.FORCE_OUT_OF_RANGE
            if (
                lateral_force > config.lateral_ratio * max(normal_force, 0.0)
                and normal_force >= config.liftoff_force
            ):
                flags |= FLAG.LATERAL_LOAD
        else:
            flags |= FLAG.FORCE_INVALID
        limit = _limit(model)  # of the finger that an onset may have moved
        while used < len(areas) and areas[used].stamp + config.fusion_delay <= stamp:
            area = areas[used]
            if not _fuse(config, state, area.stamp, area.area, area.sd, limit):
                state.counters.rejected_areas += 1
                flags |= FLAG.AREA_REJECTED
            used += 1
        failed = not math.isfinite(model.states[0].area)
        if valid and failed:
            flags |= FLAG.MODEL_FAILED
        if valid and not failed:
            _write_contact(config, state, model.states[0], normal_force, limit, stamp, row)
        else:
            _write_unknown(row)
        if state.filters.mismatch:
            flags |= FLAG.MODEL_MISMATCH
        if _offset_suspected(state.contact, stamp):
            flags |= FLAG.FORCE_OFFSET
            _inflate_deviations(row)
        row.stamp_ns = stamp
        row.normal_force = normal_force
        row.lateral_force = lateral_force
        row.in_contact = state.contact.touching
        row.onset_ns = state.contact.onset
        flags |= _write_measurement(config, state.contact, stamp, row)
        flags |= _write_moisture(config, stamp, row)
        row.flags = flags


@njit(cache=True)
def initialise_filters(model, configuration, states):
    """Filters and model as for a finger not seen before, with no area fused."""
    config, state = configuration[0], states[0]
    for bank in (state.filters, state.before):
        area_filter.initialise(bank, config.noise, config.moisture_stamp)
    state.contact.has_fused = False
    sensitivities.set_shift(state.sensitivities, state.filters.start[area_filter.TISSUE])
    _apply_constants(model, state)


@njit(cache=True)
def new_reading(configuration, states):
    """The filters' error of the moisture as after a new reading."""
    config, state = configuration[0], states[0]
    for bank in (state.filters, state.before):
        area_filter.new_reading(bank, config.noise, config.moisture_stamp)


@njit(cache=True)
def _fused_error(config, state, finger, limit, bounded):
    """Logarithm of the fused area over the model's now, `limit` (N) of whose force is `finger`."""
    h = np.empty(area_filter.STATES)
    area_filter.observation_row(config.noise, finger.force, limit, state.sensitivities.area, 1.0, h)
    offset = _offset(state, state.sensitivities.area)
    stamp = state.stream.model_stamp
    return area_filter.estimate(state.filters, config.noise, h, offset, stamp, bounded)[0]


@njit(cache=True)
def held_area(model, configuration, states):
    """Logarithm of the fused area (m²) that was measured in this contact; NaN without one."""
    config, state = configuration[0], states[0]
    if not (state.contact.touching and state.filters.measured and model.states[0].area > 0.0):
        return math.nan
    gain, _ = _pose_gain(config, model.states[0].area)
    error = _fused_error(config, state, model.states[0], _limit(model), True)
    return math.log(gain * model.states[0].area) + error


@njit(cache=True)
def change_parameters(model, configuration, states, held):
    """Let the model have changed constants `model.base`, or another pose; held: `held_area` before.

    A contact of which an area was measured goes on with the constants it has until it ends: they
    tell no more of it than the area does, and tissue does not relax anew when it is asked how moist
    it is. Its own error takes up what pose and filters changed.
    """
    config, state = configuration[0], states[0]
    state.contact.constants_outdated = True
    if math.isnan(held):
        _apply_constants(model, state)
        return
    memory = state.memory
    gain, _ = _pose_gain(config, model.states[0].area)
    # Areas that are under way are compared with the model as it is now.
    moved = math.log(gain * model.states[0].area / memory.area[(memory.next - 1) % REMEMBERED])
    memory.area[:] *= math.exp(moved)
    error = _fused_error(config, state, model.states[0], _limit(model), False)
    own = held - math.log(gain * model.states[0].area) - error
    area_filter.shift_contact(state.filters, own, -moved)


@njit(cache=True)
def begin_contact(model, configuration, states):
    """Filters and model as at an onset now; all of these records are copies, of a finger in the
    air."""
    config, state = configuration[0], states[0]
    area_filter.begin_contact(state.filters, config.noise, state.stream.last_stamp)
    sensitivities.set_shift(state.sensitivities, state.filters.start[area_filter.TISSUE])
    _apply_constants(model, state)


@njit(cache=True)
def predicted(model, scratch, configuration, states, time, force, table):
    """Fused area (m²), indentation (m) and peak pressure (Pa) (n, 3) under a future force.

    model.states go along, scratch (1,) is of SENSITIVITIES; time (n,) in s from now, force (n,) in
    N. NaN from the first row on that the model cannot follow.
    """
    config, state = configuration[0], states[0]
    filters, noise = state.filters, config.noise
    found = np.empty((len(time), 3 + 2 * sensitivities.DIRECTIONS))
    first = sensitivities.simulate(model, scratch, 0.0, time, force, found)
    found[first:, :3] = math.nan
    h = np.empty(area_filter.STATES)
    gain, limit = area_filter.GAIN_OF_INDENTATION, model.constants[0].force_limit
    for i in range(len(time)):
        table[i] = found[i, :3]
        if found[i, 0] > 0.0:
            sensitivity = found[i, 3 : 3 + sensitivities.DIRECTIONS]
            area_filter.observation_row(noise, force[i], limit, sensitivity, 1.0, h)
            offset = _offset(state, sensitivity)
            error, _ = area_filter.estimate(filters, noise, h, offset, filters.stamp, True)
            own_gain, _ = _pose_gain(config, found[i, 0])
            table[i, 0] *= own_gain * math.exp(error)
            table[i, 2] *= math.exp(_at_force(config.peak, force[i])[0] - error) / own_gain
            sensitivity = found[i, 3 + sensitivities.DIRECTIONS :]
            area_filter.observation_row(noise, force[i], limit, sensitivity, gain, h)
            offset = _offset(state, sensitivity)
            deeper, _ = area_filter.estimate(filters, noise, h, offset, filters.stamp, False)
            table[i, 1] *= math.exp(_at_force(config.indentation, force[i])[0] + deeper)
