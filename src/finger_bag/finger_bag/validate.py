# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Is a bag fit for use? Checks with a status each, for a table or as data.

Statuses: "ok"; "note", information only; "fail". A bag is fit for use when nothing
fails. A bag of several fingers, each in a namespace of its own, is checked for each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from finger_common.axes import normal_force
from finger_common.contact_threshold import ONSET_FORCE
from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_common.plugins import Plugins
from finger_common.stamps import NANOSECONDS
from finger_common.usable_press import LONGEST_GAP

from .read_settings import ReadSettings
from .reader import BagReader, open_bag
from .schema import CALIBRATION_ATTACHMENT, TOPICS
from .streams import IMAGES, SessionStreams, apart, find_topic, find_used, read_streams

OK, NOTE, FAIL = "ok", "note", "fail"

AREAS = "contact_area (or image_raw)"
OF_TRIALS = {"topics", "calibration", "trials"}
"""Checks that a recording of something else than trials cannot pass."""

CHECKS = Plugins("finger_bag.checks", "bag check")
"""Further checks of installed packages: functions that take a CheckedBag and a Validation."""


MINIMUM_RATE = {"wrench": 100.0, "contact_area": 5.0, "image_raw": 5.0}
"""Hz."""

RATE_TOLERANCE = 0.1
"""Relative deviation from the schema's rate that is worth a note."""

MAXIMUM_DELAY, MAXIMUM_LEAD = 1.0, 0.05
"""s of the log time behind the stamp, and before it: clocks that disagree (medians)."""

MOISTURE_DELAY, MOISTURE_LEAD = 60.0, 1.0
"""The same of moisture readings. The median delay is noted, as a table may be saved late. The lead
of any one reading fails: a table has whole seconds, so that 1 s is none."""

SATURATED_SAMPLES, SATURATED_TIME = 25, 0.1
"""Equal extreme values in a row, and s of them, that count as a saturated sensor."""

LEAST_SATURATED = 1.0
"""N, least force that the end of a sensor's range may be."""

COARSE = 0.01
"""N, rounding of a force from which equal values in a row are usual: it is noted only."""


@dataclass(frozen=True)
class Check:
    """One check: what, how it went, what was found."""

    name: str
    status: str
    detail: str


@dataclass
class Validation:
    """All checks of one bag, or of one finger in it.

    namespace: of the finger, where there are several. of_trials: false of a recording without areas
    and without a word of trials, such as that of a grasp.
    """

    bag: str
    namespace: str = ""
    checks: list[Check] = field(default_factory=list)
    of_trials: bool = True

    def add(self, name: str, status: str, detail: str) -> None:
        """Append a check; status: OK, NOTE or FAIL."""
        self.checks.append(Check(name, status, detail))

    @property
    def fit(self) -> bool:
        """Whether nothing fails."""
        return all(c.status != FAIL for c in self.checks)

    @property
    def verdict(self) -> str:
        """What the checks come to, for people."""
        if self.fit:
            return "fit for use"
        if not self.of_trials and {c.name for c in self.checks if c.status == FAIL} <= OF_TRIALS:
            return (
                "fit for 'finger-bag process' and 'play', not for a fit of parameters, which needs "
                f"presses with {AREAS}"
            )
        return "not fit for use as it is"

    def to_data(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "bag": self.bag,
            "namespace": self.namespace,
            "fit_for_use": self.fit,
            "verdict": self.verdict,
            "checks": [asdict(c) for c in self.checks],
        }


@dataclass(frozen=True)
class CheckedBag:
    """What a check gets: the opened bag, its streams and how they were read."""

    reader: BagReader
    streams: SessionStreams
    settings: ReadSettings


@cache
def installed_checks() -> dict[str, Callable[[CheckedBag, Validation], None]]:
    """Checks of installed packages by name; looked for once, as that takes tens of milliseconds."""
    return {name: CHECKS.load(name) for name in CHECKS.names()}


