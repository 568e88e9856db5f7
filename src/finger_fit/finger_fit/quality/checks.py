# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a reader should know of a condition's data before its numbers: checks with a status each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from finger_bag.validate import FAIL, NOTE, OK, longest_run, saturations
from finger_common.errors import listed
from finger_common.flags import AreaFlag
from finger_model.geometry import Geometry
from finger_offline.lag import MAXIMUM_LAG, WORTH_A_NOTE, log_lag
from finger_offline.trial_checks import fault_of

from ..options import FitOptions
from ..problem import FitTrial
from ..problem.moisture import moisture_clusters
from ..problem.trials import label_of
from ..report_units import MM2, MM4, minus, three_digits
from ..results import ConditionFit, Quality, TrialQuality
from ..uncertainty import active_bounds
from .misfit import Misfit, misfit

DOUBTFUL = {
    AreaFlag.SATURATED: "saturated",
    AreaFlag.LOW_CONTRAST: "of low contrast",
    AreaFlag.SPARSE: "with few ridges",
    AreaFlag.MULTIPLE_REGIONS: "with several regions",
    AreaFlag.NO_BACKGROUND: "without background",
}
"""Flags of a frame that leave it usable but doubtful."""

MANY_FRAMES = 0.25
"""Part of the frames with a doubtful flag, or saturated, from which the check fails."""

MANY_DROPPED = 0.5
"""Part of the frames without a measured area from which the check fails."""

ZERO_FORCE = 0.01
"""N up to which a force is none: the area of a fingertip under it is some 2 mm²."""

FEWEST_AT_REST = 3
"""Frames at no force below which nothing is said of their areas."""

TARE_NOTE, TARE_LIMIT = 0.01, 0.1
"""N of force on the unloaded plate from which it is noted, and from which it fails. It is taken off
before the fit (`finger_offline.unloaded`)."""

SCATTER_NOTE, SCATTER_LIMIT = 0.10, 0.25
"""Standard deviation of the trials' gain from which it is noted, and from which it fails."""

GAIN_NOTE, GAIN_LIMIT = 0.05, 0.15
"""Logarithm of measured over modelled area, mean of the presses, from which it is noted, and from
which it fails: no parameters inside the search box give such areas."""

RESIDUAL_NOTE, RESIDUAL_LIMIT = 0.10, 0.25
"""RMS difference within a press over the area from which it is noted, and from which it fails."""

COST_NOTE, COST_LIMIT = 1.2, 1.5
"""J over that of the power law from which a fit on bounds is noted, and from which it fails: a
model of the right finger is the better one, or at most 1.14 times worse where presses scatter
(simulated)."""

TREND_NOTE = 0.015
"""Residual over area that depends on the force alike in all presses, and change of the presses'
gain with their duration, from which it is noted: an installed model errs by less."""

INDENTATION_NOTE, INDENTATION_LIMIT = 2.0, 0.07
"""RMS difference of indentation and model, over the stated deviation, from which it is noted; over
the travel of a press, from which it fails then: fingers whose lengths are off by up to two
deviations stay below 0.06 (simulated), a gain of 1.5 or a clock 0.3 s late comes to 0.08 or
more."""

EQUAL_AREAS = 5
"""Frames in a row with exactly the largest area of a press from which areas are cut off there."""

STEP = 0.01
"""s between the samples of the force by which the lag is looked for."""


def quality_of(fit: ConditionFit) -> Quality:
    """Check a fitted condition."""
    problem = fit.problem
    out = Quality()
    costs = problem.trial_costs(fit.areas)
    drives = [_drive(trial, problem.options) for trial in problem.trials]
    curves = problem.model.batch(fit.parameters[None], drives)
    for index, trial in enumerate(problem.trials):
        part = slice(problem.starts[index], problem.starts[index + 1])
        model, weight = fit.areas[part], problem.weight[part]
        flags = _flags(trial)
        out.trials.append(
            TrialQuality(
                trial.label,
                float(costs[index]),
                _lag(trial, drives[index], curves[index][0]),
                trial.rest.force if trial.rest else float("nan"),
                _gain(model, trial.area, weight),
                len(trial.area),
                int(((flags & AreaFlag.SATURATED) != 0).sum()),
                int(((flags & sum(DOUBTFUL)) != 0).sum()),
                int(trial.low.sum()),
            )
        )
    _check_frames(out, problem.trials)
    _check_times(out, problem.trials)
    _check_saturation(out, problem.trials)
    _check_frame_errors(out, fit)
    _check_lag(out)
    _check_tare(out, problem.trials)
    _check_scatter(out)
    _check_lengths(out, fit)
    _check_misfit(out, fit, misfit(fit, np.array([t.gain for t in out.trials])))
    _check_bounds(out, fit)
    _check_indentation(out, fit)
    _check_moisture(out, fit)
    return out


