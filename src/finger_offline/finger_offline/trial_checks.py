"""Checks of the trials in a bag, for `finger-bag validate`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from finger_bag.validate import FAIL, NOTE, OK, CheckedBag, Validation

from .trial_records import TrialRecord, TrialSet
from .trial_split import TrialSettings, split

MAXIMUM_LAG = 0.15
"""s between force and image."""

LONGEST_LAG = 0.4
"""s, largest delay between force and area that is looked for."""

READINGS = 3
"""Moisture readings expected before and after each press (paper, section III)."""

LATERAL_RATIO = 0.25
"""Median lateral force over normal force of a trial above which it is noted."""


def check_trials(bag: CheckedBag, result: Validation) -> None:
    """Add the checks of the trials in a bag to a validation."""
    streams = bag.streams
    if not len(streams.area_stamp_ns) and len(streams.image_stamp_ns):
        # The images stand for the areas that will be measured in them.
        unknown = np.full(len(streams.image_stamp_ns), np.nan)
        streams = replace(
            streams,
            area_stamp_ns=streams.image_stamp_ns,
            area=unknown,
            real_area=unknown,
            area_sd=unknown,
            area_flags=np.zeros(len(unknown), np.int64),
        )
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
    _check_moisture(found, result)
    _check_lateral(found, result)
    _check_sync(found, result)


def _exclusions(found: TrialSet) -> str:
    return "; ".join(f"trial {e.index} ({e.reason})" for e in found.exclusions[:5])


def _check_moisture(found: TrialSet, result: Validation) -> None:
    without = [t.index for t in found if not t.moisture_before and not t.moisture_after]
    other = [
        f"trial {t.index} has {len(t.moisture_before)} + {len(t.moisture_after)}"
        for t in found
        if (len(t.moisture_before), len(t.moisture_after)) != (READINGS,) * 2
    ]
    if without:
        status, detail = FAIL, f"no reading for trial {', '.join(map(str, without[:5]))}"
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
    lags = [lag for t in found if (lag := force_image_lag(t)) is not None]
    if not lags:
        result.add("sync of force and image", NOTE, "unknown: no areas over a rising force")
        return
    lag = float(np.median(lags))
    status = OK if abs(lag) <= MAXIMUM_LAG else FAIL
    result.add(
        "sync of force and image",
        status,
        f"area lags force by {lag * 1e3:.0f} ms (median of {len(lags)} trials"
        + (")" if status == OK else "); correct image_time_offset or the clocks"),
    )


def force_image_lag(trial: TrialRecord) -> float | None:
    """Time (s) by which the area of a press lags the force, positive when the area comes late; None
    when unclear.

    The lag at which ln A over ln F of the rising and falling flanks is most nearly one line. Creep
    of the skin delays the area of a soft finger by some 10 ms, so this finds clocks that disagree,
    not the last frame's delay.
    """
    usable = np.isfinite(trial.area) & (trial.area > 0)
    stamps, area = trial.area_stamp_ns[usable], trial.area[usable]
    if len(stamps) < 6 or len(trial.stamp_ns) < 50:
        return None
    origin = int(trial.stamp_ns[0])
    time, frame = (trial.stamp_ns - origin) * 1e-9, (stamps - origin) * 1e-9
    lags = np.arange(-LONGEST_LAG, LONGEST_LAG + 1e-9, 0.01)
    costs = np.full(len(lags), np.nan)
    for index, lag in enumerate(lags):
        force = np.interp(frame - lag, time, trial.force)
        good = force >= 0.1
        if good.sum() < 6 or np.ptp(np.log(force[good])) < 0.7:
            continue
        x, y = np.log(force[good]), np.log(area[good])
        slope, offset = np.polyfit(x, y, 1)
        costs[index] = float(np.mean((y - slope * x - offset) ** 2)) / max(slope, 0.05) ** 2
    if np.isfinite(costs).sum() < 10:
        return None
    return float(lags[int(np.nanargmin(costs))])