def fingers(path: str | Path, settings: ReadSettings) -> list[str]:
    """Namespaces of the fingers of a bag; the one of the settings where it does not hold several.

    A force with no other stream of a finger beside it is another sensor's, as a robot's wrist has
    it, where any finger has more. Raises InputError when it cannot be read at all.
    """
    if settings.namespace or settings.wrench_topic.startswith("/"):
        return [settings.namespace]
    with open_bag(path) as reader:
        topics = {t.name: t.type for t in reader.info.topics.values() if t.count != 0}
    found: dict[str, int] = {}
    for name in ("wrench", "contact_state"):
        ends = [t for t, kind in topics.items() if t.endswith(f"/{name}") and kind == _type(name)]
        if len(ends) > 1 and not settings.mapping.topic(name).topic:
            for namespace in (topic.removesuffix(f"/{name}") for topic in ends):
                found[namespace] = sum(topics.get(f"{namespace}/{n}") == _type(n) for n in TOPICS)
    most = max(found.values(), default=0)
    fingers = [n or "/" for n, streams in sorted(found.items()) if streams > 1 or most < 2]
    return fingers if len(fingers) > 1 else [""]


def _type(name: str) -> str:
    return TOPICS[name].type


def validate(path: str | Path, settings: ReadSettings | None = None) -> Validation:
    """Check one bag, or one finger in it. Raises InputError when it cannot be read at all."""
    settings = settings or ReadSettings()
    with open_bag(path) as reader:
        result = Validation(str(path), settings.namespace)
        _check_topics(reader, settings, result)
        try:
            streams = read_streams(reader, settings)
        except InputError as error:
            _check_file(reader, [], result)
            result.add("content", FAIL, str(error).removeprefix(f"{reader.path}: "))
            return result
        _check_file(reader, streams.problems, result)
        _check_streams(streams, settings, result)
        _check_calibration(reader, streams, result)
        for check in installed_checks().values():
            check(CheckedBag(reader, streams, settings), result)
        if "trials" not in installed_checks():
            result.add("trials", NOTE, "not checked; install finger_offline")
    return result


def _check_file(reader: BagReader, problems: Iterable[str], result: Validation) -> None:
    found = list(dict.fromkeys([*problems, *reader.all_problems()]))
    if found:
        more = f" (and {len(found) - 3} more)" if len(found) > 3 else ""
        result.checks.insert(0, Check("file", FAIL, "; ".join(found[:3]) + more))
    else:
        count = reader.info.message_count
        result.checks.insert(0, Check("file", OK, f"{count} messages, closed by its recorder"))


def _check_topics(reader: BagReader, settings: ReadSettings, result: Validation) -> None:
    def present(name: str) -> bool:
        return find_used(reader, name, settings) is not None

    missing, notes, wrong = [], [], []
    areas, images = present("contact_area"), present("image_raw") or present("image_raw/compressed")
    if not present("wrench") and settings.wrench_topic == "wrench":
        missing.append("wrench")
    if not areas and not images:
        missing.append(AREAS)
        result.of_trials = present("trial")
    if not present("moisture"):
        notes.append("moisture")
    if not present("trial"):
        notes.append("trial (trials are split by the force)")
    for name, spec in TOPICS.items():
        topic = find_topic(reader, name, settings)
        if topic is None or settings.mapping.topic(name).field:
            continue
        kind = reader.info.topics[topic].type
        if kind != spec.type:
            wrong.append(f"'{topic}' holds {kind}, {spec.type} is needed")
        elif reader.info.topics[topic].count != 0:
            try:
                if not reader.decoder(topic, kind).standard:
                    notes.append(f"'{topic}' has another definition of {kind}")
            except InputError as error:
                wrong.append(str(error))
    if missing:
        result.add("topics", FAIL, f"missing: {', '.join(missing)}")
    elif notes:
        result.add("topics", NOTE, f"without: {', '.join(notes)}")
    else:
        result.add("topics", OK, f"{len(reader.info.topics)} topics")
    if warning := apart(reader, settings, ("wrench", *(["contact_area"] if areas else IMAGES))):
        result.add("namespaces", NOTE, warning)
    if wrong:
        result.add("types", FAIL, "; ".join(wrong))
    else:
        result.add("types", OK, "as in the schema")


def _rate(stamps: np.ndarray) -> float:
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return 1e9 / float(np.median(steps)) if len(steps) else 0.0


