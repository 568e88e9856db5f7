# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recorded trials from bags, with their provenance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.bag_files import find_bags, storage_of
from finger_bag.mapping import TopicMapping
from finger_bag.reader import open_bag
from finger_common.contact_threshold import LIFTOFF_FORCE, ONSET_FORCE
from finger_common.errors import InputError, listed
from finger_common.files import sha256_of, sha256_of_file
from finger_offline.trial_records import Exclusion as TrialExclusion
from finger_offline.trial_records import TrialRecord, TrialSet
from finger_offline.trial_split import TrialSettings
from finger_offline.trials import (
    NoAreas,
    check_areas,
    shared_sessions,
    streams_with_areas,
    trials_in,
    trials_of,
    without_superseded,
)

from ..options import FitOptions
from ..problem import Exclusion


@dataclass
class Loaded:
    """Trials of all bags.

    exclusions, problems: of reading; lost: bags of which something could not be read; sources: per
    bag its hash, where areas and force came from, and what made the bag.
    """

    records: list[TrialRecord] = field(default_factory=list)
    exclusions: list[Exclusion] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    sources: list[dict[str, Any]] = field(default_factory=list)


def reading(options: FitOptions, mapping: str | Path | None = None, **given: Any) -> TrialSettings:
    """Settings by which the trials of a fit are read.

    mapping: file that names other topics and units (docs/bags.md); given: further fields of
    TrialSettings, such as calibration. Raises InputError for a mapping or values that are wrong.
    """
    return TrialSettings(
        mapping=TopicMapping.load(mapping) if mapping else TopicMapping(),
        onset_force=options.onset_force,
        # Below the onset, so that noise does not end a contact.
        liftoff_force=LIFTOFF_FORCE / ONSET_FORCE * options.onset_force,
        image_areas="always" if options.vision else "absent",
        **given,
    )


def load(
    paths: Iterable[str | Path],
    settings: TrialSettings,
    progress: Callable[[int, int], None] | None = None,
) -> Loaded:
    """Read every bag among paths (bags, or folders of bags).

    Areas come from contact_area, or from the images where it is absent or the settings say so.
    Force comes from wrench, or else from wrench_raw less its mean before the press. progress:
    called with bags read and all bags. A bag without areas is an exclusion beside others that have
    them. Raises InputError when a path is no bag, a bag holds no force, or none holds areas.
    """
    bags = find_bags(paths)
    if settings.calibration and not Path(settings.calibration).is_file():
        raise InputError(
            f"{settings.calibration}: no such file; give the calibration of the camera"
        )
    out = Loaded()
    excluded: list[TrialExclusion] = []
    lacking: list[NoAreas] = []
    for number, bag in enumerate(bags):
        if progress is not None:
            progress(number, len(bags))
        try:
            found, force_source, made_by = _read(bag, settings)
        except NoAreas as error:
            lacking.append(error)
            found, force_source = error.found, ""
        out.records += found.trials
        excluded += found.exclusions
        out.problems += found.problems
        out.lost += found.lost
        if not force_source:
            continue
        out.sources.append(
            {
                "bag": bag.name,
                "sha256": bag_hash(bag),
                "areas": sorted({t.area_source for t in found.trials}),
                "force": force_source,
                "made_by": made_by,
                "trials": len(found.trials),
            }
        )
    if progress is not None:
        progress(len(bags), len(bags))
    check_areas(lacking, len(bags))
    recorded = [source["bag"] for source in out.sources if "topic" in source["areas"]]
    if recorded and (settings.calibration or settings.area_per_pixel):
        out.problems.append(
            f"{recorded[0]}{f' and {len(recorded) - 1} more' if recorded[1:] else ''}: areas are "
            "recorded, so that calibration and area per pixel are not used; measure the images "
            "again with --vision"
        )
    out.problems += shared_sessions(out.records)
    out.records, again = without_superseded(out.records)
    out.exclusions = [Exclusion.of(e, e.reason) for e in [*excluded, *again]]
    return out


def _read(bag: Path, settings: TrialSettings) -> tuple[TrialSet, str, str]:
    """Trials of one bag, the topic the force came from, and what made the bag."""
    with open_bag(bag) as reader:
        metadata = reader.info.metadata
        made_by = " ".join(filter(None, (metadata.source, metadata.extra.get("area_source", ""))))
        mapped = settings.mapping.topic("wrench").topic
        if mapped or reader.topic("wrench", settings.namespace) is not None:
            return trials_of(reader, settings), "wrench", made_by
        if reader.topic("wrench_raw", settings.namespace) is None:
            raise InputError(
                f"{bag}: holds neither 'wrench' nor 'wrench_raw'; record the force or name its "
                f"topic in a mapping file{noted(reader.all_problems())}"
            )
        streams = streams_with_areas(reader, replace(settings, wrench_topic="wrench_raw"))
        wrenches = streams.wrenches
        tare = recorded_tare(metadata.extra, wrenches.force, wrenches.stamp_ns)
        streams.wrenches = wrenches._replace(force=wrenches.force - tare)
        return trials_in(reader, streams, settings), "wrench_raw less tare", made_by


def noted(problems: Sequence[str]) -> str:
    """What reading found in the bags, as the end of a sentence on data that are missing."""
    return f"; noted in the bags: {listed(problems, 4, '; ')}" if problems else ""


def recorded_tare(extra: dict[str, str], force: np.ndarray, stamp_ns: np.ndarray) -> np.ndarray:
    """Tare (3,) in N: metadata key `tare_force` ("x y z"), else the mean of the first 0.1 s.

    Raises InputError for a key that is not three numbers.
    """
    text = extra.get("tare_force", "")
    if text:
        try:
            values = np.array([float(v) for v in text.replace(",", " ").strip("[] ").split()])
        except ValueError:
            values = np.empty(0)
        if values.shape != (3,):
            raise InputError(f"metadata 'tare_force' is '{text}', three numbers in N are needed")
        return values
    early = stamp_ns <= stamp_ns[0] + 100_000_000
    return np.nanmean(force[early], axis=0)


def bag_hash(bag: Path) -> str:
    """Hash of a bag: of the hashes of its data files, in order of name."""
    files = [bag]
    if not bag.is_file():
        inside = (p for p in bag.iterdir() if storage_of(p) or p.name == "metadata.yaml")
        files = sorted(p for p in inside if p.is_file())
    return sha256_of([[p.name, sha256_of_file(p, "bag file")] for p in files])
