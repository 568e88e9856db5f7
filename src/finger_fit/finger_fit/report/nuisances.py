# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit allowed for beside the finger's parameters, as HTML."""

from __future__ import annotations

from html import escape

from finger_model.geometry import LENGTHS

from ..nuisance.result import NuisanceResult, NuisanceValue
from ..nuisance_names import name_of
from ..report_units import minus
from ..results import AssumedLengths, FitResult
from .markup import listing, table

DISPLAY = {"N": (1e3, "mN", 0), "s": (1e3, "ms", 0), "": (1e2, "%", 1)}
"""Factor, unit and decimals of a nuisance by its SI unit."""


def lengths(result: FitResult) -> str:
    """Lengths of the finger as the fit assumed them, with their deviations."""
    text = ""
    for finger in AssumedLengths.of(result.fits.values()):
        rows = []
        for name, value in finger.geometry.to_dict().items():
            deviation = finger.deviations.get(name)
            known = "–"
            if deviation is not None:
                known = f"± {1e3 * deviation:.2f} mm ({100 * deviation / abs(value):.0f} %)"
            rows.append(
                [escape(LENGTHS[name].partition(";")[0]), minus(f"{1e3 * value:.2f}"), known]
            )
        text += f"<p>Lengths of the finger, {escape(finger.words)}:</p>"
        text += table(["length", "mm", "standard deviation"], rows, (0, 2))
    if text:
        text += (
            "<p class=lead>The fit keeps these lengths; its first intervals allow for their "
            "deviations, as if they were independent. –: not allowed for.</p>"
        )
    return text


def nuisances(result: FitResult) -> str:
    """Shared nuisances, their share of the headline quantity's deviation, and the presses."""
    found = {name: fit.nuisance for name, fit in result.fits.items() if fit.nuisance is not None}
    if not found:
        return ""
    headline = result.space.describe(result.space.headline)
    rows, notes = [], []
    for condition, block in found.items():
        parts = block.budget[headline.name]
        for name, value in block.values.items():
            rows.append(
                [
                    escape(condition),
                    escape(name_of(name)),
                    _with_deviation(value, value.value, value.sd),
                    _with_deviation(value, 0.0, value.prior_sd),
                    "estimated" if value.estimated else "from its prior",
                    f"{100 * parts[name]:.1f}",
                ]
            )
        rows.append([escape(condition), "data", "", "", "", f"{100 * parts['data']:.1f}"])
        notes.append(f"<b>{escape(condition)}</b>: {_sentence(block)}.")
    share = f"part of SD of ln {headline.html} (%)"
    header = ["condition", "nuisance", "estimate", "prior", "known", share]
    return (
        "<p>Nuisance parameters: what rig and finger leave unknown. They are estimated together "
        "with the finger's parameters, or carried into the intervals by their priors. The parts "
        "add up as squares.</p>" + table(header, rows, (0, 1, 4)) + listing(notes)
    )


def _with_deviation(kind: NuisanceValue, value: float, deviation: float) -> str:
    factor, unit, decimals = DISPLAY[kind.unit]
    text = f"{factor * value:.{decimals}f} ± {factor * deviation:.{decimals}f} {unit}"
    return minus(text)


def _sentence(block: NuisanceResult) -> str:
    """Tare, scatter, and what is not known, in words."""
    presses = list(block.presses.values())
    measured = [press.tare for press in presses if press.tare_measured]
    if measured:
        low, high = (round(1e3 * tare) for tare in (min(measured), max(measured)))
        tare = (
            f"tare {low} to {high} mN, measured on the unloaded plate in {len(measured)} of "
            f"{len(presses)} presses and taken off"
        )
    else:
        tare = "no press shows the unloaded plate; the tare is a nuisance"
    text = (
        f"{tare}; the gain of each press may differ from that of the others by "
        f"{100 * block.scatter:.0f} % (SD)"
    )
    if block.not_estimated:
        names = ", ".join(map(name_of, block.not_estimated))
        text += f"; these data do not estimate {names}: the intervals hold the priors"
    if block.left_out:
        names = ", ".join(map(name_of, block.left_out))
        text += f"; not allowed for: {names}"
    return escape(minus(text))
