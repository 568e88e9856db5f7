"""Streaming estimate of a finger's contact from force, measured area and moisture.

    estimator = ContactEstimator(ReducedModel.load())
    for stamp_ns, force in wrenches:
        for estimate in estimator.add_wrench(stamp_ns, force):
            print(estimate.area, estimate.area_stddev)

Rules of input, all by the stamps the samples carry (int, ns), never by when they arrive:

- **Wrench samples** may be irregular. Between two samples the force runs linearly, however long the gap; after more
  than `gap_limit` the later sample is flagged. A sample stamped like the newest is a duplicate and is dropped; one
  older than that is out of order, is dropped and flags the next estimate; one older by more than
  `time_reset_after` is a jump of time: everything is forgotten and the sample is the first of a new stream. A force
  that is not finite gives an estimate flagged invalid and leaves the state; the next valid sample bridges it.
- **Areas and moisture readings** stamped t enter at the first wrench sample stamped t + `fusion_delay` or later. One
  that is handed over after such a sample is not used, is counted and flags the next estimate.
- **Events** (reset, parameters, settings) take effect before the first wrench sample stamped like them or later.

So the output is a function of stamped inputs alone: the same inputs give the same numbers, bit for bit, live and
from a bag, one by one (`add_wrench`) or many at once (`add_wrenches`).

Contact begins at `onset_force` and ends below `liftoff_force`. In the air areas and pressures are zero while the
internal strain keeps relaxing. Below the lift-off force the model still follows the force, so that noise in the air
leaves no trace in the strain.
"""

from __future__ import annotations

import bisect
import copy
import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from finger_common.errors import InputError

from ..flags import StateFlag
from ..history import ContactHistory, check_force_history
from ..parameter_sets import ParameterSets
from ..reduced import kernels as rk
from ..reduced.model import ReducedModel
from . import kernels as ek
from .settings import AXES, EstimatorSettings

TIME_JUMP = "time jumped back"
"""Reason of the reset that a jump of the clock caused."""


class EventType(IntEnum):
    """Kinds of event, numbered as in ModelEvent."""

    START = 0
    RESET = 1
    PARAMETERS = 2
    SETTINGS = 3


@dataclass(frozen=True)
class EstimatorEvent:
    """A change that is not in the estimator's inputs, as published on `model_events`.

    stamp_ns: takes effect before the first wrench sample stamped like this or later.
    settings, parameter_sets: JSON and YAML text in force after the event.
    late_areas, late_moistures: stamps of inputs that had arrived too late and were not used.
    """

    stamp_ns: int
    type: EventType
    settings: str
    parameter_sets: str
    model_hash: str = ""
    reason: str = ""
    late_areas: tuple[int, ...] = ()
    late_moistures: tuple[int, ...] = ()


class ContactEstimate(NamedTuple):
    """State of the contact at one wrench sample: fields, units and flags as in ContactState (SI).

    Values that are not known are NaN; ages in s; `onset_ns` 0 before the first contact.
    """

    normal_force: float
    lateral_force: float
    model_area: float
    measured_area: float
    measured_area_age: float
    area: float
    area_stddev: float
    area_force_slope: float
    radius: float
    indentation: float
    mean_pressure: float
    peak_pressure: float
    moisture: float
    moisture_age: float
    stamp_ns: int
    flags: int
    in_contact: bool
    onset_ns: int
    parameter_set: str


@dataclass
class EstimateBlock:
    """Estimates of n samples as columns.

    values (n, COLUMNS) in the order of ContactEstimate's floating-point fields, whole (n, 4): stamp_ns, flags,
    in_contact, onset_ns; parameter_set: one id per row.
    """

    values: np.ndarray
    whole: np.ndarray
    parameter_set: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[ContactEstimate]:
        for row, whole, name in zip(self.values.tolist(), self.whole.tolist(), self.parameter_set):
            yield ContactEstimate._make([*row, whole[0], whole[1], bool(whole[2]), whole[3], name])

    def column(self, name: str) -> np.ndarray:
        """One floating-point field of ContactEstimate (n,)."""
        return self.values[:, ContactEstimate._fields.index(name)]


