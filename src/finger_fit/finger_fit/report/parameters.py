# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fitted parameters, their contrasts, and whether they are final, as HTML."""

from __future__ import annotations

import math
from html import escape
from urllib.parse import quote

import numpy as np

from finger_model.laws import ParameterSpace

from ..report_units import CUT_NOTE, three_digits
from ..results import ConditionFit, FitResult, QuantityResult
from .markup import area_cost, headings, listing, show, span, table


def parameters(result: FitResult) -> str:
    """Fitted and bias-corrected quantities with their intervals, and J."""
    space = result.space
    names = space.quantity_names
    header = ["condition", "moisture (a.u.)", *headings(space, names)]
    header += ["<i>J</i> model (mm⁴)", "<i>J</i> power law (mm⁴)", "Δ<i>J</i> (mm⁴)"]
    rows = []
    for condition, fit in result.fits.items():
        mean, deviation = fit.moisture
        active = fit.covariance.active if fit.covariance else {}
        quantities = {name: fit.found(name) for name in names}
        kind = "final" if fit.status == "final" else "bad"
        rows.append(
            [
                f"{escape(condition)}<br><span class='status {kind}'>{escape(fit.status)}</span>",
                f"{mean:.1f} ± {deviation:.1f}" if np.isfinite(mean) else "–",
                *(
                    show(space, name, found.value)
                    + ("<sup>†</sup>" if name in active else "")
                    + _interval(space, name, found)
                    for name, found in quantities.items()
                ),
                area_cost(fit.cost),
                area_cost(fit.power_law.cost),
                area_cost(fit.power_law.cost - fit.cost),
            ]
        )
        if _has_assumed(fit):
            cells = [_from_data(space, name, found) for name, found in quantities.items()]
            rows.append(["<i>from the data alone</i>", "", *cells, "", "", ""])
        if fit.bias_corrected:
            cells = [_corrected(space, name, found) for name, found in quantities.items()]
            rows.append(["<i class=corrected>bias-corrected</i>", "", *cells, "", "", ""])
    note = (
        f"Estimates{_intervals(result)} <sup>†</sup> The estimate lies on a bound of the search "
        "box. <i>J</i>: cost of the fit; Δ<i>J</i>: cost of the power law less that of the model; "
        "above 0, the model fits better."
    )
    if any(_has_assumed(fit) for fit in result.fits.values()):
        note += (
            " These intervals allow for all that is unknown, also the assumed lengths of the "
            "finger and the assumed gain of all areas: use them to compare with other fingers and "
            "rigs. They end at the search box: a condition with † may need values beyond it, and "
            "then they may miss the truth. "
            "<i>From the data alone</i>: the interval if those were exactly as assumed, and the "
            "standard deviation of the logarithm that they add to it (as squares). More presses "
            "narrow the first; only measuring the finger and the plate narrows the second."
        )
    if any(fit.bias_corrected for fit in result.fits.values()):
        note += (
            " <i class=corrected>Bias-corrected</i>: estimate and interval less the bias of the "
            "estimate, which is measured by refits to synthetic data made at the fitted "
            "parameters. Such values may lie slightly outside the box. Use them to compare "
            "fingers; use the estimate, which minimises <i>J</i> inside the box, to simulate."
        )
    return table(header, rows) + f"<p class=lead>{note}</p>"


def _interval(space: ParameterSpace, name: str, found: QuantityResult) -> str:
    if math.isnan(found.interval[0]):
        return ""
    if found.identifiable is False:
        return "<small>not identifiable</small>"
    return f"<small>{span(space, name, found.interval, found.cut)}</small>"


def _intervals(result: FitResult) -> str:
    """How the intervals were found, and what the mark at their ends means."""
    names = result.space.quantity_names
    found = [fit.found(name) for fit in result.fits.values() for name in names]
    profiled = [q.identifiable is not None for q in found if not math.isnan(q.interval[0])]
    if not profiled:
        return "."
    if all(profiled):
        return f" with 95 % intervals by profile likelihood. {CUT_NOTE}"
    source = "from the covariance (no profiles were computed)"
    if any(profiled):
        source = "by profile likelihood and, where there is no profile, from the covariance"
    return f" with 95 % intervals {source}. {CUT_NOTE}"


def _has_assumed(fit: ConditionFit) -> bool:
    """Whether the intervals hold assumed lengths or an assumed gain."""
    return fit.covariance is not None and bool(fit.covariance.assumed.any())


def _from_data(space: ParameterSpace, name: str, found: QuantityResult) -> str:
    """The interval from the data alone, and what the assumptions add."""
    if math.isnan(found.data_interval[0]) or found.identifiable is False:
        return "<i>–</i>"
    assumed = f"assumed: ± {100.0 * found.assumed_sd:.0f} %"
    ends = span(space, name, found.data_interval, found.data_cut)
    return f"<i>{ends}</i><small>{assumed}</small>"