def _check_streams(streams: SessionStreams, settings: ReadSettings, result: Validation) -> None:
    if len(streams.areas):
        name_of_frames, frames = "contact_area", streams.areas
    else:
        name_of_frames, frames = "image_raw", streams.images
    wrenches = streams.wrenches
    for name, stamps, logs in (
        ("wrench", wrenches.stamp_ns, wrenches.log_ns),
        (name_of_frames, frames["stamp_ns"], frames["log_ns"]),
    ):
        if not len(stamps):
            continue
        rate, expected = _rate(stamps), TOPICS[name].rate or 0.0
        status = OK if abs(rate / expected - 1) <= RATE_TOLERANCE else NOTE
        if round(rate, 1) < MINIMUM_RATE[name]:  # as it is shown: clocks differ
            status = FAIL
        result.add(f"rate of {name}", status, f"{rate:.1f} Hz (schema {expected:g} Hz)")
        _check_order(name, stamps, result)
        delay = _delay(stamps, logs, settings, name, f"{name}/compressed")
        right = -MAXIMUM_LEAD <= float(np.median(delay)) <= MAXIMUM_DELAY
        status, doubt = (OK, "") if right else (FAIL, "clocks disagree")
        _add_log_time(name, delay, status, doubt, result)
    readings = [(r.stamp_ns, r.log_ns) for r in streams.moistures if r.log_ns is not None]
    if readings:
        stamps, logs = np.array(readings, np.int64).T
        delay = _delay(stamps, logs, settings, "moisture")
        status, doubt, lead = OK, "", -float(delay.min())
        if lead > MOISTURE_LEAD:
            status = FAIL
            doubt = f"the earliest reading is stamped {lead:.1f} s ahead: clocks disagree"
        elif float(np.median(delay)) > MOISTURE_DELAY:
            status, doubt = NOTE, "clocks disagree, or they came late"
        _add_log_time("moisture", delay, status, doubt, result)
    if len(streams.indentations):
        _check_order("indentation", streams.indentations["stamp_ns"], result)
    _check_gaps(streams, settings, result)
    _check_saturation(streams, result)


def _delay(stamps: np.ndarray, logs: np.ndarray, settings: ReadSettings, *names: str) -> np.ndarray:
    """s by which log times are behind the stamps as recorded: those that a mapping moves are not
    those of the recorder's clock. names: under which the topic may be mapped."""
    moved = next((o for n in names if (o := settings.mapping.topic(n).offset_ns)), 0)
    return (logs - stamps + moved) * 1e-9


def _add_log_time(
    name: str, delay: np.ndarray, status: str, doubt: str, result: Validation
) -> None:
    result.add(
        f"log time of {name}",
        status,
        f"{np.median(delay) * 1e3:.1f} ms behind the stamp (median; {delay.min() * 1e3:.1f} to "
        f"{delay.max() * 1e3:.1f} ms)" + (doubt and f"; {doubt}"),
    )


def _check_order(name: str, stamps: np.ndarray, result: Validation) -> None:
    steps = np.diff(stamps)
    back, equal = int((steps < 0).sum()), int((steps == 0).sum())
    status = FAIL if back else NOTE if equal else OK
    result.add(f"stamp order of {name}", status, f"{back} stamps run back, {equal} are repeated")


def _check_gaps(streams: SessionStreams, settings: ReadSettings, result: Validation) -> None:
    stamps = np.sort(streams.wrenches.stamp_ns)
    if len(stamps) < 2:
        result.add("gaps in wrench", FAIL, f"{len(stamps)} samples in all")
        return
    steps = np.diff(stamps) * 1e-9
    limit = max(LONGEST_GAP, 3.0 / max(_rate(stamps), 1e-9))
    where = np.flatnonzero(steps > limit)
    if not len(where):
        result.add("gaps in wrench", OK, f"longest step {steps.max() * 1e3:.1f} ms")
        return
    order = np.argsort(streams.wrenches.stamp_ns, kind="stable")
    normal = normal_force(streams.wrenches.force[order], settings.axis)
    touching = np.fmax(normal[where], normal[where + 1]) >= ONSET_FORCE
    count = int(touching.sum())
    result.add(
        "gaps in wrench",
        FAIL if count else NOTE,
        f"{len(where)} gaps above {limit * 1e3:.0f} ms, longest {steps.max():.2f} s, "
        f"{count} of them during contact",
    )


