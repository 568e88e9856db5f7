# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Running vision and model over a bag, without middleware, through the same objects as the live
nodes.

One pass, in bounded memory: wrenches wait until everything stamped near them has been read, then go
through the compiled estimator in blocks. A recording with `model_events` is run with the settings,
parameter sets, resets and late inputs of the live node, and gives what it published, bit for bit.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from finger_bag.cdr_layout import WRENCH_TYPE, stamp_of_cdr
from finger_bag.reader import BagMessage, BagReader, open_bag
from finger_bag.streams import (
    Malformed,
    Wrenches,
    image_stamp,
    read_wrenches,
    stamp_and_value,
    wrong_type,
)
from finger_common.errors import FingerError, InputError
from finger_common.stamps import seconds
from finger_model.estimator import (
    ContactEstimator,
    EstimateBlock,
    EstimatorSettings,
)
from finger_model.estimator.estimate import ESTIMATE_DTYPE
from finger_model.finger import load_for
from finger_model.geometry import StatedGeometry
from finger_model.messages import (
    NOT_WHOLE,
    PLATE,
    area_of,
    event_of,
    moisture_of,
    outline_of,
    plate_frame,
    stick_of,
)
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced.model import load_population
from finger_model.shape.estimate import NO_OUTLINE, MeasuredOutline, ShapeEstimate
from finger_model.shape.settings import PoseSettings
from finger_model.slip import SlipSettings
from finger_model.slip_and_shape import SlipAndShape
from finger_vision.area_sensor import ContactMeasurement
from finger_vision.camera_stream import LeftOut

from .contact_states import open_table, serialize, serialize_shapes, serialize_slips
from .image_areas import ImageAreas, MeasuringThread
from .image_settings import told_settings
from .input_order import HEAD_START_NS, InputOrder
from .input_topics import InputTopics
from .output_bag import OutputBag
from .process_options import ProcessOptions
from .recorded_events import ANOTHER_FINGER, RecordedEvents
from .validity import Validity

ROUND_NS = 500_000_000
"""Log time between two rounds of handing inputs to the estimator."""

MAXIMUM_WRENCH = 1024
"""Bytes of a wrench above which it is malformed; only its frame_id can be long."""

RELATIVE_AREA_SD = 0.1
"""Standard deviation over value of an area that a mapping takes from a bare number."""

GAVE_WAY = (
    "the force goes beyond the model of the default finger; the model of the population was used "
    "(name your finger's with --geometry or --model)"
)

BlockSink = Callable[[EstimateBlock], None]


@dataclass
class ProcessResult:
    """What was made.

    duration: s of log time; replayed: with the events of the recording; notes: on how far the
    estimates can be trusted.
    """

    path: Path | None
    states: int = 0
    areas: int = 0
    duration: float = 0.0
    replayed: bool = False
    counters: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    lost: bool = False
    """Whether something that the bag holds could not be read, or was not, by a limit."""


def process(
    source: str | Path,
    target: str | Path | None,
    options: ProcessOptions | None = None,
    progress: Callable[[float], None] | None = None,
    on_block: BlockSink | None = None,
) -> ProcessResult:
    """Process one bag into a new one (None: no bag is written).

    progress is called with the fraction done, on_block with each block of estimates. A recording
    without events whose force leaves the range of the default finger's model is processed once
    more, from its first block, with the model of the population, unless the options name a model.
    Raises InputError when the bag lacks what is needed or the target exists.
    """
    options = options or ProcessOptions()
    try:
        return _processed(source, target, options, progress, on_block, False)
    except _BeyondModel:
        return _processed(source, target, options, progress, on_block, True)


class _BeyondModel(Exception):
    """The force goes beyond a model that gives way to that of the population."""


