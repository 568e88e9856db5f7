# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streaming estimate of a finger's contact from force, measured area and moisture.

    estimator = ContactEstimator(load_reduced())
    for stamp_ns, force in wrenches:
        for estimate in estimator.add_wrench(stamp_ns, force):
            print(estimate.area, estimate.area_stddev)

Rules of input, all by the stamps the samples carry (int, ns), never by when they arrive:

- **Wrench samples** may be irregular. Between two samples the force runs linearly, however long the
  gap; after more than `gap_limit` the later sample is flagged. A sample stamped like the newest is
  a duplicate and is dropped; one older than that is out of order, is dropped and flags the next
  estimate. One older by more than `time_reset_after`, or later by more than `FUTURE`, waits for
  the next sample: when that is later, by no more than `LONGEST_GAP`, both are processed, and after
  a step back the state is reset before. Otherwise, and where the next one goes on from before the
  step back, the stamp was wrong, and the sample that waits is dropped as out of order. A force that
  is not finite gives an estimate flagged invalid and leaves the state; the next valid sample
  bridges it.
- **Areas and moisture readings** stamped t enter at the first wrench sample stamped t +
  `fusion_delay` or later. One that is handed over after such a sample is not used, is counted and
  flags the next estimate. A reading in a contact of which an area was measured moves the model at
  the next onset only.
- **Events** (reset, parameters, settings, surface) take effect before the first wrench sample
  stamped like them or later.

So the output is a function of stamped inputs alone: the same inputs give the same numbers, bit for
bit, live and from a bag, one by one (`add_wrench`) or many at once (`add_wrenches`).

