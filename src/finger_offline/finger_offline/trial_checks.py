# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Checks of the trials in a bag, for `finger-bag validate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from finger_bag.streams import AREA, SessionStreams, in_stamp_order
from finger_bag.validate import FAIL, MINIMUM_RATE, NOTE, OK, CheckedBag, Validation
from finger_common.axes import directed, mostly_pulls, other_axis
from finger_common.errors import listed
from finger_common.flags import AreaFlag
from finger_common.moisture import MOISTURE_TEXT, is_moisture
from finger_common.stamps import nanoseconds, seconds
from finger_common.units import LARGEST_FORCE

from .held_areas import held_rows
from .indentation_checks import IndentationFault, indentation_fault
from .lag import (
    LONGEST_LAG,
    MAXIMUM_LAG,
    WORTH_A_NOTE,
    Press,
    force_image_lag,
    indentation_lag,
    lag_change,
    lag_text,
    press_lags,
    travel_ratio,
)
from .trial_records import Exclusion, TrialRecord, TrialSet
from .trial_split import (
    PULLED,
    TrialSettings,
    force_samples,
    split,
    without_contact,
)
from .unloaded import LARGEST_TARE, Unloaded, unloaded_plate

PLAUSIBLE_AREA = (5e-6, 2e-3)
"""m²; the largest area of a press of a fingertip lies between (the paper's: 60 to 150 mm²)."""

SHORTEST_PRESS, LONGEST_PRESS = 0.02, 1200.0
"""s; presses that are all shorter or all longer have times of another unit."""

LONG_PRESS, SLOW_FORCE, SLOW_FRAMES = 300.0, 0.5, 5.0
"""s; so have presses that are all longer than the first, with samples of the force further apart
than the second, or frames further apart than the third."""

NOTED_TARE = 0.03
"""N of force without contact that is noted: as much ends a contact."""

MANY_PRESSES, MANY_AREAS = 3, 10
"""Presses, and areas in each, of which a lag can be told where clocks are right."""

LARGEST_RATIO = 1.5
"""Measured indentation over that of the default finger at the same area beyond which, or below its
inverse, it is noted; fingers differ by a third or so."""

MOST_FRAMES = 0.8
"""Share of the frames, of those in presses and of the others, from which on what they show stays on
the plate."""

MOST_UNKNOWN = 0.3
"""Share of the frames in a press that may have no area."""

USUAL, LONE, FEWEST_OTHERS = 0.9, 3.0, 5
"""A single area is far above others that are this many or more when it is so many times this
quantile of them, and of the areas beside it."""

READINGS = 3
"""Moisture readings expected before and after each press (paper, section III)."""

SYNC = "sync of force and image"

OF_TARE = {"target force", SYNC}
"""Checks that a wrong tare alone may fail."""

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
    forces = force_samples(streams, settings)
    turned = "" if found.trials else _other_axis(forces, streams, settings)
    # Of a force along another axis nothing is known of the unloaded plate.
    tare_fails = not turned and _check_tare(found, forces, streams, result)
    left_out = [e for e in found.exclusions if found.trials or e.reason != PULLED]
    unused = f"; left out: {_exclusions(left_out)}" if left_out else ""
    unused += f"; {found.unannounced}" if found.unannounced else ""
    if not found.trials and found.pulls:
        pulls = "1 pull" if len(found.pulls) == 1 else f"{len(found.pulls)} pulls"
        text = f"{pulls}: fit for the friction (process --slip), not for the area"
        result.add("trials", NOTE, text + unused)
        return
    if not found.trials:
        reasons = listed(dict.fromkeys(e.reason for e in found.exclusions), 3, "; ")
        words = (f"none can be used ({reasons})", found.unannounced, turned)
        result.add("trials", FAIL, "; ".join(filter(None, words)))
        return
    conditions = ", ".join(f"{len(found.of(c))} {c or 'unnamed'}" for c in found.conditions)
    result.add("trials", NOTE if unused else OK, f"{conditions}{unused}")
    short = [t for t in found.trials if t.peak_force < t.target_force]
    detail = f"{len(found) - len(short)} of {len(found)} reach it"
    if short:
        detail += "; " + listed(
            f"trial {t.index}: {t.peak_force:.2f} of {t.target_force:g} N" for t in short
        )
    result.add("target force", FAIL if short else OK, detail)
    _check_values(found, result)
    if len(bag.streams.areas):
        _check_areas(found, result)
    _check_indentation(found, result)
    _check_moisture(found, result)
    _check_lateral(found, result)
    _check_sync(found, forces, streams, settings, result)
    if tare_fails:
        result.checks = [
            replace(c, status=NOTE, detail=f"{c.detail}; judge it again once the tare is right")
            if c.name in OF_TARE and c.status == FAIL
            else c
            for c in result.checks
        ]