def _processed(
    source: str | Path,
    target: str | Path | None,
    options: ProcessOptions,
    progress: Callable[[float], None] | None,
    on_block: BlockSink | None,
    population: bool,
) -> ProcessResult:
    """As `process`; population: with the model of the population for the default finger.

    Raises _BeyondModel where another model has to be used.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(open_bag(source))
        topics = InputTopics.of(reader, options)
        images = None
        told = told_settings(options.area_sensor, options.sensor)
        if topics.image is not None:
            areas = ImageAreas.for_bag(reader, options, ridge_motion=options.slip)
            images = stack.enter_context(MeasuringThread(areas))
        sets = ParameterSets.load(options.parameter_file) if options.parameter_file else None
        events = None
        if topics.events is not None:
            events = RecordedEvents(reader, topics.events, topics.wrench, options, sets)
        estimator = _estimator(options, sets, events, population)
        # Everything is checked and loaded before anything is written.
        output = None
        if target is not None:
            output = OutputBag(target, reader, topics, options, estimator.model.hash)
            stack.enter_context(output)
        sinks = [on_block] if on_block is not None else []
        for table in options.tables:
            sinks.append(stack.enter_context(open_table(table)))
        run = _Run(reader, options, topics, estimator, events, images, output, sinks)
        run.read_all(progress)
        if output is not None:
            output.finish()  # a disk that is full now leaves no table without its bag
        result = run.result()
    if told and images is not None:
        result.notes.insert(0, f"areas measured with {told} of the area sensor")
    elif images is None and (unused := options.told()):
        result.problems.append(
            f"no areas are measured in images, so that {unused} is not used: give --images yes"
        )
    if options.pose and not options.shape:
        given = ", ".join(f"{name} {value}" for name, value in options.pose.items())
        result.problems.append(
            f"the shape is not estimated, so that {given} is not used: give --shape"
        )
    if topics.apart:
        result.problems.insert(0, topics.apart)
    if estimator.model.doubt:
        result.notes.insert(0, estimator.model.doubt)
    if population:
        result.notes.insert(0, GAVE_WAY)
    if events is not None and events.another_finger:
        result.notes.insert(0, ANOTHER_FINGER)
    result.path = None if target is None else Path(target)
    return result


def _estimator(
    options: ProcessOptions,
    sets: ParameterSets | None,
    events: RecordedEvents | None,
    population: bool,
) -> ContactEstimator:
    """For the finger of the options or of the recording's events; sets: those of the options."""
    if events is not None:
        model = events.model
    else:
        named = options.model_file, options.geometry_file
        model = load_for(sets or ParameterSets.default(), *named)
        if population:
            model = load_population(model.geometry)
    values = {"normal_axis": options.axis, **options.estimator}
    stated = StatedGeometry.load(options.geometry_file) if options.geometry_file else None
    estimator = ContactEstimator(model, sets, EstimatorSettings.from_mapping(values), stated)
    if events is not None:
        estimator.models = {own.hash: own for own in (model, *events.models.values())}
    return estimator


def measured_outline(measured: ContactMeasurement) -> MeasuredOutline:
    """Outline of a contact measured in an image; NaN where it is not seen whole."""
    if measured.flags & NOT_WHOLE:
        return NO_OUTLINE
    return MeasuredOutline(
        measured.centroid,
        measured.ellipse_major,
        measured.ellipse_minor,
        measured.ellipse_angle,
        measured.centroid_sd,
        measured.ellipse_major_sd,
        measured.ellipse_minor_sd,
    )