Contact begins at `onset_force` and ends below `liftoff_force`. In the air areas and pressures are
zero while the internal strain keeps relaxing. Below the lift-off force the model still follows the
force, so that noise in the air leaves no trace in the strain.
"""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from finger_common.errors import InputError, check_type
from finger_common.flags import StateFlag
from finger_common.stamps import NANOSECONDS, nanoseconds, stamp_array, whole_stamp

from ..geometry import StatedGeometry
from ..history import ContactHistory
from ..laws import MaxwellLaw
from ..parameter_sets import ParameterSets
from ..pose.correction import PoseCorrection
from ..pose.lengths import stretch_sd
from ..reduced.model import ReducedModel
from . import prediction
from .estimate import ESTIMATE_DTYPE, ContactEstimate, EstimateBlock
from .events import NO_FORCE, TIME_JUMP, EstimatorEvent, EventType
from .filter_state import FilterState, new_rows
from .inputs import InputQueue
from .mismatch import Mismatch
from .parameter_selection import SelectedParameters, check_sets, select_parameters
from .settings import EstimatorSettings

FUTURE = 2.0
"""s by which a sample may be ahead of the one before, and an area or reading of the newest sample
that a live node has, before its stamp may be wrong."""

LONGEST_GAP = 60.0
"""s by which the sample after one that waits may be later than it."""


_Selection = tuple[str, EstimatorSettings, float | None]
"""What parameters are selected for: hash of the sets, settings, moisture (a.u.)."""


class ContactEstimator:
    """Contact state from forces, corrected by measured areas; parameters follow moisture.

    model: the reduced model; parameter_sets: None for the shipped ones; settings: None for the
    defaults; stated: what a geometry.yaml states of a finger, None without. `counters` counts
    duplicates, out_of_order, resets, late_areas, late_moistures, flagged_areas, duplicate_areas;
    `fingers` counts starts and resets, after which the finger is one that was not seen before, and
    `surfaces` changes of the surface alone. `parameter_sets` have the lengths of the model's
    finger, unless it is the default one. `models` has those that a recorded start may change to, by
    their hash. Raises InputError for parameter sets of another geometry or law than the model's.
    """

    def __init__(
        self,
        model: ReducedModel,
        parameter_sets: ParameterSets | None = None,
        settings: EstimatorSettings | None = None,
        stated: StatedGeometry | None = None,
    ) -> None:
        check_type(model, ReducedModel, "model")
        self.model = model
        self.settings = EstimatorSettings() if settings is None else settings
        check_type(self.settings, EstimatorSettings, "settings")
        sets = ParameterSets.default() if parameter_sets is None else parameter_sets
        check_sets(sets, model)
        self.parameter_sets = sets.of_finger(model.geometry)
        self.models: Mapping[str, ReducedModel] = {model.hash: model}
        self.counters: Counter[str] = Counter()
        self.fingers = self.surfaces = 0
        self._inputs = InputQueue(self.counters)
        self._stated = stated
        self._state = self._fresh_state()
        self._events: list[EstimatorEvent] = []
        self._jumps: set[int] = set()
        self._after_jump: list[EstimatorEvent] = []
        self._moisture: tuple[int, float] | None = None
        self._waiting: tuple[int, Sequence[float]] | None = None
        self._selected_for: _Selection | None = None
        self._prepared: tuple[_Selection, SelectedParameters] | None = None
        self._one_stamp = np.zeros(1, np.int64)
        self._one_force = np.zeros((1, 3))
        self._configure()
        self._state.reset()

    def _fresh_state(self) -> FilterState:
        """Of the model's finger."""
        return FilterState(self.model, stretch_sd(self.model.geometry, self._stated))

    # Inputs ----------------------------------------------------------------------------------

    def add_wrench(self, stamp_ns: int, force: Sequence[float]) -> list[ContactEstimate]:
        """Estimates for a sample of force (3,) in N, in the sensor's axes.

        One as a rule; none for a sample that was dropped or waits, two when the one before had
        waited. Raises InputError for a stamp in seconds, with a point, and for another force than
        three numbers.
        """
        try:
            x, y, z = force
            sample = float(x), float(y), float(z)
        except (TypeError, ValueError):
            raise InputError(
                f"force is {force!r:.60}; three numbers in N are needed, (x, y, z)"
            ) from None
        admitted = self._admit(whole_stamp(stamp_ns), sample)
        return [self._estimate(*sample) for sample in admitted]

    def _estimate(self, stamp_ns: int, force: Sequence[float]) -> ContactEstimate:
        self._apply_due(stamp_ns)
        self._one_stamp[0] = stamp_ns
        row = self._one_force[0]
        row[0], row[1], row[2] = force[0], force[1], force[2]
        self._process(self._one_stamp, self._one_force, self._one_row)
        return ContactEstimate._make(self._one_row.item())

    def add_wrenches(self, stamps_ns: np.ndarray, forces: np.ndarray) -> EstimateBlock:
        """As `add_wrench` for many samples, in the order they came, but fast.

        stamps_ns (n,) whole numbers, forces (n, 3) in N. Rows of dropped samples are left out of
        the block. Raises InputError for stamps in seconds and for other shapes.
        """
        parts = [part.rows for _, part in self.wrench_parts(stamps_ns, forces)]
        return EstimateBlock(np.concatenate([np.empty(0, ESTIMATE_DTYPE), *parts]))

    def wrench_parts(
        self, stamps_ns: np.ndarray, forces: np.ndarray
    ) -> Iterator[tuple[int, EstimateBlock]]:
        """As `add_wrenches`, in parts; between two of them settings and parameters may change, and
        until the next is asked for the estimator has those of the last.

        Each with the number of the sample that its first estimate is of, which the others follow;
        −1 for the last sample of the call before, which had waited.
        """
        stamps = stamp_array(stamps_ns)
        forces = np.ascontiguousarray(forces, dtype=float)
        if forces.shape != (len(stamps), 3) and (len(stamps) or forces.size):
            raise InputError(f"forces have shape {forces.shape}, ({len(stamps)}, 3) is needed")
        at = 0
        while at < len(stamps):
            admitted = self._admit(int(stamps[at]), forces[at])
            if len(admitted) != 1:
                rows = [np.empty(0, ESTIMATE_DTYPE)]
                for sample in admitted:
                    self._estimate(*sample)
                    rows.append(self._one_row.copy())
                at += 1
                yield at - len(admitted), EstimateBlock(np.concatenate(rows))
                continue
            self._apply_due(int(stamps[at]))
            # As far as stamps increase by little and no event or reading comes due.
            change = np.diff(stamps[at:])
            steps = np.flatnonzero((change <= 0) | (change > FUTURE * NANOSECONDS))
            end = at + int(steps[0]) + 1 if len(steps) else len(stamps)
            due = self._next_due()
            if due is not None:
                end = min(end, at + int(np.searchsorted(stamps[at:end], due)))
            end = max(end, at + 1)
            block = EstimateBlock(new_rows(end - at, self._selected.name))
            self._process(stamps[at:end], forces[at:end], block.rows)
            begin, at = at, end
            yield begin, block

    def add_area(
        self, stamp_ns: int, area: float, sd: float, flags: int = 0, live: bool = False
    ) -> bool:
        """Add a measured gross area and its standard deviation (m²); flags as in ContactArea.

        False when it comes too late to be used (the next estimate is flagged). A second one of a
        stamp is left out, and one that a recorder wrote again (see `inputs.HELD_STEP`). live: one
        that is ahead of the samples by more than `FUTURE` has a wrong stamp, and counts as late;
        from a file inputs may come ahead of the samples. Raises InputError for a stamp with a
        point.
        """
        stamp_ns = whole_stamp(stamp_ns)
        if self._inputs.knows_late("area", stamp_ns):
            return False
        if self._inputs.count_duplicate(stamp_ns):
            return True
        if self._is_late(stamp_ns, live):
            self._count_late(areas=1)
            return False
        self._inputs.add_area(stamp_ns, area, sd, flags)
        if live and self.last_stamp is None:
            # A camera that runs for hours before the force sensor does.
            self._inputs.forget_areas_before(stamp_ns - round(FUTURE * NANOSECONDS))
        return True

    def add_moisture(self, stamp_ns: int, value: float, live: bool = False) -> bool:
        """Add a moisture reading (a.u.); false when it comes too late or is out of the scale.

        live: as for `add_area`. Raises InputError for a stamp with a point.
        """
        stamp_ns = whole_stamp(stamp_ns)
        if self._inputs.knows_late("moisture", stamp_ns):
            return False
        if self._is_late(stamp_ns, live):
            self._count_late(moistures=1)
            return False
        return self._inputs.add_moisture(stamp_ns, value)

    def prepare_moisture(self, value: float) -> None:
        """Compute what a reading (a.u.) that waits will change, so that its sample need not: for a
        finger of its own lengths that takes many milliseconds. Results stay the same.

        May be called in another thread while samples come.
        """
        sets, settings = self.parameter_sets, self.settings
        selected = select_parameters(self.model, sets, settings, value)
        self._prepared = (sets.hash, settings, value), selected

    def _is_late(self, stamp_ns: int, live: bool) -> bool:
        newest = self.last_stamp
        ahead = live and newest is not None and stamp_ns - newest > FUTURE * NANOSECONDS
        return ahead or self._inputs.is_late(stamp_ns, newest)

    def apply_event(self, event: EstimatorEvent) -> None:
        """Apply a recorded event, which takes effect by its stamp.

        Raises InputError for an event of a reduced model that is not in `models`.
        """
        if event.model_hash and event.model_hash not in self.models:
            raise InputError(
                f"the event was recorded with reduced model {event.model_hash[:8]}, this one is "
                f"{self.model.hash[:8]}; use the same model file"
            )
        if self._jumps:
            # Stamps of the time after the jump mean nothing before it.
            self._after_jump.append(event)
            return
        if event.is_time_jump:
            # Its stamp lies before samples already processed; it belongs to the sample that steps
            # back to it.
            self._jumps.add(event.stamp_ns)
            return
        bisect.insort(self._events, event, key=lambda e: e.stamp_ns)

    def go_on_from(self, other: ContactEstimator) -> None:
        """Take the areas that wait in the estimator of the finger before, as a recorded start
        leaves them to the finger after it."""
        self._inputs.take_areas(other._inputs)

    def expect_late(self, events: Iterable[EstimatorEvent]) -> None:
        """Leave out the areas and readings that came too late by these recorded events."""
        self._inputs.expect_late(events)

    # Changes ---------------------------------------------------------------------------------

    def reset(self, reason: str = "on demand") -> EstimatorEvent:
        """Back to a finger at rest, not seen before; the moisture reading stays, unless the reason
        begins with `events.ANOTHER_SUBJECT`.

        Returns the event to record.
        """
        return self._record_event(EventType.RESET, reason)

    def change_settings(self, settings: EstimatorSettings, reason: str = "") -> EstimatorEvent:
        """New settings from the next sample on; the state is kept. Returns the event to record."""
        check_type(settings, EstimatorSettings, "settings")
        return self._record_event(EventType.SETTINGS, reason, settings=settings.to_json())

    def change_parameters(self, sets: ParameterSets, reason: str = "") -> EstimatorEvent:
        """New parameter sets from the next sample on; the state is kept.

        Returns the event to record. Raises InputError for sets of another geometry or law.
        """
        check_sets(sets, self.model)
        text = sets.of_finger(self.model.geometry).to_yaml()
        return self._record_event(EventType.PARAMETERS, reason, parameter_sets=text)

    def change_surface(self, reason: str = "") -> EstimatorEvent:
        """Another surface from the next sample on: slip knows nothing of its friction; what is
        known of the finger stays. Returns the event to record."""
        return self._record_event(EventType.SURFACE, reason)

    def clock_jump_event(self, stamp_ns: int) -> EstimatorEvent:
        """Reset the state: a clock jumped back, and the next sample has this stamp.

        Returns the event to record.
        """
        self._jump_back(stamp_ns)
        return replace(self._event(EventType.RESET, TIME_JUMP), stamp_ns=int(stamp_ns))

    def note_late(self, areas: Sequence[int] = (), moistures: Sequence[int] = ()) -> EstimatorEvent:
        """Event that records which inputs came too late, so that a replay leaves them out too."""
        event = self._event(EventType.SETTINGS, "inputs came too late to be used")
        return replace(event, late_areas=tuple(areas), late_moistures=tuple(moistures))

    def note_pause(self, first: int, last: int) -> EstimatorEvent:
        """Event that records that no force came, so that areas of these stamps and of all between
        were not used; nor are those that are still to come."""
        event = replace(self._event(EventType.SETTINGS, NO_FORCE), late_areas=(first, last))
        self._inputs.expect_late([event])
        return event

    def start_event(self, stamp_ns: int, reason: str = "start") -> EstimatorEvent:
        """Event that records with what the estimator begins at the sample of this stamp."""
        return replace(self._event(EventType.START, reason), stamp_ns=int(stamp_ns))

    # Questions -------------------------------------------------------------------------------

    @property
    def last_stamp(self) -> int | None:
        """Stamp (ns) of the newest wrench sample, None before the first."""
        return self._state.last_stamp

    @property
    def parameters(self) -> np.ndarray:
        """Material parameters (n,) in force, in the order of the sets' space."""
        return self._selected.parameters.copy()

    @property
    def material(self) -> MaxwellLaw:
        """The material with the parameters in force; the same object until they change."""
        return self._selected.material

    @property
    def pose_correction(self) -> PoseCorrection:
        """Correction of the area for the settings' pose, with the parameters in force."""
        return self._state.pose_correction

    @property
    def moisture(self) -> float | None:
        """Reading (a.u.) in use, None before the first."""
        return None if self._moisture is None else self._moisture[1]

    @property
    def force_limit(self) -> float:
        """Largest force (N) the model was built for with the parameters in force."""
        return float(self._selected.constants["force_limit"][0])

    def statistics(self) -> dict[str, int]:
        """Fused and rejected areas, gaps and contacts since the last reset, and `counters`."""
        return {**self._state.counts(), **self.counters}

    def mismatch(self) -> Mismatch:
        """How far the finger is from its model, and which way."""
        return self._state.mismatch()

    def predict(self, time: np.ndarray, force: np.ndarray) -> ContactHistory:
        """Contact under a future force, see `prediction.predict`; the state stays as it is."""
        return prediction.predict(self._state, time, force)

    def force_for_area(self, area: float, horizon: float = 0.0) -> float:
        """Force (N) for an area (m²), see `prediction.force_for_area`; the state stays as it is."""
        return prediction.force_for_area(self._state, area, horizon)

    # Samples ---------------------------------------------------------------------------------

    def _admit(self, stamp_ns: int, force: Sequence[float]) -> list[tuple[int, Sequence[float]]]:
        """The samples to process now, by the rules for duplicates, order and jumps of time."""
        newest = self._state.last_stamp
        if newest is None:
            return [(stamp_ns, force)]
        if stamp_ns in self._jumps and stamp_ns <= newest:
            # Recorded by a node that saw its clock jump back to here.
            self._jump_back(stamp_ns)
            return [(stamp_ns, force)]
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            ahead = stamp_ns - waiting[0]
            back = waiting[0] < newest
            goes_on = 0 < stamp_ns - newest <= FUTURE * NANOSECONDS
            if 0 < ahead <= LONGEST_GAP * NANOSECONDS and not (back and goes_on):
                if back:
                    self.counters["resets"] += 1
                    self._jump_back(waiting[0])
                return [waiting, (stamp_ns, force)]
            self._drop()
        ahead = stamp_ns - newest
        if 0 < ahead <= FUTURE * NANOSECONDS:
            return [(stamp_ns, force)]
        if ahead == 0:
            self.counters["duplicates"] += 1
        elif -ahead * 1e-9 <= self.settings.time_reset_after and ahead < 0:
            self._drop()
        else:
            self._waiting = (stamp_ns, tuple(force))
        return []

    def _drop(self) -> None:
        """Count a sample of another time and flag the next estimate."""
        self.counters["out_of_order"] += 1
        self._state.add_flag(StateFlag.OUT_OF_ORDER)

    def _process(self, stamps: np.ndarray, forces: np.ndarray, rows: np.ndarray) -> None:
        """Run accepted samples of increasing stamps, and the areas that come due."""
        areas = self._inputs.take_due_areas(int(stamps[-1]))
        self._state.process(stamps, forces, areas, rows)

    def _next_due(self) -> int | None:
        """Stamp of a wrench sample before which an event or reading takes effect."""
        due = [e.stamp_ns for e in self._events[:1]]
        moisture = self._inputs.next_moisture_due()
        if moisture is not None:
            due.append(moisture)
        return min(due) if due else None

    def _apply_due(self, stamp_ns: int) -> None:
        """Apply the events and readings that take effect before a sample of this stamp."""
        while self._events and self._events[0].stamp_ns <= stamp_ns:
            self._apply_now(self._events.pop(0))
        while (reading := self._inputs.take_due_moisture(stamp_ns)) is not None:
            self._moisture = reading
            self._select_parameters()

    # Events ----------------------------------------------------------------------------------

    def _event(self, kind: EventType, reason: str) -> EstimatorEvent:
        """Event that takes effect at the next sample, with what is in force now."""
        last = self.last_stamp
        return EstimatorEvent(
            0 if last is None else last + 1,
            kind,
            self.settings.to_json(),
            self.parameter_sets.to_yaml(),
            self.model.hash,
            reason,
        )

    def _record_event(self, kind: EventType, reason: str, **changes: str) -> EstimatorEvent:
        """Apply a change now and return the event to record."""
        event = replace(self._event(kind, reason), **changes)  # type: ignore[arg-type]
        self._apply_now(event)
        return event

    def _apply_now(self, event: EstimatorEvent) -> None:
        """Put an event into effect."""
        if event.model_hash not in ("", self.model.hash):
            if event.type != EventType.START:
                return  # Of a finger that is not in use; its start tells all of it.
            self.model = self.models[event.model_hash]
            self._state = self._fresh_state()
            self._selected_for = self._prepared = None
        self.settings = event.estimator_settings()
        new_sets = self._take_over_sets(event.parameter_sets)
        self._count_late(len(event.late_areas), len(event.late_moistures))
        if event.type == EventType.START or event.is_another_subject:
            reading, self._moisture = self._moisture, None
            if reading is not None and not event.is_another_subject:
                # A node that begins anew has it from the first sample on.
                self._inputs.add_moisture(*reading)
        self._configure()
        if event.type in (EventType.START, EventType.RESET):
            self.fingers += 1
            self._state.reset(keep_stream=event.type == EventType.RESET)
        elif new_sets:
            self._state.initialise_filters()
        if event.type == EventType.SURFACE:
            self.surfaces += 1

    def _take_over_sets(self, text: str) -> bool:
        """Parameter sets of an event; true when they differ from those in force."""
        # Events are frequent, as with every late area, and parsing takes longer than a sample may
        # wait.
        if text == self.parameter_sets.to_yaml():
            return False
        before = self.parameter_sets.hash
        self.parameter_sets = ParameterSets.parse(text, "recorded parameter sets")
        return self.parameter_sets.hash != before

    def _count_late(self, areas: int = 0, moistures: int = 0) -> None:
        """Count inputs that came too late and flag the next estimate."""
        for number, name, flag in (
            (areas, "late_areas", StateFlag.AREA_LATE),
            (moistures, "late_moistures", StateFlag.MOISTURE_LATE),
        ):
            if number:
                self.counters[name] += number
                self._state.add_flag(flag)

    def _jump_back(self, stamp_ns: int) -> None:
        """Time jumped back to `stamp_ns`: reset the state and flag the next estimate."""
        self._inputs.jump_back(stamp_ns)
        self._jumps.clear()
        later, self._after_jump = self._after_jump, []
        for event in later:
            self.apply_event(event)
        self._waiting = None
        self._moisture = None
        self._configure()
        self._state.reset()
        self._state.add_flag(StateFlag.TIME_RESET)

    # Configuration ---------------------------------------------------------------------------

    def _configure(self) -> None:
        """Settings into the core and the queue, and the parameters of the moisture in use."""
        self._state.configure(self.settings)
        self._inputs.delay = nanoseconds(self.settings.fusion_delay)
        self._inputs.fuse = self.settings.fuse_area
        self._inputs.rejected_flags = self.settings.rejected_area_flags
        self._select_parameters()

    def _select_parameters(self) -> None:
        """Parameters at the reading in use, or at the default one."""
        key = self.parameter_sets.hash, self.settings, self.moisture
        if key != self._selected_for:
            # Not with every event: it takes long for a finger of its own lengths.
            prepared, self._prepared = self._prepared, None
            if prepared is not None and prepared[0] == key:
                self._selected = prepared[1]
            else:
                self._selected = select_parameters(
                    self.model, self.parameter_sets, self.settings, self.moisture
                )
            self._selected_for = key
        self._state.use_parameters(self._selected, self._moisture)
        self._one_row = new_rows(1, self._selected.name)


def replay(
    estimator: ContactEstimator,
    wrenches: Iterable[tuple[np.ndarray, np.ndarray]],
    areas: Sequence[tuple[int, float, float, int]] = (),
    moistures: Sequence[tuple[int, float]] = (),
    events: Sequence[EstimatorEvent] = (),
) -> Iterator[EstimateBlock]:
    """Run recorded inputs through an estimator; gives what a live node made of them, bit for bit.

    wrenches: blocks of stamps (n,) and forces (n, 3), in the order recorded; areas: (stamp_ns,
    area, sd, flags); moistures: (stamp_ns, value); events: all of the recording. Where time jumped
    back, stamps do not tell on which side an input came: then add all of them in the order they
    came, as `finger-bag process` does.
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