class ContactEstimator:
    """Contact state from a stream of forces, corrected by measured areas, with parameters that follow moisture.

    model: the reduced model; parameter_sets: None for the shipped ones; settings: None for the defaults.
    `counters` counts duplicates, out_of_order, resets, late_areas, late_moistures, flagged_areas.
    Raises InputError for parameter sets that were fitted with another geometry.
    """

    def __init__(
        self,
        model: ReducedModel,
        parameter_sets: ParameterSets | None = None,
        settings: EstimatorSettings | None = None,
    ) -> None:
        self.model = model
        self.settings = settings or EstimatorSettings()
        self.parameter_sets = parameter_sets or ParameterSets.default()
        self._check_sets(self.parameter_sets)
        self.counters: Counter[str] = Counter()
        self._state = np.zeros(model.state_size)
        self._real = np.zeros(ek.REAL_SIZE)
        self._whole = np.zeros(ek.WHOLE_SIZE, np.int64)
        self._ring_stamp = np.zeros(ek.RING, np.int64)
        self._ring = np.zeros((ek.RING, 2))
        self._cfg = np.zeros(ek.CFG_SIZE)
        self._areas_stamp: list[int] = []
        self._areas: list[tuple[float, float]] = []
        self._areas_seen: deque[int] = deque(maxlen=64)
        self._moistures: list[tuple[int, float]] = []
        self._events: list[EstimatorEvent] = []
        self._jumps: set[int] = set()
        self._known_late: set[tuple[str, int]] = set()
        self._moisture: float | None = None
        self._constants = np.zeros(0)
        self._name = ""
        self._one_stamp = np.zeros(1, np.int64)
        self._one_force = np.zeros((1, 3))
        self._none_stamp = np.zeros(0, np.int64)
        self._none_area = np.zeros((0, 2))
        self._forget()

    # Inputs ----------------------------------------------------------------------------------

    def add_wrench(self, stamp_ns: int, force: Sequence[float]) -> list[ContactEstimate]:
        """Take one sample: force (3,) in N, in the sensor's axes. Gives one estimate, or none when it is dropped."""
        if not self._accept(stamp_ns):
            return []
        self._apply_due(stamp_ns)
        self._one_stamp[0] = stamp_ns
        row = self._one_force[0]
        row[0], row[1], row[2] = force[0], force[1], force[2]
        out = np.empty((1, ek.COLUMNS))
        whole = np.empty((1, ek.WHOLE_COLUMNS), np.int64)
        self._stream(self._one_stamp, self._one_force, out, whole)
        stamp, flags, contact, onset = whole[0].tolist()
        return [
            ContactEstimate._make(
                [*out[0].tolist(), stamp, flags, bool(contact), onset, self._name]
            )
        ]

    def add_wrenches(self, stamps_ns: np.ndarray, forces: np.ndarray) -> EstimateBlock:
        """Take many samples, stamps (n,) and forces (n, 3) in N, in the order they came: as `add_wrench`, but fast.

        Rows of dropped samples are left out of the block.
        """
        stamps = np.ascontiguousarray(stamps_ns, dtype=np.int64)
        forces = np.ascontiguousarray(forces, dtype=float)
        if forces.shape != (len(stamps), 3):
            raise InputError(f"forces have shape {forces.shape}, ({len(stamps)}, 3) is needed")
        blocks: list[EstimateBlock] = []
        at = 0
        while at < len(stamps):
            if not self._accept(int(stamps[at])):
                at += 1
                continue
            self._apply_due(int(stamps[at]))
            # As far as stamps increase and no event or reading comes due.
            steps = np.flatnonzero(np.diff(stamps[at:]) <= 0)
            end = at + int(steps[0]) + 1 if len(steps) else len(stamps)
            due = self._next_due()
            if due is not None:
                end = min(end, at + int(np.searchsorted(stamps[at:end], due)))
            end = max(end, at + 1)
            out = np.empty((end - at, ek.COLUMNS))
            whole = np.empty((end - at, ek.WHOLE_COLUMNS), np.int64)
            self._stream(stamps[at:end], forces[at:end], out, whole)
            blocks.append(EstimateBlock(out, whole, [self._name] * (end - at)))
            at = end
        if len(blocks) == 1:
            return blocks[0]
        return EstimateBlock(
            np.concatenate([b.values for b in blocks]) if blocks else np.empty((0, ek.COLUMNS)),
            np.concatenate([b.whole for b in blocks])
            if blocks
            else np.empty((0, ek.WHOLE_COLUMNS), np.int64),
            [name for b in blocks for name in b.parameter_set],
        )

    def add_area(self, stamp_ns: int, area: float, sd: float, flags: int = 0) -> bool:
        """Take a measured gross area and its standard deviation (m²); flags as in ContactArea.

        False when it comes too late to be used (the next estimate is flagged). A second one of a stamp is left out.
        """
        if ("area", stamp_ns) in self._known_late:
            return False
        if stamp_ns in self._areas_seen:
            self.counters["duplicate_areas"] += 1
            return True
        if self._is_late(stamp_ns):
            self.counters["late_areas"] += 1
            self._whole[ek.PENDING_FLAGS] |= StateFlag.AREA_LATE
            return False
        if not self.settings.fuse_area:
            return True
        if flags & self.settings.rejected_area_flags:
            # Kept as an entry that cannot be fused: it is flagged in its turn, not when it arrives.
            self.counters["flagged_areas"] += 1
            area = math.nan
        self._areas_seen.append(stamp_ns)
        at = bisect.bisect_right(self._areas_stamp, stamp_ns)
        self._areas_stamp.insert(at, int(stamp_ns))
        self._areas.insert(at, (float(area), float(sd)))
        return True

    def add_moisture(self, stamp_ns: int, value: float) -> bool:
        """Take a moisture reading (a.u.); false when it comes too late or is not a number from 0 to 130."""
        if ("moisture", stamp_ns) in self._known_late:
            return False
        if self._is_late(stamp_ns):
            self.counters["late_moistures"] += 1
            self._whole[ek.PENDING_FLAGS] |= StateFlag.MOISTURE_LATE
            return False
        if not (math.isfinite(value) and 0.0 <= value <= 130.0):
            self.counters["bad_moistures"] += 1
            return False
        bisect.insort(self._moistures, (int(stamp_ns), float(value)))
        return True

    def apply_event(self, event: EstimatorEvent) -> None:
        """Take a recorded event; it takes effect by its stamp. Raises InputError for one of another model."""
        if event.model_hash and event.model_hash != self.model.hash:
            raise InputError(
                f"the event was recorded with reduced model {event.model_hash[:8]}, this one is "
                f"{self.model.hash[:8]}; use the same model file"
            )
        if event.type == EventType.RESET and event.reason == TIME_JUMP:
            # Its stamp lies before samples already taken; it belongs to the sample that steps back to it.
            self._jumps.add(event.stamp_ns)
            return
        bisect.insort(self._events, event, key=lambda e: e.stamp_ns)

    def expect_late(self, events: Iterable[EstimatorEvent]) -> None:
        """Leave out the areas and readings that these recorded events say had come too late."""
        for event in events:
            self._known_late.update(("area", stamp) for stamp in event.late_areas)
            self._known_late.update(("moisture", stamp) for stamp in event.late_moistures)

    # Changes ---------------------------------------------------------------------------------

    def reset(self, reason: str = "asked for") -> EstimatorEvent:
        """Back to a finger at rest, not seen before; the moisture reading stays. Returns the event to record."""
        return self._happen(EventType.RESET, reason=reason)

    def change_settings(self, settings: EstimatorSettings, reason: str = "") -> EstimatorEvent:
        """New settings from the next sample on; the state goes on. Returns the event to record."""
        return self._happen(EventType.SETTINGS, settings=settings, reason=reason)

    def change_parameters(self, sets: ParameterSets, reason: str = "") -> EstimatorEvent:
        """New parameter sets from the next sample on; the state goes on. Returns the event to record.

        Raises InputError for sets fitted with another geometry.
        """
        self._check_sets(sets)
        return self._happen(EventType.PARAMETERS, sets=sets, reason=reason)

    def clock_jump_event(self, stamp_ns: int) -> EstimatorEvent:
        """Forget everything: a clock jumped back, and the next sample has this stamp. Returns the event to record."""
        self.jump_back(stamp_ns)
        return replace(self._event(EventType.RESET, TIME_JUMP), stamp_ns=int(stamp_ns))

    def note_late(self, areas: Sequence[int] = (), moistures: Sequence[int] = ()) -> EstimatorEvent:
        """Event that records which inputs had come too late, so that a replay leaves them out too."""
        event = self._event(EventType.SETTINGS, "inputs came too late to be used")
        return replace(event, late_areas=tuple(areas), late_moistures=tuple(moistures))

    def start_event(self, stamp_ns: int, reason: str = "start") -> EstimatorEvent:
        """Event that says with what the estimator begins at the sample of this stamp."""
        return replace(self._event(EventType.START, reason), stamp_ns=int(stamp_ns))

    # Questions -------------------------------------------------------------------------------

    @property
    def last_stamp(self) -> int | None:
        """Stamp (ns) of the newest wrench sample, None before the first."""
        return int(self._whole[ek.LAST_STAMP]) if self._whole[ek.STARTED] else None

    @property
    def parameters(self) -> np.ndarray:
        """[E0, E1, tau1, E2] (4,) in force."""
        return self._parameters.copy()

    @property
    def force_limit(self) -> float:
        """Largest force (N) the model was built for with the parameters in force."""
        return float(self._constants[rk.FORCE_LIMIT])

    def statistics(self) -> dict[str, int]:
        """Counts since the start or the last reset: fused, rejected, gaps, contacts, and `counters`."""
        return {
            "fused_areas": int(self._whole[ek.FUSED]),
            "rejected_areas": int(self._whole[ek.REJECTED]),
            "gaps": int(self._whole[ek.GAPS]),
            "contacts": int(self._whole[ek.CONTACTS]),
            **self.counters,
        }

    def predict(self, time: np.ndarray, force: np.ndarray) -> ContactHistory:
        """Contact under a future force: time (n,) in s from now, increasing, > 0; force (n,) in N.

        The area is the fused one: the model's with the error found so far. The state stays as it is. Raises
        InputError for a bad history or a force beyond the model's limit.
        """
        time, force = check_force_history(time, force, "force to predict")
        if time[0] <= 0:
            raise InputError(
                f"force to predict: time begins at {time[0]:g} s; give times from now, above 0"
            )
        self._check_force(float(force.max()))
        state = self._state.copy()
        table = np.empty((len(time), 3))
        before = 0.0
        for i in range(len(time)):
            rk.advance(self.model.weights, self._constants, state, time[i] - before, force[i])
            rk.outputs(self.model.weights, self._constants, state)
            before = time[i]
            table[i] = (
                self._with_bias(force[i], state[rk.AREA]),
                state[rk.INDENTATION],
                state[rk.PEAK],
            )
        area = table[:, 0]
        mean = np.divide(force, area, out=np.zeros_like(area), where=area > 0)
        return ContactHistory(
            time, force, area, np.sqrt(area / math.pi), table[:, 1], table[:, 2], mean
        )

    def force_for_area(self, area: float, horizon: float = 0.0) -> float:
        """Normal force (N) that, applied now and held for `horizon` (s), gives this area (m²), by bisection.

        Raises InputError for an area that is not positive or beyond what the force limit gives.
        """
        if not (math.isfinite(area) and area > 0):
            raise InputError(f"area is {area} m², a positive area is needed")
        if not (math.isfinite(horizon) and 0 <= horizon <= 3600):
            raise InputError(f"horizon is {horizon} s, 0 to 3600 s is needed")

        def area_at(force: float) -> float:
            state = self._state.copy()
            rk.advance(self.model.weights, self._constants, state, 0.0, force)
            steps = 20 if horizon > 0 else 0
            for _ in range(steps):
                rk.advance(self.model.weights, self._constants, state, horizon / steps, force)
            model_area = rk.area_now(self.model.weights, self._constants, state)
            return self._with_bias(force, model_area)

        low, high = 0.0, self.force_limit
        if area_at(high) < area:
            raise InputError(
                f"area {area * 1e6:.1f} mm² is beyond the {area_at(high) * 1e6:.1f} mm² that the "
                f"largest force of the model ({high:.2f} N) gives; ask for less"
            )
        for _ in range(40):
            middle = 0.5 * (low + high)
            if area_at(middle) < area:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    # Inside ----------------------------------------------------------------------------------

    def _with_bias(self, force: float, model_area: float) -> float:
        if model_area <= 0:
            return 0.0
        stamp = self._whole[ek.FILTER_TIME]
        real = self._real
        return float(ek.fused_area(real, self._whole, self._cfg, force, model_area, stamp)[0])

    def _check_force(self, force: float) -> None:
        if force > self.force_limit:
            raise InputError(
                f"force {force:.2f} N is beyond the model's limit of {self.force_limit:.2f} N for "
                "these parameters; ask for less"
            )

    def _check_sets(self, sets: ParameterSets) -> None:
        if sets.geometry_hash and sets.geometry_hash != self.model.geometry_hash:
            raise InputError(
                f"the parameter sets were fitted with geometry {sets.geometry_hash[:8]}, the reduced "
                f"model is for {self.model.geometry_hash[:8]}; fit again or load the model of that geometry"
            )

    def _is_late(self, stamp_ns: int) -> bool:
        if not self._whole[ek.STARTED]:
            return False
        return stamp_ns + int(self._cfg[ek.DELAY_NS]) <= int(self._whole[ek.LAST_STAMP])

    def _accept(self, stamp_ns: int) -> bool:
        """Apply the rules for duplicates, out-of-order samples and jumps of time."""
        if not self._whole[ek.STARTED]:
            return True
        step = stamp_ns - int(self._whole[ek.LAST_STAMP])
        if step > 0:
            return True
        if stamp_ns in self._jumps:
            # Recorded by a node that saw its clock jump back to here.
            self._jumps.discard(stamp_ns)
            self.jump_back(stamp_ns)
            return True
        if step == 0:
            self.counters["duplicates"] += 1
            return False
        if -step * 1e-9 <= self.settings.time_reset_after:
            self.counters["out_of_order"] += 1
            self._whole[ek.PENDING_FLAGS] |= StateFlag.OUT_OF_ORDER
            return False
        self.counters["resets"] += 1
        self.jump_back(stamp_ns)
        return True

    def jump_back(self, stamp_ns: int | None = None) -> None:
        """Time jumped back (to `stamp_ns`): forget everything of a later time; the next estimate is flagged."""
        keep = [
            (s, a)
            for s, a in zip(self._areas_stamp, self._areas)
            if stamp_ns is not None and abs(s - stamp_ns) < 10**9
        ]
        self._areas_seen.clear()
        self._areas_stamp = [s for s, _ in keep]
        self._areas = [a for _, a in keep]
        self._moistures = [
            m for m in self._moistures if stamp_ns is not None and abs(m[0] - stamp_ns) < 10**9
        ]
        self._moisture = None
        self._forget()
        self._whole[ek.PENDING_FLAGS] |= StateFlag.TIME_RESET

    def _next_due(self) -> int | None:
        due = [e.stamp_ns for e in self._events[:1]]
        due += [m[0] + int(self._cfg[ek.DELAY_NS]) for m in self._moistures[:1]]
        return min(due) if due else None

    def _apply_due(self, stamp_ns: int) -> None:
        while self._events and self._events[0].stamp_ns <= stamp_ns:
            self._take(self._events.pop(0))
        if self._moistures:
            delay = int(self._cfg[ek.DELAY_NS])
            while self._moistures and self._moistures[0][0] + delay <= stamp_ns:
                stamp, self._moisture = self._moistures.pop(0)
                self._whole[ek.MOISTURE_STAMP] = stamp
                self._whole[ek.HAS_MOISTURE] = 1
                self._follow_moisture()

    def _stream(
        self, stamps: np.ndarray, forces: np.ndarray, out: np.ndarray, whole: np.ndarray
    ) -> None:
        due = bisect.bisect_right(self._areas_stamp, int(stamps[-1]) - int(self._cfg[ek.DELAY_NS]))
        if due:
            areas_stamp = np.array(self._areas_stamp[:due], np.int64)
            areas = np.array(self._areas[:due], float)
        else:
            areas_stamp, areas = self._none_stamp, self._none_area
        taken = ek.stream(
            self.model.weights,
            self._constants,
            self._state,
            self._real,
            self._whole,
            self._ring_stamp,
            self._ring,
            self._cfg,
            stamps,
            forces,
            areas_stamp,
            areas,
            out,
            whole,
        )
        if taken:
            del self._areas_stamp[:taken]
            del self._areas[:taken]

    def _event(self, kind: EventType, reason: str) -> EstimatorEvent:
        last = self.last_stamp
        return EstimatorEvent(
            0 if last is None else last + 1,
            kind,
            self.settings.to_json(),
            self.parameter_sets.to_yaml(),
            self.model.hash,
            reason,
        )

    def _happen(
        self,
        kind: EventType,
        settings: EstimatorSettings | None = None,
        sets: ParameterSets | None = None,
        reason: str = "",
    ) -> EstimatorEvent:
        event = self._event(kind, reason)
        if settings is not None:
            event = replace(event, settings=settings.to_json())
        if sets is not None:
            event = replace(event, parameter_sets=sets.to_yaml())
        self._take(event)
        return event

    def _take(self, event: EstimatorEvent) -> None:
        self.settings = EstimatorSettings.from_json(event.settings)
        changed = False
        # Events come often, as with every late area, and reading the sets takes longer than a sample may wait.
        if event.parameter_sets != self.parameter_sets.to_yaml():
            sets = ParameterSets.parse(event.parameter_sets, "recorded parameter sets")
            changed = sets.hash != self.parameter_sets.hash
            self.parameter_sets = sets
        if event.late_areas:
            self.counters["late_areas"] += len(event.late_areas)
            self._whole[ek.PENDING_FLAGS] |= StateFlag.AREA_LATE
        if event.late_moistures:
            self.counters["late_moistures"] += len(event.late_moistures)
            self._whole[ek.PENDING_FLAGS] |= StateFlag.MOISTURE_LATE
        if event.type == EventType.START:
            self._moisture = None
            self._forget()
            return
        if event.type == EventType.RESET:
            # The stream of samples and the moisture reading go on.
            kept = [ek.LAST_STAMP, ek.MODEL_STAMP, ek.STARTED, ek.MOISTURE_STAMP, ek.HAS_MOISTURE]
            values = self._whole[kept]
            self._forget()
            self._whole[kept] = values
            return
        self._configure()
        if changed:
            ek.reset_filter(self._real, self._cfg)
            if self._whole[ek.CONTACT]:
                self._whole[ek.FILTER_TIME] = self._whole[ek.LAST_STAMP]

    def _forget(self) -> None:
        """A finger at rest that was not seen before, with no sample taken yet."""
        flags = self._whole[ek.PENDING_FLAGS]
        self._whole[:] = 0
        self._whole[ek.PENDING_FLAGS] = flags
        self._configure()
        rk.rest(self.model.weights, self._constants, self._state)
        ek.reset_filter(self._real, self._cfg)

    def _configure(self) -> None:
        """Settings into the compiled core's array, and the parameters of the moisture in use."""
        s, cfg = self.settings, self._cfg
        axis = AXES.index(s.normal_axis)
        cfg[ek.AXIS] = axis // 2
        cfg[ek.SIGN] = 1.0 if axis % 2 == 0 else -1.0
        cfg[ek.ONSET_FORCE] = s.onset_force
        cfg[ek.LIFTOFF_FORCE] = s.liftoff_force
        cfg[ek.LATERAL_RATIO] = s.lateral_ratio
        cfg[ek.GAP_LIMIT] = s.gap_limit
        cfg[ek.DELAY_NS] = round(s.fusion_delay * 1e9)
        cfg[ek.OUTLIER_LIMIT] = s.outlier_limit
        cfg[ek.AREA_STALE] = s.area_stale_after
        cfg[ek.MOISTURE_STALE] = s.moisture_stale_after
        cfg[ek.CONTACT_VARIANCE] = s.contact_area_sd**2
        cfg[ek.SLOPE_VARIANCE] = s.slope_sd**2
        cfg[ek.DRIFT_VARIANCE] = s.drift_sd**2
        cfg[ek.MODEL_VARIANCE] = self.model.rms_error**2
        self._follow_moisture()

    def _follow_moisture(self) -> None:
        """Parameters at the reading in use, or at the default one."""
        value = self.settings.default_moisture if self._moisture is None else self._moisture
        self._cfg[ek.MOISTURE_VALUE] = value
        found = self.parameter_sets.interpolate(value)
        self._parameters = found.parameters
        self._constants = self.model.constants(found.parameters)
        self._name = found.name
        flags = StateFlag(0)
        if self._moisture is None:
            flags |= StateFlag.MOISTURE_MISSING
        elif found.out_of_range:
            flags |= StateFlag.MOISTURE_OUT_OF_RANGE
        if self.model.out_of_range(found.parameters):
            flags |= StateFlag.PARAMETERS_OUT_OF_RANGE
        self._whole[ek.STATE_FLAGS] = int(flags)
        self._cfg[ek.PRIOR_VARIANCE] = self.settings.prior_area_sd**2 + self._area_variance(found)
        rk.refresh(self.model.weights, self._constants, self._state)

    def _area_variance(self, found: Any) -> float:
        """Variance of ln A that the covariance of the parameters brings, for 1 N reached in 1 s."""
        if not np.any(found.covariance_log):
            return 0.0
        time, force = np.linspace(0.05, 1.0, 20), np.linspace(0.05, 1.0, 20)
        step = 0.05
        shifted = np.exp(np.log(found.parameters) + step * np.vstack([np.eye(4), -np.eye(4)]))
        areas = np.log(self.model.batch(shifted, [(time, force)])[0][:, -1])
        slope = (areas[:4] - areas[4:]) / (2 * step)
        return float(max(slope @ found.covariance_log @ slope, 0.0))

    def copy(self) -> ContactEstimator:
        """An estimator in the same state that goes its own way; the model is shared."""
        return copy.deepcopy(self, {id(self.model): self.model})


def replay(
    estimator: ContactEstimator,
    wrenches: Iterable[tuple[np.ndarray, np.ndarray]],
    areas: Sequence[tuple[int, float, float, int]] = (),
    moistures: Sequence[tuple[int, float]] = (),
    events: Sequence[EstimatorEvent] = (),
) -> Iterator[EstimateBlock]:
    """Run recorded inputs through an estimator; gives what a live node made of them, bit for bit.

    wrenches: blocks of stamps (n,) and forces (n, 3), in the order recorded; areas: (stamp_ns, area, sd, flags);
    moistures: (stamp_ns, value); events: all of the recording.
    """
    estimator.expect_late(events)
    for event in events:
        estimator.apply_event(event)
    for area in areas:
        estimator.add_area(*area)
    for moisture in moistures:
        estimator.add_moisture(*moisture)
    for stamps, forces in wrenches:
        yield estimator.add_wrenches(stamps, forces)