def _flags(trial: FitTrial) -> np.ndarray:
    """Flags (k,) of the frames that count."""
    return np.asarray(trial.record.area_flags, dtype=np.int64)[trial.recording.counted]


def _drive(trial: FitTrial, options: FitOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time and force for the model, the contacts before and the whole press at even steps, and the
    rows of the press."""
    found = trial.recording
    steps = np.arange(0.0, found.time[-1], STEP)
    force = np.maximum(np.interp(steps, found.time, found.force) - trial.drive.tare, 0.0)
    before, forces = found.contacts_before(trial.drive.tare, 0.0, options)
    rows = len(before) + np.arange(len(steps))
    return np.concatenate([before, steps]), np.concatenate([forces, force]), rows


def _gain(model: np.ndarray, area: np.ndarray, weight: np.ndarray) -> float:
    """Measured area over the model's (k,) in m²; NaN of a trial that does not count, without
    weight."""
    square = float((weight * model * model).sum())
    return float((weight * model * area).sum()) / square if square > 0.0 else float("nan")


def _lag(trial: FitTrial, drive: tuple[np.ndarray, ...], curve: np.ndarray) -> float:
    # After the frames that count the force may be more than the model can follow.
    known = np.isfinite(curve)
    time, force = (values[drive[2]][known] for values in drive[:2])
    frames, area = trial.recording.frame_time, np.asarray(trial.record.area, dtype=float)
    area = np.where(frames <= time[-1] + STEP, area, np.nan)
    found = log_lag(time, force, curve[known], frames, area)
    return float("nan") if found is None else found


def _check_frames(out: Quality, trials: Sequence[FitTrial]) -> None:
    frames = sum(t.frames for t in out.trials)
    flags = np.concatenate([_flags(t) for t in trials])
    found = {text: int(((flags & flag) != 0).sum()) for flag, text in DOUBTFUL.items()}
    parts = [f"{number} {text}" for text, number in found.items() if number]
    dropped = sum(t.dropped for t in trials)
    if dropped:
        parts.append(f"{dropped} without a measurable contact, not used")
    worst = max(found["saturated"], found["of low contrast"], found["with few ridges"])
    lost = dropped > MANY_DROPPED * (frames + dropped)
    status = FAIL if lost or worst > MANY_FRAMES * frames else NOTE if parts else OK
    if lost:
        parts.append("look for areas of zero or without a value between the others")
    text = ", ".join(parts) or "none is doubtful"
    out.add("frames", status, f"of {frames + dropped} frames {text}")
    low = sum(t.low for t in out.trials)
    status = NOTE if low > MANY_FRAMES * frames else OK
    out.add(
        "low force",
        status,
        f"{low} of {frames} frames lie below the low force, where an outline underestimates the "
        "area",
    )


def _check_times(out: Quality, trials: Sequence[FitTrial]) -> None:
    doubts = list(dict.fromkeys(d for t in trials for d in getattr(t.record, "doubts", ())))
    out.add("stamps", FAIL if doubts else OK, listed(doubts, 3, "; ") or "in order")


def _check_saturation(out: Quality, trials: Sequence[FitTrial]) -> None:
    """Find forces and areas that stay at their largest value: of a sensor at the end of its range,
    or of a contact that is larger than the image."""
    forces = [
        at for t in trials for at in saturations(t.record.stamp_ns, np.asarray(t.record.force))
    ]
    parts = []
    if forces:
        most = max(forces, key=lambda at: at.samples)
        parts.append(
            f"the force stays at {minus(f'{most.force:.3g}')} N for up to {most.samples} samples "
            f"({len(forces)} of {len(trials)} presses): use a sensor of a larger range, or press "
            "less"
        )
    cut = [t for t in trials if _cut_off(np.asarray(t.record.area, dtype=float))]
    if cut:
        largest = MM2 * max(float(np.nanmax(t.record.area)) for t in cut)
        parts.append(
            f"areas stay at exactly {largest:.1f} mm² ({len(cut)} of {len(trials)} presses), as "
            "where the contact is larger than the image: give NaN for these frames"
        )
    # The presses have one sensor: what is usual in one of them is so in all.
    failing = bool(cut) or not any(at.coarse for at in forces)
    status = FAIL if parts and failing else NOTE if parts else OK
    out.add("saturation", status, "; ".join(parts) or "no force or area stays at its largest value")


def _cut_off(area: np.ndarray) -> bool:
    """Whether areas (n,) of a press are cut off at the largest. Not those of few levels, such as
    counts of large pixels, which are often equal."""
    area = area[np.isfinite(area) & (area > 0.0)]
    if not len(area):
        return False
    largest = area == area.max()
    others = area[~largest]
    return longest_run(largest) >= EQUAL_AREAS and len(np.unique(others)) > 0.5 * len(others)


def _check_frame_errors(out: Quality, fit: ConditionFit) -> None:
    """Say whether neighbouring frames err alike, so that they tell less than independent ones."""
    found = fit.covariance.frames if fit.covariance is not None else None
    if found is None:
        return
    if not found.alike:
        out.add("errors of the frames", OK, "independent from frame to frame")
        return
    out.add(
        "errors of the frames",
        NOTE,
        f"alike from frame to frame: {100 * found.share:.0f} % of their variance lasts for about "
        f"{found.time:.2g} s, so that the frames tell less than as many independent ones; the "
        "intervals allow for it",
    )


def _check_lag(out: Quality) -> None:
    lags = np.array([t.lag for t in out.trials])
    lags = lags[np.isfinite(lags)]
    if not len(lags):
        out.add("lag of the areas", NOTE, "unknown: too few areas over a changing force")
        return
    middle = float(np.median(lags))
    size = abs(middle)
    status = FAIL if size > MAXIMUM_LAG else NOTE if size > WORTH_A_NOTE else OK
    milliseconds = minus(str(round(1e3 * middle)))
    text = f"{milliseconds} ms behind the fitted model (median of {len(lags)} presses)"
    if status == FAIL:
        text += "; correct the clocks, image_time_offset or --time-offset"
    out.add("lag of the areas", status, text)


def _check_tare(out: Quality, trials: Sequence[FitTrial]) -> None:
    tares = np.array([t.tare for t in out.trials])
    tares = tares[np.isfinite(tares)]
    touched = _touched_at_rest(trials)
    if not len(tares):
        text = "unknown: no press shows the unloaded plate"
        out.add("tare", NOTE, "; ".join(filter(None, [text, touched])))
        return
    worst = float(tares[np.argmax(np.abs(tares))])
    status = FAIL if abs(worst) > TARE_LIMIT else NOTE if abs(worst) > TARE_NOTE else OK
    text = (
        f"force without contact {np.median(tares):+.3f} N (median), at most {worst:+.3f} N; it is "
        "taken off"
    )
    status = NOTE if touched and status == OK else status
    out.add("tare", status, minus("; ".join(filter(None, [text, touched]))))


def _touched_at_rest(trials: Sequence[FitTrial]) -> str:
    """Say that areas were measured without a force; empty where they were not."""
    found = []
    for trial in trials:
        recording, area = trial.recording, np.asarray(trial.record.area, dtype=float)
        force = np.interp(recording.frame_time, recording.time, recording.smooth)
        force -= trial.rest.force if trial.rest else 0.0
        found.append(area[(force <= ZERO_FORCE) & np.isfinite(area)])
    areas = np.concatenate(found)
    touched = areas[areas > 0.0]
    # A few frames that come late are none of it.
    if len(areas) < FEWEST_AT_REST or len(touched) <= 0.5 * len(areas):
        return ""
    return (
        f"{len(touched)} of {len(areas)} frames where the force is zero show a contact, of "
        f"{MM2 * float(np.median(touched)):.1f} mm² (median): the areas have an offset, or the "
        "force another zero; correct what is wrong"
    )


def _check_scatter(out: Quality) -> None:
    gains = np.array([t.gain for t in out.trials])
    gains = gains[np.isfinite(gains)]
    spread = float(np.std(np.log(gains), ddof=1)) if len(gains) > 1 else 0.0
    status = FAIL if spread > SCATTER_LIMIT else NOTE if spread > SCATTER_NOTE else OK
    out.add(
        "scatter between presses",
        status,
        f"areas of whole presses differ from the model by {100 * spread:.1f} % (SD of the gain)",
    )


def _check_lengths(out: Quality, fit: ConditionFit) -> None:
    """Check that somebody gave the lengths of the finger."""
    geometry, known = getattr(fit.problem.model, "geometry", None), fit.problem.known
    if geometry is None:
        return  # a model that is no finger
    width, depth = 2e3 * geometry.pad_semi_axis_radial, 2e3 * geometry.pad_semi_axis_axial
    size = f"{width:.3g} mm wide and {depth:.3g} mm deep"
    if known.source:
        out.add("lengths of the finger", OK, f"{size}, given by {known.source}")
        return
    out.add(
        "lengths of the finger",
        NOTE,
        f"not given: a finger {size} is assumed, which nobody measured; measure width and depth "
        "with calipers ('finger-model geometry') and give the lengths with --geometry",
    )


def _check_bounds(out: Quality, fit: ConditionFit) -> None:
    """Say where the search box holds estimates back, so that intervals end there."""
    known = fit.covariance
    if known is None:
        return
    if not known.active:
        out.add("search box", OK, "no parameter lies on a bound")
        return
    headline = fit.space.describe(fit.space.headline)
    names = [f"{fit.space[name].symbol} ({end})" for name, end in known.active.items()]
    held = known.holds(headline.name)
    text = f"{', '.join(names)} on a bound" + (f", and so {headline.symbol}" if held else "")
    text += ": an interval ends at the box, so that it may miss the true value"
    remedy = "give other --bounds where the tissue may lie beyond"
    if not fit.problem.known.source and getattr(fit.problem.model, "geometry", None) is not None:
        remedy = "a finger of another size ends on bounds too: give its lengths with --geometry"
    out.add("search box", NOTE, f"{text}; {remedy}")


def _check_misfit(out: Quality, fit: ConditionFit, found: Misfit) -> None:
    """Check that the model gives areas like these at all, and follows them within a press."""
    gain, status = float(np.log(found.gain)), OK
    words: list[str] = []
    remedy = ""
    if abs(gain) > GAIN_NOTE or found.residual > RESIDUAL_NOTE:
        bad = abs(gain) > GAIN_LIMIT or found.residual > RESIDUAL_LIMIT
        status = FAIL if bad else NOTE
        remedy = "check the units of force and area, the geometry and the bounds"
        if len(found.outliers) and abs(gain) <= GAIN_NOTE:
            words.append(_outlying(fit, found.outliers))
            remedy = "look at the images of these frames"
            if fit.problem.options.loss != "huber":
                remedy += ", and fit with --loss huber, which they hardly move"
    bounds = active_bounds(fit.space, fit.parameters, fit.problem.box)
    if bounds and fit.cost > COST_NOTE * fit.power_law.cost:
        bad = status == FAIL or fit.cost > COST_LIMIT * fit.power_law.cost
        status = FAIL if bad else NOTE
        words.append(_behind(fit, bounds))
        if getattr(fit.problem.model, "geometry", None) == Geometry():
            remedy = (
                "give the finger's lengths with --geometry, and check the units of force and area"
            )
    trend = found.trend
    if trend is not None and trend.size > TREND_NOTE:
        worst = int(np.argmax(np.abs(trend.residual)))
        low, high = trend.force[worst]
        words.append(
            f"they depend on the force, by {100 * trend.residual[worst]:+.1f} % between {low:.2g} "
            f"and {high:.2g} N" + ("" if trend.loading[worst] else " of the release")
        )
    if abs(found.duration) > TREND_NOTE:
        words.append(
            f"slow presses have {100 * np.expm1(found.duration):+.1f} % of area against fast ones"
        )
    if words and status == OK:
        status = NOTE
        words.append("the tissue may follow another law, which no interval allows for")
    middle = f"{100 * np.expm1(gain):+.1f} % from the model on average"
    text = f"areas differ by {middle}, by {100 * found.residual:.1f} % within a press (RMS)"
    words = [minus("; ".join([text, *words])), *filter(None, [remedy])]
    out.add("model against areas", status, "; ".join(words))


def _outlying(fit: ConditionFit, frames: np.ndarray) -> str:
    """Name the frames, worst first, that lie far from the others."""
    problem = fit.problem
    names = []
    for frame in frames:
        index = problem.trial_of[frame]
        trial = problem.trials[index]
        row = trial.recording.counted[frame - problem.starts[index]]
        area, model = MM2 * problem.measured[frame], MM2 * fit.areas[frame]
        names.append(
            f"{trial.label} at {trial.recording.frame_time[row]:.2f} s ({three_digits(area)} mm² "
            f"where the model has {three_digits(model)} mm²)"
        )
    return f"most of it is of {len(names)} frame{'s' * (len(names) > 1)}: {listed(names, 3)}"


def _behind(fit: ConditionFit, bounds: Iterable[str]) -> str:
    """Say that the model stays behind the power law, with these parameters on bounds."""
    own, law = (three_digits(MM4 * cost) for cost in (fit.cost, fit.power_law.cost))
    names = ", ".join(fit.space[name].symbol for name in bounds)
    return (
        f"J is {own} mm⁴ against {law} mm⁴ of the power law, with {names} on bounds: the model is "
        "far from these areas"
    )


def _check_indentation(out: Quality, fit: ConditionFit) -> None:
    """Check the indentation, where one was measured and is to be used."""
    records = [trial.record for trial in fit.problem.trials]
    given = [r for r in records if len(getattr(r, "indentation", ()))]
    if not given or not fit.problem.options.indentation_sd:
        return
    found = fit.indentation
    if found is None:
        out.add("indentation", NOTE, "no press has readings at three frames or more; not used")
        return
    rms, sd = found.rms, found.sd
    beyond = rms > INDENTATION_NOTE * sd
    status = NOTE if beyond or len(found.zeros) < len(records) else OK
    status = FAIL if beyond and rms > INDENTATION_LIMIT * found.travel else status
    parts = [
        f"{len(found.zeros)} of {len(records)} presses are used; they differ from the model by "
        f"{1e6 * rms:.0f} µm (RMS), {100 * rms / found.travel:.0f} % of the travel, weighed with "
        f"{1e6 * sd:.0f} µm"
    ]
    if beyond:
        parts.append("correct unit, clock and lengths of the finger, or state --indentation-sd")
    doubts = [f"{label_of(r)}: {fault.text}" for r in given if (fault := fault_of(r)) is not None]
    out.add(
        "indentation",
        NOTE if doubts and status == OK else status,
        "; ".join([*parts, *([listed(doubts, 3, "; ")] if doubts else [])]),
    )


def _check_moisture(out: Quality, fit: ConditionFit) -> None:
    without = sum(not np.isfinite(t.moisture) for t in fit.problem.trials)
    number = len(fit.problem)
    text = f"{number - without} of {number} presses have readings"
    read = [t for t in fit.problem.trials if np.isfinite(t.moisture)]
    moisture = np.array([t.moisture for t in read])
    labels = moisture_clusters(moisture, 2)
    if labels.any():
        parts = []
        for k in (0, 1):
            names = listed(t.label for t, label in zip(read, labels) if label == k)
            parts.append(f"{moisture[labels == k].mean():.0f} a.u. ({names})")
        text += f", of two kinds of skin: {' and '.join(parts)}; give each its own condition"
    out.add("moisture", NOTE if without or labels.any() else OK, text)
