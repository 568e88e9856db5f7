# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is refused or mended before a fit: the same press twice, values that no finger can give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from finger_common.files import sha256_of
from finger_common.moisture import MOISTURE_TEXT, is_moisture
from finger_offline.trial_checks import LARGEST_FORCE, PLAUSIBLE_AREA, fault_of

from ..problem import Exclusion
from ..problem.trials import label_of


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
    labels: set[str] = set()
    for record in records:
        label, number = label_of(record), 2
        while label in labels:  # bags of one name in different folders
            record = replace(record, bag=f"{str(record.bag).split(' (')[0]} ({number})")
            label, number = label_of(record), number + 1
        first = next((seen[key] for key in fingerprints(record) if key in seen), label)
        seen.update((key, first) for key in fingerprints(record))
        reason = implausible(record) or (implausible_indentation(record) if indentation else "")
        if first is not label:
            reason = f"the same press as {first}; it counts once"
        if reason:
            out.exclusions.append(Exclusion.of(record, reason))
        else:
            labels.add(label)
            out.records.append(record)
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


def fingerprints(record: Any) -> tuple[tuple[str, ...], ...]:
    """Make the keys by which a press is known again, of its force with its times: with subject and
    condition, however the areas were measured, and with the areas, whatever it is called.

    Not by the force alone: simulated presses of two fingers may have the same.
    """
    start = record.stamp_ns[0] if len(record.stamp_ns) else 0
    drive = _hash(np.asarray(record.stamp_ns) - start, record.force)
    areas = _hash(np.asarray(record.area_stamp_ns) - start, record.area)
    return (drive, record.subject or "", record.condition or ""), (drive, areas)


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
