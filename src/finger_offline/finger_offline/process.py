"""Running vision and model over a bag, without middleware, through the same objects as the live nodes.

One pass, in bounded memory: wrenches wait until everything stamped near them has been read, then go through the
compiled estimator in blocks. A recording with `model_events` is run with the settings, parameter sets, resets and
late inputs of the live node, and gives what it published, bit for bit.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.bulk import WRENCH_TYPE, stamps_and_wrenches
from finger_bag.definitions import encode
from finger_bag.reader import BagMessage, BagReader, open_bag
from finger_bag.recover import announce, copy_attachments
from finger_bag.schema import IMAGE_TOPICS, PARAMETERS_ATTACHMENT, spec_of
from finger_bag.streams import (
    field_value,
    find_topic,
    find_used,
    find_wrench,
    missing,
    stamp_ns,
    stamp_of_cdr,
)
from finger_bag.writer import BagWriter
from finger_common.errors import FingerError, InputError
from finger_model.estimator import ContactEstimator, EstimateBlock, EstimatorSettings
from finger_model.messages import area_of, event_fields, event_of, moisture_of
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced import ReducedModel

from .contact_states import TableExport, first_frame_id, serialize
from .image_areas import IMAGES, ImageAreas, area_fields
from .process_options import ProcessOptions

AREA_WAIT_NS = 1_000_000_000
"""Log time after which an area or reading is handed to the estimator; records of late ones have come by then."""

WRENCH_WAIT_NS = 2_000_000_000
"""Log time after which a wrench is handed over; areas that come later than this could not be used live either."""

BLOCK = 4000
IMAGES_AHEAD = 6

STATE_TYPE = "finger_msgs/msg/ContactState"
AREA_TYPE = "finger_msgs/msg/ContactArea"


@dataclass
class ProcessResult:
    """What came of it. duration: s of log time; replayed: with the events of the recording."""

    path: Path | None
    states: int = 0
    areas: int = 0
    duration: float = 0.0
    replayed: bool = False
    counters: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def process(
    source: str | Path,
    target: str | Path | None,
    options: ProcessOptions | None = None,
    progress: Callable[[float], None] | None = None,
    on_block: Callable[[EstimateBlock], None] | None = None,
) -> ProcessResult:
    """Process one bag into a new one (None: no bag is written).

    progress is called with the fraction done, on_block with each block of estimates. Raises InputError when the bag
    lacks what is needed or the target exists.
    """
    options = options or ProcessOptions()
    with ExitStack() as stack:
        reader = stack.enter_context(open_bag(source))
        run = _Run(reader, options)
        # Checked and loaded before anything is written.
        if target is not None:
            run.writer = stack.enter_context(BagWriter(target, run.metadata()))
        if options.table:
            run.table = stack.enter_context(TableExport(options.table))
        run.on_block = on_block
        pool = stack.enter_context(ThreadPoolExecutor(1, "vision")) if run.measure else None
        run.go(pool, progress)
    return run.result(Path(target) if target is not None else None)


class _Run:
    """State of one pass."""

    def __init__(self, reader: BagReader, options: ProcessOptions) -> None:
        self.reader, self.options = reader, options
        self.wrench = find_wrench(reader, options)
        self.area_topic = find_topic(reader, "contact_area", options)
        self.moisture_topic = find_topic(reader, "moisture", options)
        events = find_topic(reader, "model_events", options)
        self.state_topic = self.wrench.rpartition("/")[0] + "/contact_state"
        self.measured_topic = self.wrench.rpartition("/")[0] + "/contact_area"
        images = [t for name in IMAGES if (t := find_used(reader, name, options)) is not None]
        has_areas = find_used(reader, "contact_area", options) is not None
        from_images = options.images == "yes" or (
            options.images == "auto" and not has_areas and bool(images)
        )
        if from_images and not images:
            raise missing(reader, "image_raw")
        self.image_topic = images[0] if from_images else None
        self.measure: ImageAreas | None = None
        if from_images:
            self.measure = ImageAreas.for_bag(
                reader, options.calibration, options.area_per_pixel, options.area_sensor
            )
        # Other settings or parameters than recorded: the recorded events no longer apply.
        own = (
            options.estimator or options.parameter_file or options.model_file or options.normal_axis
        )
        self.event_topic = None if own else events
        if self.event_topic is not None and reader.info.topics[self.event_topic].count == 0:
            self.event_topic = None
        self.estimator = _estimator(options)
        self.replaced = {self.state_topic}
        if from_images:
            self.replaced |= {self.measured_topic, *([self.area_topic] if self.area_topic else [])}
        if self.event_topic is None and events is not None:
            self.replaced.add(events)
        self.writer: BagWriter | None = None
        self.table: TableExport | None = None
        self.on_block: Callable[[EstimateBlock], None] | None = None
        self.decode = reader.decoder(self.wrench, reader.info.topics[self.wrench].type)
        self.wrenches: deque[BagMessage] = deque()
        self.inputs: list[tuple[int, int, str, tuple[Any, ...]]] = []
        self.futures: deque[tuple[BagMessage, Future[Any]]] = deque()
        self.states = self.areas = self.started = self.order = 0
        self.malformed: dict[str, int] = {}
        self.first_error: dict[str, str] = {}
        self.problems: list[str] = []
        self.announced: set[tuple[str, str]] = set()
        self.left_out: dict[tuple[str, str], str] = {}

    def metadata(self) -> dict[str, str]:
        """Metadata of the output: those of the input and what was done."""
        known = self.reader.info.metadata.to_mapping()
        known.pop("software_version", None)
        return {
            **known,
            "processed_from": self.reader.path.name,
            "reduced_model_hash": self.estimator.model.hash,
            "areas_from": "images" if self.measure else "contact_area",
        }

    # The pass --------------------------------------------------------------------------------

    def go(self, pool: ThreadPoolExecutor | None, progress: Callable[[float], None] | None) -> None:
        info = self.reader.info
        if self.writer is not None:
            copy_attachments(self.reader, self.writer)
            if self.options.parameter_file:
                data = Path(self.options.parameter_file).read_bytes()
                self.writer.attach(PARAMETERS_ATTACHMENT, data)
            self.writer.add_topic(self.state_topic, STATE_TYPE)
        begin, span = info.start_ns or 0, max((info.end_ns or 0) - (info.start_ns or 0), 1)
        last = 0
        for item in self.reader.messages(self._wanted()):
            if item.log_time_ns - last > 500_000_000:
                last = item.log_time_ns
                self._hand_over(last)
                if progress is not None:
                    progress(min((last - begin) / span, 1.0))
            self._take(item, pool)
        self._hand_over(1 << 62)
        if progress is not None:
            progress(1.0)
        self.problems += [
            f"topic '{t}': {n} malformed messages left out ({self.first_error[t]})"
            for t, n in self.malformed.items()
        ]
        self.problems += [*self.left_out.values(), *self.reader.all_problems()]
        if not self.states:
            reason = self.first_error.get(self.wrench, "no message could be read")
            raise InputError(
                f"{self.reader.path}: topic '{self.wrench}' holds no wrench ({reason})"
            )

    def _wanted(self) -> list[str] | None:
        """Topics to read; None for all."""
        if self.writer is not None:
            return None
        used = [self.wrench, self.moisture_topic, self.event_topic, self.image_topic]
        if not self.measure:
            used.append(self.area_topic)
        return [t for t in used if t is not None]

    def _take(self, item: BagMessage, pool: ThreadPoolExecutor | None) -> None:
        topic = item.topic
        try:
            if topic == self.wrench:
                self.wrenches.append(item)
            elif topic == self.image_topic:
                self._measure(item, pool)
            elif topic == self.moisture_topic:
                self._input(item, "moisture", moisture_of)
            elif topic == self.area_topic and self.measure is None:
                self._input(item, "contact_area", area_of)
            elif topic == self.event_topic:
                event = event_of(item.message)
                self.estimator.expect_late([event])
                self.estimator.apply_event(event)
                self.started = 1
        except (FingerError, AttributeError, TypeError, ValueError) as error:
            self._bad(topic, error)
        if self.writer is not None:
            self._copy(item)

    def _bad(self, topic: str, error: BaseException) -> None:
        self.malformed[topic] = self.malformed.get(topic, 0) + 1
        self.first_error.setdefault(topic, str(error))

    def _input(self, item: BagMessage, name: str, convert: Callable[[Any], Any]) -> None:
        mapped = self.options.mapping.topic(name)
        if not mapped.field:
            values = convert(item.message)
        else:
            number = float(field_value(item.message, mapped.field))
            # A tenth of the area: what is known of a number without an accuracy.
            more = (0.1 * abs(number) * mapped.scale, 0) if name == "contact_area" else ()
            stamp = item.log_time_ns if mapped.log_time else stamp_ns(item.message)
            values = (stamp, number * mapped.scale, *more)
        if mapped.log_time:
            values = (item.log_time_ns, *values[1:])
        if name == "contact_area":
            self.areas += 1
        self._wait(item.log_time_ns, name, values)

    def _wait(self, log_time_ns: int, name: str, values: tuple[Any, ...]) -> None:
        self.order += 1
        heapq.heappush(self.inputs, (log_time_ns, self.order, name, values))

    def _measure(self, item: BagMessage, pool: ThreadPoolExecutor | None) -> None:
        assert pool is not None and self.measure is not None
        measure = self.measure.measure
        self.futures.append((item, pool.submit(lambda: measure(item.message))))
        if len(self.futures) > IMAGES_AHEAD:
            self._collect_one()

    def _collect_one(self) -> None:
        item, future = self.futures.popleft()
        try:
            found = future.result()
        except FingerError as error:
            self._bad(item.topic, error)
            return
        stamp = stamp_of_cdr(item.raw)
        self.areas += 1
        values = (stamp, found.gross_area, found.area_sd, int(found.flags))
        self._wait(item.log_time_ns, "contact_area", values)
        if self.writer is not None:
            fields = area_fields(stamp, found, "plate")
            self.writer.add_topic(self.measured_topic, AREA_TYPE)
            self.writer.write_raw(self.measured_topic, encode(AREA_TYPE, fields), item.log_time_ns)

    def _copy(self, item: BagMessage) -> None:
        assert self.writer is not None
        if item.topic in self.replaced:
            return
        key = (item.topic, item.type)
        if key in self.left_out:
            return
        try:
            if key not in self.announced:
                if not self.options.keep_images and _is_image(item):
                    self.replaced.add(item.topic)
                    return
                announce(self.writer, self.reader.topic_info(*key))
                self.announced.add(key)
            self.writer.write_raw(
                item.topic, item.raw, item.log_time_ns, item.publish_time_ns, item.sequence
            )
        except InputError as error:
            self.left_out[key] = str(error)

    # Handing over ----------------------------------------------------------------------------

    def _hand_over(self, now: int) -> None:
        """Give the estimator what can no longer be overtaken."""
        while self.futures and self.futures[0][0].log_time_ns + AREA_WAIT_NS <= now:
            self._collect_one()
        while self.inputs and self.inputs[0][0] + AREA_WAIT_NS <= now:
            *_, name, values = heapq.heappop(self.inputs)
            if name == "moisture":
                self.estimator.add_moisture(*values)
            else:
                self.estimator.add_area(*values)
        ready: list[BagMessage] = []
        while self.wrenches and self.wrenches[0].log_time_ns + WRENCH_WAIT_NS <= now:
            ready.append(self.wrenches.popleft())
            if len(ready) == BLOCK:
                self._estimate(ready)
                ready = []
        if ready:
            self._estimate(ready)

    def _estimate(self, items: Sequence[BagMessage]) -> None:
        usable = [i for i in items if i.type == WRENCH_TYPE]
        if len(usable) < len(items):
            wrong = next(i for i in items if i.type != WRENCH_TYPE)
            self.malformed[wrong.topic] = self.malformed.get(wrong.topic, 0) + 1
            text = f"type is '{wrong.type}', '{WRENCH_TYPE}' is needed"
            self.first_error.setdefault(wrong.topic, text)
        raws = [i.raw for i in usable]
        stamps, forces, _ = stamps_and_wrenches(raws, self.decode)
        mapped = self.options.mapping.topic("wrench")
        logs = np.array([i.log_time_ns for i in usable], np.int64)
        if mapped.log_time:
            stamps = np.where(stamps >= 0, logs, -1)
        good = stamps >= 0
        if not good.all():
            self._bad(self.wrench, InputError("bytes are not a WrenchStamped"))
            self.malformed[self.wrench] += int((~good).sum()) - 1
            stamps, forces, logs = stamps[good], forces[good], logs[good]
        if not len(stamps):
            return
        if not self.started:
            self.started = 1
            event = self.estimator.start_event(int(stamps[0]), "processed offline")
            self._write_event(event, int(logs[0]))
        block = self.estimator.add_wrenches(stamps, forces * mapped.scale)
        self.states += len(block)
        if self.writer is not None and len(block):
            # Each estimate is logged with its wrench; dropped samples have none.
            order = (
                np.searchsorted(stamps, block.column("stamp_ns"))
                if len(block) < len(stamps)
                else None
            )
            if order is not None and np.any(np.diff(stamps) < 0):
                log_of = dict(zip(stamps.tolist(), logs.tolist()))
                times = [log_of[s] for s in block.column("stamp_ns").tolist()]
            else:
                times = (logs if order is None else logs[order]).tolist()
            frame_id = first_frame_id(raws)
            self.writer.write_many(self.state_topic, serialize(block, frame_id), times)
        if self.table is not None:
            self.table.add(block)
        if self.on_block is not None:
            self.on_block(block)

    def _write_event(self, event: Any, log_time_ns: int) -> None:
        if self.writer is None:
            return
        fields = event_fields(event, 0)
        topic = self.wrench.rpartition("/")[0] + "/model_events"
        self.writer.write(topic, fields, log_time_ns)

    def result(self, path: Path | None) -> ProcessResult:
        counters = {k: v for k, v in self.estimator.counters.items() if v}
        late = counters.get("late_areas", 0)
        if late and self.event_topic is None:
            self.problems.append(
                f"{late} areas were logged more than {(WRENCH_WAIT_NS - AREA_WAIT_NS) * 1e-9:.0f} s "
                "after their stamp and were not used"
            )
        return ProcessResult(
            path,
            self.states,
            self.areas,
            self.reader.info.duration,
            self.event_topic is not None,
            counters,
            self.problems,
        )


def _is_image(item: BagMessage) -> bool:
    spec = spec_of(item.topic)
    return item.type in ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage") or (
        spec is not None and spec.name in IMAGE_TOPICS
    )


def _estimator(options: ProcessOptions) -> ContactEstimator:
    model = ReducedModel.load(options.model_file or None)
    sets = ParameterSets.load(options.parameter_file) if options.parameter_file else None
    values = {"normal_axis": options.axis, **options.estimator}
    return ContactEstimator(model, sets, EstimatorSettings.from_mapping(values))
