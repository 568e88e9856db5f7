# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Checks of the trials in a bag, for `finger-bag validate`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from finger_bag.streams import AREA
from finger_bag.validate import FAIL, NOTE, OK, CheckedBag, Validation

from .indentation_checks import IndentationFault, indentation_fault
from .lag import MAXIMUM_LAG, WORTH_A_NOTE, force_image_lag
from .trial_records import TrialRecord, TrialSet
from .trial_split import TrialSettings, split

PLAUSIBLE_AREA = (5e-6, 2e-3)
"""m²; the largest area of a press of a fingertip lies between (the paper's: 60 to 150 mm²)."""

SHORTEST_PRESS, LONGEST_PRESS = 0.02, 300.0
"""s; presses that are all shorter or all longer have times of another unit."""

LARGEST_FORCE = 100.0
"""N; a finger cannot press harder without injury, another unit can."""

READINGS = 3
"""Moisture readings expected before and after each press (paper, section III)."""

LATERAL_RATIO = 0.25
"""Median lateral force over normal force of a trial above which it is noted."""


def check_trials(bag: CheckedBag, result: Validation) -> None:
    """Add the checks of the trials in a bag to a validation."""
    streams = bag.streams
    if not len(streams.areas) and len(streams.images):
        # The images stand for the areas that will be measured in them.
        areas = np.zeros(len(streams.images), AREA)
        areas["stamp_ns"] = streams.images["stamp_ns"]
        areas["area"] = areas["real_area"] = areas["sd"] = np.nan
        streams = replace(streams, areas=areas)
    settings = TrialSettings.of(bag.settings)
    reader = bag.reader
    found = split(streams, reader.info.metadata, settings, str(reader.path))
    if not found.trials:
        reasons = "; ".join(dict.fromkeys(e.reason for e in found.exclusions[:3]))
        result.add("trials", FAIL, f"none can be used ({reasons})")
        return
    conditions = ", ".join(f"{len(found.of(c))} {c or 'unnamed'}" for c in found.conditions)
    left_out = f"; left out: {_exclusions(found)}" if found.exclusions else ""
    result.add("trials", NOTE if left_out else OK, f"{conditions}{left_out}")
    short = [t for t in found.trials if t.peak_force < t.target_force]
    detail = f"{len(found) - len(short)} of {len(found)} reach it"
    if short:
        detail += "; " + ", ".join(
            f"trial {t.index}: {t.peak_force:.2f} of {t.target_force:g} N" for t in short[:5]
        )
    result.add("target force", FAIL if short else OK, detail)
    _check_values(found, result)
    if len(bag.streams.areas):
        _check_areas(found, result)
    _check_indentation(found, result)
    _check_moisture(found, result)
    _check_lateral(found, result)
    _check_sync(found, result)


def _exclusions(found: TrialSet) -> str:
    return "; ".join(f"trial {e.index} ({e.reason})" for e in found.exclusions[:5])


def _check_values(found: TrialSet, result: Validation) -> None:
    """Forces and areas of another unit than N and m²."""
    force = max(t.peak_force for t in found)
    areas = np.concatenate([t.area for t in found])
    area = float(np.nanmax(areas)) if np.isfinite(areas).any() else 0.0
    wrong = []
    if force > LARGEST_FORCE:
        wrong.append(f"force up to {force:.4g} N")
    if area and not PLAUSIBLE_AREA[0] <= area <= PLAUSIBLE_AREA[1]:
        wrong.append(f"areas up to {area * 1e6:.3g} mm²")
    text = f"{' and '.join(wrong)} cannot be a finger's; name the unit in a mapping file"
    result.add("units", FAIL if wrong else OK, text if wrong else "force and areas of a finger")


def _check_areas(found: TrialSet, result: Validation) -> None:
    """Trials whose recorded areas show no contact."""
    without = [t.index for t in found if len(t.area) and not (t.area > 0).any()]
    if without:
        result.add(
            "areas",
            FAIL,
            f"no contact in the areas of trial {', '.join(map(str, without[:5]))}: was a finger on "
            "the plate when the camera learned it? Recorded images can be measured again, "
            "finger-bag process --images yes",
        )


def _check_indentation(found: TrialSet, result: Validation) -> None:
    """Indentations of another unit, sign or clock; nothing where none was measured."""
    measured = [t for t in found if len(t.indentation)]
    if not measured:
        return
    faults = [(t.index, fault) for t in measured if (fault := fault_of(t)) is not None]
    words = [f"trial {index}: {fault.text}" for index, fault in faults[:3]]
    status = FAIL if any(f.certain for _, f in faults) else NOTE if faults else OK
    if len(measured) < len(found):
        words.append(f"{len(measured)} of {len(found)} trials have one")
        status = NOTE if status == OK else status
    if status == FAIL:
        words.append("correct unit, sign and stamp in a mapping file")
    result.add("indentation", status, "; ".join(words) or "rises with the force in all trials")


def fault_of(trial: TrialRecord) -> IndentationFault | None:
    """What is wrong with the measured indentation of a trial that has one."""
    end = trial.stamp_ns[-1] if trial.liftoff_ns is None else trial.liftoff_ns
    press = (trial.stamp_ns >= trial.onset_ns) & (trial.stamp_ns <= end)
    return indentation_fault(
        trial.stamp_ns[press],
        trial.force[press],
        trial.indentation_stamp_ns,
        trial.indentation,
    )


def _check_moisture(found: TrialSet, result: Validation) -> None:
    without = [t.index for t in found if not t.moisture_before and not t.moisture_after]
    other = [
        f"trial {t.index} has {len(t.moisture_before)} + {len(t.moisture_after)}"
        for t in found
        if (len(t.moisture_before), len(t.moisture_after)) != (READINGS,) * 2
    ]
    unnamed = [t.index for t in found if t.index in without and not t.condition]
    if unnamed:
        status = FAIL
        detail = f"neither reading nor condition for trial {', '.join(map(str, unnamed[:5]))}"
    elif without:
        status = NOTE
        detail = f"no reading for trial {', '.join(map(str, without[:5]))}; its condition is named"
    elif other:
        status = NOTE
        detail = f"{', '.join(other[:5])}; {READINGS} + {READINGS} are expected"
    else:
        status, detail = OK, f"{READINGS} + {READINGS} readings per trial"
    result.add("moisture", status, detail)


def _check_lateral(found: TrialSet, result: Validation) -> None:
    ratios = []
    for trial in found:
        pressed = trial.force >= 0.2
        if pressed.any():
            ratios.append(float(np.median(trial.lateral_force[pressed] / trial.force[pressed])))
    worst = max(ratios, default=0.0)
    status = NOTE if worst > LATERAL_RATIO else OK
    result.add("lateral force", status, f"at most {worst:.2f} of the normal force (trial medians)")


def _check_sync(found: TrialSet, result: Validation) -> None:
    lag = force_image_lag(found)
    if lag is None:
        result.add("sync of force and image", NOTE, "unknown: no areas over a rising force")
        return
    status = FAIL if abs(lag) > MAXIMUM_LAG else NOTE if abs(lag) > WORTH_A_NOTE else OK
    result.add(
        "sync of force and image",
        status,
        f"areas come {abs(lag) * 1e3:.0f} ms {'late' if lag >= 0 else 'early'} beyond the creep of "
        "the skin" + ("" if status == OK else "; correct image_time_offset or the clocks"),
    )