def _other_axis(forces: np.ndarray, streams: SessionStreams, settings: TrialSettings) -> str:
    """Sentence on a recording that presses along another axis; "" where it does not."""
    squares = directed(streams.wrenches.force)
    pressed = forces["normal"].max(initial=0.0) >= settings.minimum_peak
    if pressed and not mostly_pulls(squares, settings.axis):
        return ""
    return other_axis(squares, settings.axis)


def _check_tare(
    found: TrialSet, forces: np.ndarray, streams: SessionStreams, result: Validation
) -> bool:
    """Force of the unloaded plate: how it moves in the whole recording, and beside the trials what
    a fit takes off; where they show none, of the whole recording; nothing where that shows none
    either. Gives whether it fails."""
    moved = found.moved
    plates = [("", moved)] + [
        (f"trial {t.index}: ", _plate(t.stamp_ns, t.force, t.area_stamp_ns, t.area, t.area_flags))
        for t in (*found.trials, *found.pulls)
    ]
    if not any(plate for _, plate in plates):
        frames = streams.areas
        stamps = forces["stamp_ns"], forces["normal"], frames["stamp_ns"]
        plates = [("", _plate(*stamps, frames["area"], frames["flags"]))]
    known = [(where, plate) for where, plate in plates if plate is not None]
    if not known:
        return False
    where, plate = max(known, key=lambda named: round(abs(named[1].force), 2))
    size = abs(plate.force)
    status = FAIL if size > LARGEST_TARE else NOTE if size > NOTED_TARE else OK
    remedy = "; record a tared force, or take this off before the import"
    if moved is not None and moved.moves is not None and plate is moved:
        since = int(forces["stamp_ns"][0]) + nanoseconds(moved.moves[0])
        first = next((t for t in (*found.trials, *found.pulls) if t.stamp_ns[-1] > since), None)
        where = f"from trial {first.index} on: " if first is not None else ""
        remedy = (
            "; look what moved it (a cable, warmth, an overload), tare, and record these presses "
            "again, or import the parts with --tare each"
        )
    result.add("tare", status, where + plate.words + ("" if status == OK else remedy))
    return status == FAIL


def _plate(
    stamp_ns: np.ndarray,
    force: np.ndarray,
    frame_ns: np.ndarray,
    area: np.ndarray,
    flags: np.ndarray,
) -> Unloaded | None:
    """As `unloaded_plate`; stamp_ns, force (n,) in N; frame_ns, area, flags (k,): of the frames."""
    if not len(stamp_ns):
        return None
    time, frames = (seconds(stamps - stamp_ns[0]) for stamps in (stamp_ns, frame_ns))
    empty = without_contact(area, flags)
    return unloaded_plate(time, force, frames[np.isfinite(area) & ~empty], frames[empty])


def _exclusions(left_out: list[Exclusion]) -> str:
    return listed((f"trial {e.index} ({e.reason})" for e in left_out), 5, "; ")


def _check_values(found: TrialSet, result: Validation) -> None:
    """Forces and areas of another unit than N and m²."""
    force = max(t.peak_force for t in found)
    areas = np.concatenate([t.area for t in found])
    area = float(areas[np.isfinite(areas)].max(initial=0.0))
    wrong = []
    if force > LARGEST_FORCE:
        wrong.append(f"force up to {force:.4g} N")
    if area and not PLAUSIBLE_AREA[0] <= area <= PLAUSIBLE_AREA[1]:
        wrong.append(f"areas up to {area * 1e6:.3g} mm²")
    text = f"{' and '.join(wrong)} cannot be a finger's; name the unit in a mapping file"
    result.add("units", FAIL if wrong else OK, text if wrong else "force and areas of a finger")