class _Run:
    """One pass over a bag: messages into the queue, then through the estimator to the outputs."""

    def __init__(
        self,
        reader: BagReader,
        options: ProcessOptions,
        topics: InputTopics,
        estimator: ContactEstimator,
        events: RecordedEvents | None,
        images: MeasuringThread | None,
        output: OutputBag | None,
        sinks: Sequence[BlockSink],
    ) -> None:
        self.reader, self.mapping, self.topics = reader, options.mapping, topics
        self.estimator, self.images, self.output, self.sinks = estimator, images, output, sinks
        self.events = events
        written = output is not None
        self.slip_and_shape = SlipAndShape(
            estimator,
            SlipSettings() if written and options.slip else None,
            PoseSettings.from_mapping(options.pose) if written and options.shape else None,
        )
        # What pictures show beside the areas that wait, by stamp.
        self.seen: dict[int, tuple[tuple[float, float], MeasuredOutline]] = {}
        # Frames of areas, each with the log time (ns) from which on it holds.
        self.plates: list[tuple[int, str]] = [] if images is None else [(0, PLATE)]
        self.before = Wrenches(np.zeros(1, np.int64), np.zeros(1, np.int64), *np.zeros((2, 1, 3)))
        # Images are not held for so long: they need memory.
        self.queue = InputOrder(topics.events is not None and topics.image is None)
        self.malformed = Malformed()
        self.decoder = reader.decoder(topics.wrench, WRENCH_TYPE)
        self.started = False
        # Stamps of the recorded node's first event and state.
        self.first_event: int | None = None
        self.first_state: int | None = None
        # Whether the recording begins with the node's first sample.
        self.began_here = False
        # Settings that are given replace those of the recording, known or not.
        self.axis = options.axis
        given = options.estimator or options.normal_axis
        self.recorded_states = "" if given else topics.result("contact_state")
        self.rewrites_events = options.is_own()
        self.states = self.areas = 0
        self.validity = Validity()
        model = estimator.model
        named = options.model_file or options.geometry_file
        # What a live node published is given again with its own model.
        self.may_give_way = topics.events is None and not named and model.gives_way

    def read_all(self, progress: Callable[[float], None] | None) -> None:
        """Read and estimate everything; raises InputError when there is no wrench."""
        begin = self.reader.info.start_ns or 0
        span = max((self.reader.info.end_ns or 0) - begin, 1)
        last = 0
        for item in self.reader.messages(None if self.output else self.topics.used()):
            if item.log_time_ns - last > ROUND_NS or self.queue.full:
                last = item.log_time_ns
                self._hand_over(last)
                if progress is not None:
                    progress(min((last - begin) / span, 1.0))
            try:
                self._enqueue(item)
            except (FingerError, AttributeError, TypeError, ValueError) as error:
                self.malformed.add(item.topic, error)
            if self.output is not None:
                self.output.copy(item)
        self._hand_over(1 << 62)
        if not self.states:
            wrench = self.topics.wrench
            reason = self.malformed.reasons.get(wrench, "no message could be read")
            raise InputError(f"{self.reader.path}: topic '{wrench}' holds no wrench ({reason})")
        if progress is not None:
            progress(1.0)

    def result(self) -> ProcessResult:
        """What was made so far."""
        counters = {k: v for k, v in self.estimator.counters.items() if v}
        replayed = self.topics.events is not None
        problems = self.malformed.problems()
        if self.output is not None:
            problems += self.output.left_out.values()
        problems += self.reader.all_problems()
        if self.images is not None:
            problems += self.images.areas.problems()
        repeated = counters.get("duplicates", 0) + counters.get("out_of_order", 0)
        if repeated > 0.01 * self.states:
            problems.append(
                f"{repeated} of {self.states + repeated} wrenches repeat a stamp or run back in "
                "time and were left out; if their stamps mean nothing, name 'stamp: log_time' for "
                "the wrench in a mapping file"
            )
        late = counters.get("late_areas", 0)
        if late and not replayed:
            problems.append(
                f"{late} areas were logged more than "
                f"{seconds(HEAD_START_NS):.0f} s after their stamp and "
                "were not used"
            )
        duration = self.reader.info.duration
        return ProcessResult(
            None,
            self.states,
            self.areas,
            duration,
            replayed,
            counters,
            problems,
            self._unknown_settings() + self.validity.notes(),
            self.reader.lost
            or bool(self.malformed.counts)
            or (self.images is not None and self.images.areas.left_out > 0),
        )

    def _unknown_settings(self) -> list[str]:
        """Sentence on recorded states older than every event of their node."""
        if self.first_state is None:
            return []
        if self.first_event is not None and self.first_event <= self.first_state:
            return []
        return [
            "no event tells the settings of the model node when the recording began: the defaults "
            f"were used, with normal_axis {self.axis}; if the node had others, name them with --set"
        ]

    # Into the queue --------------------------------------------------------------------------

    def _enqueue(self, item: BagMessage) -> None:
        topics = self.topics
        if item.topic == topics.wrench:
            if item.type != WRENCH_TYPE:
                raise wrong_type(item, WRENCH_TYPE)
            if len(item.raw) > MAXIMUM_WRENCH:
                raise InputError(f"a wrench has more than {MAXIMUM_WRENCH} bytes")
            self.queue.add_wrench(item)
        elif item.topic == topics.image and self.images is not None:
            self.images.add(item, image_stamp(item, topics.image_mapping))
            self._collect_areas(0)
        elif item.topic == topics.moisture:
            stamp, value = stamp_and_value(item, self.mapping.topic("moisture"))
            value = moisture_of(item.message)[1] if value is None else value
            self.queue.add_moisture(item.log_time_ns, stamp, value)
        elif item.topic == topics.area:
            mapped = self.mapping.topic("contact_area")
            stamp, value = stamp_and_value(item, mapped)
            if value is None:
                _, area, sd, flags = area_of(item.message)
                self.seen[stamp] = stick_of(item.message), outline_of(item.message)
                plate = item.message.header.frame_id
                if not self.plates or self.plates[-1][1] != plate:
                    self.plates.append((item.log_time_ns, plate))
                area, sd = area * mapped.scale, sd * mapped.scale
            else:
                area, sd, flags = value, RELATIVE_AREA_SD * abs(value), 0
            self._add_area(item.log_time_ns, stamp, area, sd, flags)
        elif item.topic == topics.events:
            self._follow_event(item)
        elif item.topic == self.recorded_states:
            if self.first_state is None:
                self.first_state = stamp_of_cdr(item.raw)

    def _follow_event(self, item: BagMessage) -> None:
        assert self.events is not None
        recorded = event_of(item.message)
        if self.first_event is None:
            self.first_event = recorded.stamp_ns
        event = self.events.applied(recorded)
        if event is None:
            return
        self.estimator.expect_late([event])
        if event.is_pause:
            self.slip_and_shape.leave_out(*event.late_areas)
        self.estimator.apply_event(event)
        self.started = True
        if self.output is not None and self.rewrites_events:
            self.output.write_event(event, item.log_time_ns, int(item.message.sequence))

    def _plate_at(self, log_ns: int) -> str:
        """Frame of the last area before; empty where there was none yet."""
        passed = bisect_left(self.plates, log_ns, key=lambda entry: entry[0])
        if passed == 0 and self.plates and not self.began_here:
            return self.plates[0][1]  # the node had areas before the recording
        return self.plates[passed - 1][1] if passed else ""

    def _add_area(self, log_ns: int, stamp: int, area: float, sd: float, flags: int) -> None:
        self.areas += 1
        self.validity.add_area(area, sd)
        self.queue.add_area(log_ns, stamp, area, sd, flags)

    def _collect_areas(self, until_ns: int) -> None:
        """Take the areas of images logged until then, and of those that too many others follow."""
        if self.images is None:
            return
        for item, stamp, measured in self.images.results(until_ns):
            if isinstance(measured, LeftOut):
                continue
            if isinstance(measured, FingerError):
                self.malformed.add(item.topic, measured)
                continue
            area, sd = measured.gross_area, measured.area_sd
            if not measured.flags & NOT_WHOLE:
                stick = measured.motion.stick_ratio, measured.motion.stick_ratio_sd
                self.seen[stamp] = stick, measured_outline(measured)
            self._add_area(item.log_time_ns, stamp, area, sd, int(measured.flags))
            if self.output is not None:
                self.output.write_area(measured, stamp, item.log_time_ns)

    # Through the estimator -------------------------------------------------------------------

    def _hand_over(self, now_ns: int) -> None:
        """Give the estimator what no later message can precede."""
        self._collect_areas(now_ns - self.queue.wait_ns + HEAD_START_NS)
        for moisture, values in self.queue.inputs_due(now_ns):
            if moisture:
                self.estimator.add_moisture(*values)
            else:
                used = self.estimator.add_area(*values)
                seen = self.seen.pop(values[0], None)
                if used and seen is not None:
                    self.slip_and_shape.see_area(values[0], *seen)
        for items in self.queue.wrenches_due(now_ns):
            self._estimate(items)

    def _estimate(self, items: Sequence[BagMessage]) -> None:
        mapped = self.mapping.topic("wrench")
        found, frame = read_wrenches(items, self.decoder, mapped, self.malformed)
        if not len(found.stamp_ns):
            return
        if not self.states and self.first_event is not None:
            self.began_here = self.first_event >= int(found.stamp_ns[0])
        if not self.started:
            self.started = True
            event = self.estimator.start_event(int(found.stamp_ns[0]), "processed offline")
            if self.output is not None:
                self.output.write_event(event, int(found.log_ns[0]))
        # The last sample of the block before may have waited for the first of this one.
        given = Wrenches(*map(np.concatenate, zip(self.before, found)))
        self.before = Wrenches(*(column[-1:] for column in found))
        rows, logs = [np.empty(0, ESTIMATE_DTYPE)], []
        slips: list[bytes] = []
        shapes: list[tuple[int, ShapeEstimate]] = []
        for first, part in self.estimator.wrench_parts(found.stamp_ns, found.force):
            own = slice(first + 1, first + 1 + len(part))
            log = given.log_ns[own].tolist()
            slip, shape = self.slip_and_shape.process_block(
                part, given.force[own], given.torque[own]
            )
            rows.append(part.rows)
            logs += log
            slips += serialize_slips(slip, self.slip_and_shape.lateral_axes, frame)
            shapes += [(log[number], estimate) for number, estimate in shape]
        block = EstimateBlock(np.concatenate(rows))
        self.validity.add(block, found.force, self.estimator.settings.normal_axis)
        if self.may_give_way and self.validity.leaves_model:
            raise _BeyondModel
        self.states += len(block)
        if self.output is not None:
            self.output.write("contact_state", zip(logs, serialize(block, frame)))
            self.output.write("contact_slip", zip(logs, slips))
            self.output.write(
                "contact_shape",
                serialize_shapes(shapes, lambda log_ns: plate_frame(self._plate_at(log_ns), frame)),
            )
        for sink in self.sinks:
            sink(block)
