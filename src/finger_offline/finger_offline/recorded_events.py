# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The model events of a recording as a run follows them: the finger of each start, and what options
replace.

A finger that options name is one of the recording's, whose model is not found otherwise, or else it
takes the place of all of them. Settings and parameter sets stay, unless options replace them too.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import replace

from finger_bag.cdr_layout import WRENCH_TYPE
from finger_bag.reader import BagReader
from finger_bag.streams import Malformed, read_wrenches
from finger_common.errors import FingerError, InputError
from finger_model.estimator import EstimatorEvent, EstimatorSettings, EventType
from finger_model.estimator.parameter_selection import check_sets
from finger_model.finger import load_for, model_for
from finger_model.messages import event_of
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced.model import ReducedModel, load_population

from .process_options import ProcessOptions

ANOTHER_FINGER = (
    "the finger that was named is none of the recording's: it was used with the recorded settings "
    "and parameter sets"
)

_parsed = functools.lru_cache(maxsize=16)(ParameterSets.parse)


class RecordedEvents:
    """The events on a topic of a recording whose force is on the topic `wrench`.

    sets: those that replace the recorded ones, None for none. `models`: of the fingers, by the hash
    that events have; `model`: of the finger at the first wrench; `another_finger`: whether options
    put another one in the place of all. Raises InputError for a start whose model cannot be had,
    and for options that contradict the recording.
    """

    def __init__(
        self,
        reader: BagReader,
        topic: str,
        wrench: str,
        options: ProcessOptions,
        sets: ParameterSets | None,
    ) -> None:
        self._where = f"{reader.path}: topic '{topic}'"
        self._options, self._sets = options, sets
        own = sets is not None and sets.geometry is not None
        files = options.model_file, options.geometry_file
        base = load_for(sets or ParameterSets.default(), *files)
        # A model file of the population is for each of the fingers, where nothing else names one.
        each = base.serves_population and not own and not options.geometry_file
        starts = self._starts(reader, topic, _first_stamp(reader, wrench, options))
        found: dict[str, ReducedModel] = {}
        for start in starts if own or any(files) else []:
            recorded = _parsed(start.parameter_sets)
            found[start.model_hash] = model_for(recorded, base, files[0]) if each else base
        self.another_finger = bool(found) and not any(
            recorded in ("", model.hash) for recorded, model in found.items()
        )
        if not self.another_finger:
            found = {s.model_hash: self._recorded(s, found.get(s.model_hash)) for s in starts}
        self.models = found
        if sets is not None:
            for model in found.values():
                check_sets(sets, model, options.parameter_file)
        self.model = found[starts[0].model_hash] if starts else base
        self._begin_ns = starts[0].stamp_ns if starts else 0

    def _starts(self, reader: BagReader, topic: str, first_ns: int) -> list[EstimatorEvent]:
        """Starts of the recording's fingers, first that of the one at the first wrench.

        Before it the node may have had another one. Of a recording begun long after the node the
        start may no longer be kept: then the oldest event, which has the same.
        """
        starts: list[EstimatorEvent] = []
        oldest = None
        for item in reader.messages([topic]):
            try:
                event = event_of(item.message)
                _parsed(event.parameter_sets)
                event.estimator_settings()
            except (FingerError, AttributeError, TypeError, ValueError):
                continue  # Named when it is read to be applied.
            self._settings(event)
            oldest = oldest or event
            if event.type == EventType.START:
                if starts and starts[-1].stamp_ns <= event.stamp_ns <= first_ns:
                    starts.pop()
                starts.append(event)
        if oldest is not None and not (starts and starts[0].stamp_ns <= first_ns):
            starts.insert(0, oldest)
        return starts

    def _recorded(self, start: EstimatorEvent, named: ReducedModel | None) -> ReducedModel:
        """The model that the node had; named: that of the options."""
        sets = _parsed(start.parameter_sets)
        for model in _candidates(sets, named):
            if start.model_hash in ("", model.hash):
                return model
        finger = "the default finger" if sets.geometry is None else "the finger recorded with it"
        raise InputError(
            f"{self._where}: recorded with reduced model {start.model_hash[:8]}, which is not the "
            f"suite's of {finger}; name the finger with --geometry or its model with --model"
        )

    def _settings(self, event: EstimatorEvent) -> str:
        """Settings of an event with those that options replace."""
        given = dict(self._options.estimator)
        if self._options.normal_axis:
            given = {"normal_axis": self._options.normal_axis, **given}
        if not given:
            return event.settings
        values = {**event.estimator_settings().to_dict(), **given}
        return EstimatorSettings.from_mapping(values).to_json()

    def applied(self, event: EstimatorEvent) -> EstimatorEvent | None:
        """An event as it applies; None for one of a finger that was there before the recording."""
        model = self.models.get(event.model_hash)
        if model is None:
            return None if event.stamp_ns <= self._begin_ns else event
        if not self._options.is_own():
            return event
        text = event.parameter_sets
        if self._sets is not None or event.model_hash not in ("", model.hash):
            text = (self._sets or _parsed(text)).of_finger(model.geometry).to_yaml()
        settings = self._settings(event)
        event = replace(event, settings=settings, parameter_sets=text, model_hash=model.hash)
        if "fusion_delay" in self._options.estimator:
            # It decides what is late.
            event = replace(event, late_areas=(), late_moistures=())
        return event


def _candidates(sets: ParameterSets, named: ReducedModel | None) -> Iterator[ReducedModel]:
    """Models that a node may have had with these sets; named: one that it had where it fits."""
    if named is not None:
        yield named
    try:
        own = load_for(sets)
    except InputError:
        return  # A finger outside the population box has a file of its own.
    yield own
    if own.gives_way:
        yield load_population(own.geometry)


def _first_stamp(reader: BagReader, wrench: str, options: ProcessOptions) -> int:
    """Stamp (ns) of the first wrench; 0 where it is none."""
    items = [item for item, _ in zip(reader.messages([wrench]), range(1))]
    if not items or items[0].type != WRENCH_TYPE:
        return 0
    mapped, decoder = options.mapping.topic("wrench"), reader.decoder(wrench, WRENCH_TYPE)
    stamps = read_wrenches(items, decoder, mapped, Malformed())[0].stamp_ns
    return int(stamps[0]) if len(stamps) else 0