def _corrected(space: ParameterSpace, name: str, found: QuantityResult) -> str:
    """The bias-corrected value and its interval; a dash where it is not identifiable."""
    if found.bias is None or found.identifiable is False:
        return "<i class=corrected>–</i>"
    value = f"<i class=corrected>{show(space, name, found.bias.value)}</i>"
    if found.identifiable is None:
        return value
    return f"{value}<small>{span(space, name, found.corrected_interval, found.cut)}</small>"


def verdict(result: FitResult) -> str:
    """Whether each condition is final, and why not."""
    lines = []
    for name, fit in result.fits.items():
        title, check = f"<b>{escape(name)}</b>", fit.full_order
        if fit.status == "final" and check is not None:
            lines.append(
                f"{title} is final: full order and reduced order differ by "
                f"{100 * check.rms_difference:.2f} % of the largest area (limit "
                f"{100 * check.AREA_LIMIT:g} %), and re-ranking the top candidates by full order "
                f"changes {fit.space.describe(check.headline).html} by {100 * check.change:.1f} %, "
                + (
                    f"where {100 * check.CHANGE_LIMIT:g} % is the limit."
                    if check.change <= check.CHANGE_LIMIT
                    else "a difference that these data cannot show."
                )
            )
        elif fit.status == "final":
            lines.append(f"{title} is final: the fit used the full-order model itself.")
        elif fit.status == "not checked":
            lines.append(f"{title} was not checked against the full-order model.")
        else:
            reasons = "; ".join(map(escape, fit.reasons))
            lines.append(f"{title} is <span class=bad>{fit.status}</span>: {reasons}.")
    return listing(lines)


def contrast_table(result: FitResult) -> str:
    """Differences between the conditions of a subject, with what they say in words."""
    if not result.contrasts:
        return ""
    space = result.space
    several = len({c.subject for c in result.contrasts}) > 1
    rows = []
    for c in result.contrasts:
        if several and c.quantity != space.headline:
            continue
        low, high = (show(space, c.quantity, v) for v in c.difference_95)
        spans = (
            f"<small>{' – '.join(map(three_digits, c.ratio_95))}</small>",
            f"<small>{low} to {high}</small>",
        )
        words, chance = (
            "differ" if c.separated else "<i>not separated</i>",
            _chance(c.probability_greater),
        )
        if c.on_bound:
            # What the box holds back has no spread: neither interval nor probability means much.
            spans, words, chance = ("", ""), "<i>at a bound</i>", "–"
        rows.append(
            [
                *([escape(c.subject)] if several else []),
                f"{escape(c.first)} – {escape(c.second)}",
                *headings(space, [c.quantity]),
                "–" if math.isnan(c.ratio) else f"{three_digits(c.ratio)}{spans[0]}",
                f"{show(space, c.quantity, c.difference)}{spans[1]}",
                chance,
                words,
            ]
        )
    header = ["conditions", "quantity", "ratio", "difference", "P(first greater)", "95 %"]
    source = ", ".join(sorted({c.source for c in result.contrasts}))
    return (
        "<h2>Contrasts</h2>"
        + table(["subject", *header] if several else header, rows, (0, 1))
        + f"<p class=lead>First condition over and less the second, with 95 % intervals ({source}; "
        "the assumed lengths and gain are the same in both, their other errors independent). Not "
        "separated: the interval of the difference holds 0, so these data do not tell the two "
        "apart. At a bound: an estimate lies on a bound of the search box, so these data do not "
        "compare the two."
        "</p>"
    )


def _chance(probability: float) -> str:
    """A probability of many draws, which never show one that is 0 or 1."""
    if probability < 0.001:
        return "&lt; 0.001"
    return "&gt; 0.999" if probability > 0.999 else f"{probability:.3f}"


def subjects(result: FitResult) -> str:
    """Parameters of every subject and condition, with a link to the subject's own report."""
    space = result.space
    names = space.quantity_names
    header = ["subject", "condition", "presses", *headings(space, names), "<i>J</i> (mm⁴)"]
    rows = []
    for subject, part in result.subjects.items():
        for condition, fit in part.fits.items():
            kind = "final" if fit.status == "final" else "bad"
            rows.append(
                [
                    f"<a href='{quote(subject)}/report.html'>{escape(subject)}</a>",
                    f"{escape(condition)}<br><span class='status {kind}'>"
                    f"{escape(fit.status)}</span>",
                    str(len(fit.problem)),
                    *(
                        show(space, name, found.value) + _interval(space, name, found)
                        for name in names
                        for found in [fit.found(name)]
                    ),
                    area_cost(fit.cost),
                ]
            )
    return table(header, rows, (1,)) + (
        f"<p class=lead>Each subject is fitted alone; estimates{_intervals(result)}.</p>"
    )