class Saturation(NamedTuple):
    """A force (N) at which a sensor stays for so many samples; coarse: its forces are rounded so,
    or have so little noise, that equal ones are usual."""

    force: float
    samples: int
    coarse: bool


def saturations(stamp_ns: np.ndarray, force: np.ndarray) -> list[Saturation]:
    """Extreme values at which the forces (n,) in N of one axis, with stamps (n,) in ns, stay."""
    steps = np.diff(stamp_ns)
    rate = NANOSECONDS / max(float(np.median(steps)), 1.0) if len(steps) else 0.0
    values = force[np.isfinite(force)]
    levels = np.unique(values)
    needed = max(SATURATED_SAMPLES, SATURATED_TIME * rate)
    found = []
    for extreme in levels[[-1, 0]] if len(levels) else ():
        longest = longest_run(values == extreme)
        if abs(extreme) >= LEAST_SATURATED and longest >= needed:
            coarse = _equal_forces_are_usual(values, levels, needed)
            found.append(Saturation(float(extreme), longest, coarse))
    return found


def _equal_forces_are_usual(values: np.ndarray, levels: np.ndarray, needed: float) -> bool:
    """Whether forces (n,) in N with these distinct, sorted values are rounded coarsely, or stay for
    `needed` samples where no sensor is saturated, such as at rest or in a smaller hold: at one
    value, or four times as long at two neighbouring ones."""
    if len(levels) > 1 and np.diff(levels).min() >= COARSE * (1.0 - 1e-3):
        return True
    level = np.searchsorted(levels, values)
    extreme = np.isin(values, levels[[0, -1]]) & (np.abs(values) >= LEAST_SATURATED)
    # Near the border of two values even little noise goes to and fro.
    for group, enough in ((level, 1), (level // 2, 4), ((level + 1) // 2, 4)):
        starts = np.flatnonzero(np.diff(np.where(extreme, -1, group), prepend=-2))
        samples = np.diff(starts, append=len(values))
        if samples[~extreme[starts]].max(initial=0) >= enough * needed:
            return True
    return False


def longest_run(mask: np.ndarray) -> int:
    """Most true values of a mask (n,) in a row."""
    edges = np.flatnonzero(np.diff(np.pad(mask, 1).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _check_saturation(streams: SessionStreams, result: Validation) -> None:
    axes, coarse = [], True
    for column, name in enumerate("xyz"):
        for at in saturations(streams.wrenches.stamp_ns, streams.wrenches.force[:, column]):
            coarse = coarse and at.coarse
            axes.append(f"{name} stays at {at.force:.2f} N for {at.samples} samples")
    invalid = int((~np.isfinite(streams.wrenches.force).all(axis=1)).sum())
    flags = streams.areas["flags"]
    clipped = int(((flags & AreaFlag.CLIPPED) != 0).sum())
    bright = int(((flags & AreaFlag.SATURATED) != 0).sum())
    parts = [*axes]
    if invalid:
        parts.append(f"{invalid} forces are not finite")
    if clipped:
        parts.append(f"{clipped} of {len(flags)} contacts run over the border of the image")
    if bright:
        parts.append(f"{bright} of {len(flags)} images are saturated")
    status = FAIL if invalid or (axes and not coarse) else NOTE if parts else OK
    result.add("saturation", status, "; ".join(parts) or "none")


def _check_calibration(reader: BagReader, streams: SessionStreams, result: Validation) -> None:
    attached = CALIBRATION_ATTACHMENT in reader.info.attachments
    uncalibrated = bool(((streams.areas["flags"] & AreaFlag.UNCALIBRATED) != 0).any())
    if attached:
        result.add("calibration", OK, f"{CALIBRATION_ATTACHMENT} is attached")
    elif uncalibrated:
        result.add("calibration", NOTE, "areas were measured without a plate calibration")
    elif len(streams.areas):
        status = NOTE if len(streams.images) else OK
        result.add("calibration", status, "not attached; areas are recorded")
    else:
        result.add(
            "calibration",
            FAIL,
            f"{CALIBRATION_ATTACHMENT} is not attached; areas need --calibration",
        )