def _check_areas(found: TrialSet, result: Validation) -> None:
    """Recorded areas that show no contact in a trial, are no areas, or are held from row to row."""
    words, fails = [], False
    without = [t.index for t in found if len(t.area) and not (t.area > 0).any()]
    if without:
        fails = True
        words.append(
            f"no contact in the areas of trial {listed(without)}: was a finger on "
            "the plate when the camera learned it? Recorded images can be measured again, "
            "finger-bag process --images yes"
        )
    unknown, held = [], 0
    for trial in found:
        stamps = trial.area_stamp_ns
        press = (stamps >= trial.onset_ns) & (stamps <= _end_of(trial))
        # Sensors may give any area where their flag says that there is no contact.
        bad = press & ~(np.isfinite(trial.area) & (trial.area >= 0.0))
        bad &= (trial.area_flags & AreaFlag.NO_CONTACT) == 0
        if bad.any():
            unknown.append(f"trial {trial.index}: {bad.sum()} of {press.sum()}")
            fails |= bool(bad.sum() > MOST_UNKNOWN * press.sum())
        rows = held_rows(stamps, trial.area, trial.stamp_ns, trial.force)
        held += int((press & rows).sum())
    if unknown:
        words.append(
            "areas in presses are negative or not finite, and count as none "
            f"({listed(unknown, 3, '; ')}); correct what writes them"
        )
    whole = np.concatenate([t.area for t in found])
    trials = np.repeat([t.index for t in found], [len(t.area) for t in found])
    if len(lone := lone_areas(whole)):
        named = (f"trial {trials[row]}: {whole[row] * 1e6:.0f} mm²" for row in lone)
        words.append(
            "single areas lie far above those before and after them "
            f"({listed(named, 3, '; ')}); look at these frames, and leave out what is no area"
        )
    if held:
        words.append(
            f"{held} areas in presses hold the one before, and count as new measurements; record "
            "one message a frame of the camera, or import a table of them, which takes each once"
        )
    if words:
        result.add("areas", FAIL if fails else NOTE, "; ".join(words))


def _check_indentation(found: TrialSet, result: Validation) -> None:
    """Indentations of another unit, sign or clock; nothing where none was measured."""
    measured = [t for t in found if len(t.indentation)]
    if not measured:
        return
    faults = [(t.index, fault) for t in measured if (fault := fault_of(t)) is not None]
    words = [f"trial {index}: {fault.text}" for index, fault in faults]
    words = [listed(words, 3, "; ")] if words else []
    status = FAIL if any(f.certain for _, f in faults) else NOTE if faults else OK
    lag = indentation_lag(map(_indented, measured)) if status != FAIL else None
    if lag is not None and abs(lag) > WORTH_A_NOTE:
        status = FAIL if abs(lag) > MAXIMUM_LAG else NOTE
        words.append(
            f"{lag_text('readings', lag)}; move them by {-lag:.2f} s (import: "
            "--indentation-time-offset; mapping file: time_offset), or correct the clocks"
        )
    elif status == OK and abs(np.log(ratio := _travel_ratio(measured))) > np.log(LARGEST_RATIO):
        status = NOTE
        words.append(
            f"the indentation is {ratio:.2g} times that of the default finger at the same areas; "
            "check the gain of the sensor, or whether the finger is another one"
        )
    if len(measured) < len(found):
        words.append(f"{len(measured)} of {len(found)} trials have one")
        status = NOTE if status == OK else status
    if any(fault.certain for _, fault in faults):
        words.append("correct unit, sign and stamp in a mapping file")
    result.add("indentation", status, "; ".join(words) or "rises with the force in all trials")


def lone_areas(area: np.ndarray) -> np.ndarray:
    """Rows of areas (k,) that lie far above all others, and above those before and after them."""
    known = np.nan_to_num(area, posinf=0.0)
    touching = known[known > 0.0]
    if len(touching) < FEWEST_OTHERS:
        return np.empty(0, np.int64)
    usual = np.quantile(touching, USUAL, method="lower")
    beside = np.maximum(np.append(0.0, known[:-1]), np.append(known[1:], 0.0))
    return np.flatnonzero((known > LONE * usual) & (known > LONE * beside))


def _end_of(trial: TrialRecord) -> int:
    """ns; the end of a press, that of the recording where it does not end before."""
    return int(trial.stamp_ns[-1]) if trial.liftoff_ns is None else trial.liftoff_ns


def _indented(trial: TrialRecord) -> Press:
    """The press of a trial that has a measured indentation."""
    press = (trial.stamp_ns >= trial.onset_ns) & (trial.stamp_ns <= _end_of(trial))
    readings = trial.indentation_stamp_ns, trial.indentation
    return (trial.stamp_ns[press], trial.force[press], *readings)


def fault_of(trial: TrialRecord) -> IndentationFault | None:
    """What is wrong with the measured indentation of a trial that has one."""
    return indentation_fault(*_indented(trial))


def _travel_ratio(trials: list[TrialRecord]) -> float:
    """Median travel of the presses over that of the default finger; NaN where it is unknown."""
    ratios = [travel_ratio(_indented(t), t.area_stamp_ns, t.area) for t in trials]
    known = [ratio for ratio in ratios if np.isfinite(ratio)]
    return float(np.median(known)) if known else float("nan")


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
        detail = f"neither reading nor condition for trial {listed(unnamed)}"
    elif without:
        status = NOTE
        detail = f"no reading for trial {listed(without)}; its condition is named"
    elif other:
        status = NOTE
        detail = f"{listed(other)}; {READINGS} + {READINGS} are expected"
    else:
        status, detail = OK, f"{READINGS} + {READINGS} readings per trial"
    readings = [value for t in found for value in (*t.moisture_before, *t.moisture_after)]
    if wrong := sum(not is_moisture(value) for value in readings):
        status = NOTE if status == OK else status
        detail += f"; {wrong} of {len(readings)} are off the scale ({MOISTURE_TEXT}) and not used"
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


