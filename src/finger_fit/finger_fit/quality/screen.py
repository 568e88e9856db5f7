# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is refused or mended before a fit: the same press twice, values that no finger can give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from finger_common.errors import listed
from finger_common.files import sha256_of
from finger_common.moisture import MOISTURE_TEXT, is_moisture
from finger_common.stamps import NANOSECONDS
from finger_common.units import LARGEST_FORCE
from finger_offline.trial_checks import PLAUSIBLE_AREA, fault_of

from ..problem import Exclusion
from ..problem.trials import label_of

FIRST_DATE = 1_072_915_200 * NANOSECONDS
"""Stamp (ns) from which times are dates: 2004-01-01. Times that are none are counted from 2000 by
imports, from 1970 by a clock that was not set."""


@dataclass
class Screened:
    """What is left to fit, what is not, and notes on what was mended."""

    records: list[Any] = field(default_factory=list)
    exclusions: list[Exclusion] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def screen(records: Sequence[Any], indentation: bool = True) -> Screened:
    """Leave out presses that came before, and those whose force, area or, where it is used,
    indentation is of another unit or sign; give every press a label of its own.

    A recorded trial is any object with the fields of `finger_offline.trial_records.TrialRecord`.
    """
    out = Screened()
    seen: dict[tuple[str, ...], str] = {}
    forces: dict[tuple[str, ...], list[str]] = {}
    labels: set[str] = set()
    for record in records:
        label, number = label_of(record), 2
        while label in labels:  # bags of one name in different folders
            record = replace(record, bag=f"{str(record.bag).split(' (')[0]} ({number})")
            label, number = label_of(record), number + 1
        force, *proofs = fingerprints(record)
        first = next((seen[key] for key in proofs if key in seen), "")
        reason = implausible(record) or (implausible_indentation(record) if indentation else "")
        if first:
            reason = f"the same press as {first}; it counts once"
        if first or not reason:
            seen.update((key, first or label) for key in proofs)
        if reason:
            out.exclusions.append(Exclusion.of(record, reason))
            continue
        labels.add(label)
        out.records.append(record)
        forces.setdefault(force, []).append(label)
    alike = [listed(group, 3) for group in forces.values() if len(group) > 1]
    if alike:
        out.notes.append(
            f"presses of the same force, with areas of their own: {listed(alike, 3, '; ')}; all "
            "are kept: if two of them are measurements of one press, give one"
        )
    wrong = [v for record in out.records for v in _readings(record) if not is_moisture(v)]
    if wrong:
        out.records = [
            replace(
                record,
                moisture_before=[v for v in record.moisture_before if is_moisture(v)],
                moisture_after=[v for v in record.moisture_after if is_moisture(v)],
            )
            for record in out.records
        ]
        out.notes.append(
            f"{len(wrong)} moisture readings lie off the scale of {MOISTURE_TEXT} "
            f"(such as {wrong[0]:.4g}) and are not used"
        )
    return out


def _readings(record: Any) -> list[float]:
    values = (*record.moisture_before, *record.moisture_after)
    return [value for value in values if np.isfinite(value)]


def fingerprints(record: Any) -> list[tuple[str, ...]]:
    """Make the keys of a press: its force with its times, subject and condition, which presses of
    a nominal force share; then those by which it is known again: its force and areas, whatever it
    is called, and, where its stamps are dates, its force and date, however its areas were measured.

    Not by the force alone: simulated presses of two fingers may have the same.
    """
    start = int(record.stamp_ns[0]) if len(record.stamp_ns) else 0
    drive = _hash(np.asarray(record.stamp_ns) - start, record.force)
    areas = _hash(np.asarray(record.area_stamp_ns) - start, record.area)
    force = (drive, record.subject or "", record.condition or "")
    dated = [(*force, str(start))] if start >= FIRST_DATE else []
    return [force, (drive, areas), *dated]


def _hash(*columns: Any) -> str:
    return sha256_of(b"".join(np.asarray(values, dtype=float).tobytes() for values in columns))


def implausible(record: Any) -> str:
    """Why force or area cannot be a finger's; empty where they can."""
    force = np.asarray(record.force, dtype=float)
    area = np.asarray(record.area, dtype=float)
    highest = float(np.nanmax(force)) if np.isfinite(force).any() else 0.0
    largest = float(np.nanmax(area)) if np.isfinite(area).any() else 0.0
    if highest > LARGEST_FORCE:
        return (
            f"force goes up to {highest:.4g} N, more than a finger can press; name its unit in a "
            "mapping file"
        )
    low, high = PLAUSIBLE_AREA
    if 0.0 < largest and not low <= largest <= high:
        return (
            f"its largest area is {largest * 1e6:.3g} mm², that of a fingertip lies between "
            f"{low * 1e6:g} and {high * 1e6:g} mm²; name the unit in a mapping file, or correct "
            "the scale of the images"
        )
    return ""


def implausible_indentation(record: Any) -> str:
    """Why the indentation cannot be a finger's; empty where it can, or none was measured."""
    if not len(getattr(record, "indentation", ())):
        return ""
    fault = fault_of(record)
    if fault is None or fault.option not in ("unit", "sign") or not fault.certain:
        return ""
    return f"{fault.text}; name its {fault.option} in a mapping file, or fit with indentation_sd 0"