def _check_sync(
    found: TrialSet,
    forces: np.ndarray,
    streams: SessionStreams,
    settings: TrialSettings,
    result: Validation,
) -> None:
    """Lag of the areas behind the force, and whether it changes from press to press."""
    name = SYNC
    areas, stamp = in_stamp_order(streams.areas), forces["stamp_ns"]
    pressed = [
        (int(stamp[first]), int(stamp[end - 1]))
        for first, end in settings.presses(stamp, forces["pressing"])
        if forces["pressing"][first:end].max() >= settings.minimum_peak
    ]
    if not pressed:
        result.add(name, NOTE, "unknown: no press")
        return
    at = seconds(np.array(pressed) - stamp[0])
    frames = seconds(areas["stamp_ns"] - stamp[0])
    lags = press_lags(at, frames, areas["area"])
    period = float(np.median(np.diff(frames))) if len(frames) > 1 else 0.0
    change = lag_change(at, lags, period) if lags is not None else ""
    if change:
        result.add(name, FAIL, change)
        return
    lag = force_image_lag(found)
    # The model is compared within a press; what is later than that is told by the presses' times.
    if lags is not None and abs(middle := float(np.median(lags))) > LONGEST_LAG:
        lag = middle
    if lag is None:
        # The median: forces may be recorded during the presses only.
        rate = 1.0 / max(float(np.median(np.diff(seconds(stamp - stamp[0])))), 1e-9)
        if rate < MINIMUM_RATE["wrench"]:
            result.add(name, NOTE, f"unknown: a force of {rate:.1f} Hz does not tell it")
            return
        usable = [t for t in found if np.count_nonzero(t.area > 0) >= MANY_AREAS]
        if len(usable) < MANY_PRESSES:
            result.add(name, NOTE, "unknown: no areas over a rising force")
            return
        if stays := _stays(pressed, areas, int(stamp[-1])):
            result.add(name, FAIL, stays)
            return
        result.add(
            name,
            FAIL,
            f"the areas of {len(usable)} presses do not follow the force (areas over "
            f"{np.ptp(frames):.1f} s, force over {seconds(stamp[-1] - stamp[0]):.1f} s); correct "
            "the clock or the frame rate of the areas",
        )
        return
    status = FAIL if abs(lag) > MAXIMUM_LAG else NOTE if abs(lag) > WORTH_A_NOTE else OK
    result.add(
        name,
        status,
        lag_text("areas", lag)
        + (
            ""
            if status == OK
            else f"; move them by {-lag:.2f} s (import: --time-offset; mapping file: time_offset; "
            "rig: image_time_offset), or correct the clocks"
        ),
    )


def _stays(pressed: list[tuple[int, int]], areas: np.ndarray, end_ns: int) -> str:
    """In words, a contact that the frames after the first press show whether or not the force
    presses; empty for one that comes and goes, as with a clock that is wrong."""
    frames = areas[(areas["stamp_ns"] > pressed[0][1]) & (areas["stamp_ns"] <= end_ns)]
    stamps, empty = frames["stamp_ns"], without_contact(frames["area"], frames["flags"])
    touching = np.isfinite(frames["area"]) & ~empty
    during = np.zeros(len(frames), bool)
    for first, last in pressed:
        during |= (stamps >= first) & (stamps <= last)
    shares = [float(touching[of].mean()) if of.any() else 0.0 for of in (during, ~during)]
    if min(shares) < MOST_FRAMES:
        return ""
    return (
        f"the areas show a contact in {np.count_nonzero(touching & ~during)} of "
        f"{np.count_nonzero(~during)} frames between the presses, where the force is zero: a print "
        "or dirt on the plate; clean it and let the camera learn it anew"
    )


def length_fault(
    lengths: Sequence[float], period: float, remedy: str, frame_period: float = 0.0
) -> str:
    """Say that no presses last so long (s), and what to do; empty where they may.

    period: s between the samples of the force; frame_period: s between areas, 0 where unknown.
    """
    shortest, longest = min(lengths), max(lengths)
    if longest < SHORTEST_PRESS:
        return f"lasts {longest:.3g} s; {remedy}"
    slow = period > SLOW_FORCE or frame_period > SLOW_FRAMES
    if shortest > LONGEST_PRESS or (shortest > LONG_PRESS and slow):
        return (
            f"lasts {shortest:.3g} s; {remedy}, or a press of up to {LONGEST_PRESS:g} s with two "
            "samples of the force or more in each second and an area every "
            f"{SLOW_FRAMES:g} s or more often"
        )
    return ""
