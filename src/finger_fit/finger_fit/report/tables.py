# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables and sentences of the report, as HTML."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from html import escape
from urllib.parse import quote

import numpy as np

from finger_model.laws import ParameterSpace

from ..report_units import MM2, MM4, minus, three_digits
from ..results import ConditionFit, FitResult, QuantityResult
from ..results.tables import goodness_rows, trial_rows

PAPER_TIME = "2 min a trial, 27,000 min (19 days) in COMSOL"
"""Time of the paper's search (Nam and Kuchenbecker 2021)."""

LONG_TABLE = 12
"""Rows beyond which a table may go on on the next page of a print."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = ()) -> str:
    """A table of HTML cells; `text` gives the columns that are aligned to the left."""

    def cells(kind: str, row: Sequence[str]) -> str:
        # A heading without a word is none, for those who hear the page.
        tags = [kind if cell else "td" for cell in row]
        return "".join(
            f"<{tag}{' class=text' if k in text else ''}>{cell}</{tag}>"
            for k, (tag, cell) in enumerate(zip(tags, row))
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    kind = " class=long" if len(rows) > LONG_TABLE else ""
    # Focusable, so that a keyboard can scroll it where the window is narrow.
    return (
        f"<div class=scroll tabindex=0><table{kind}><thead><tr>{cells('th', header)}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
    )


def listing(items: Sequence[str]) -> str:
    """A list of HTML items; nothing without any."""
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>" if items else ""


def headings(space: ParameterSpace, names: Sequence[str]) -> list[str]:
    """Symbols and units of quantities."""
    quantities = [space.describe(name) for name in names]
    return [f"{q.html} ({q.display_unit})" if q.display_unit else q.html for q in quantities]


def show(space: ParameterSpace, name: str, value: float) -> str:
    """A value (SI) in the quantity's display unit."""
    return minus(space.describe(name).text(value))


def area_cost(cost: float) -> str:
    """J (m⁴) in mm⁴."""
    return minus(three_digits(cost * MM4))


def with_interval(value: float, low: float, high: float, decimals: int) -> str:
    """A value, and its 95 % interval below it where there is one."""
    text = f"{value:.{decimals}f}"
    if not np.isfinite(low):
        return text
    return f"{text}<small>{low:.{decimals}f} – {high:.{decimals}f}</small>"


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
        "Estimates with 95 % intervals by profile likelihood. <sup>†</sup> The estimate lies on a "
        "bound of the search box. ≤: the interval extends to the bound. <i>J</i>: cost of the fit; "
        "Δ<i>J</i>: cost of the power law less that of the model; above 0, the model fits better."
    )
    if any(_has_assumed(fit) for fit in result.fits.values()):
        note += (
            " These intervals hold all that is unknown, also the assumed lengths of the finger and "
            "the assumed gain of all areas: use them to compare with other fingers and rigs. "
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


def _span(space: ParameterSpace, name: str, ends: tuple[float, float]) -> str:
    return " – ".join(show(space, name, end) for end in ends)


def _interval(space: ParameterSpace, name: str, found: QuantityResult) -> str:
    if math.isnan(found.interval[0]):
        return ""
    if found.identifiable is None:
        return f"<small>{_span(space, name, found.interval)}</small>"
    if not found.identifiable:
        return "<small>not identifiable</small>"
    before, after = "≤ " * found.low_is_bound, " ≤" * found.high_is_bound
    return f"<small>{before}{_span(space, name, found.interval)}{after}</small>"


def _has_assumed(fit: ConditionFit) -> bool:
    """Whether the intervals hold assumed lengths or an assumed gain."""
    return fit.covariance is not None and bool(fit.covariance.assumed.any())


def _from_data(space: ParameterSpace, name: str, found: QuantityResult) -> str:
    """The interval from the data alone, and what the assumptions add."""
    if math.isnan(found.data_interval[0]) or found.identifiable is False:
        return "<i>–</i>"
    assumed = f"assumed: ± {100.0 * found.assumed_sd:.0f} %"
    return f"<i>{_span(space, name, found.data_interval)}</i><small>{assumed}</small>"


def _corrected(space: ParameterSpace, name: str, found: QuantityResult) -> str:
    """The bias-corrected value and its interval; a dash where it is not identifiable."""
    if found.bias is None or found.identifiable is False:
        return "<i class=corrected>–</i>"
    value = f"<i class=corrected>{show(space, name, found.bias.value)}</i>"
    if found.identifiable is None:
        return value
    return f"{value}<small>{_span(space, name, found.corrected_interval)}</small>"


def quality(result: FitResult) -> str:
    """What the checks found in the data: failures and notes in words, the rest in a table."""
    checked = {n: f.quality for n, f in result.fits.items() if f.quality is not None}
    if not checked:
        return ""
    words = {"fail": "<b class=bad>fails</b>", "note": "note", "ok": "<span class=final>ok</span>"}
    rows = []
    for name in dict.fromkeys(c.name for q in checked.values() for c in q.checks):
        # Not all conditions have all checks, such as that of an indentation.
        of_name = {n: c for n, q in checked.items() for c in q.checks if c.name == name}
        worst = min(of_name.values(), key=lambda c: ["fail", "note", "ok"].index(c.status)).status
        details: dict[str, list[str]] = {}
        for condition, check in of_name.items():
            if check.status == worst or len(of_name) <= LONG_TABLE // 3:
                details.setdefault(check.detail, []).append(condition)
        several = len(details) > 1 or len(of_name) > len(next(iter(details.values())))
        text = "<br>".join(
            (f"{escape(', '.join(names))}: " if several else "") + escape(detail)
            for detail, names in list(details.items())[:LONG_TABLE]
        )
        rows.append([escape(name), words[worst], text])
    return table(["check", "", "found"], rows, (1, 2))


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
        "<p class=lead>Each subject is fitted alone; estimates with 95 % intervals by profile "
        "likelihood.</p>"
    )


def covariances(result: FitResult) -> str:
    """Standard deviations and correlations of the logarithms of the parameters."""
    space = result.space
    rows = []
    for condition, fit in result.fits.items():
        matrix = fit.covariance_log()
        deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
        for i, name in enumerate(space.names):
            cells = []
            for j in range(len(space)):
                scale = deviation[i] * deviation[j]
                text = f"{matrix[i, j] / scale:.2f}" if j < i and scale > 0 else ""
                cells.append(f"{100 * deviation[i]:.1f} %" if i == j else minus(text))
            rows.append([escape(condition) if not i else "", space[name].html, *cells])
    header = ["condition", "", *(space[n].html for n in space.names)]
    return table(header, rows, (1,)) + (
        "<p class=lead>Covariance of the logarithms: standard deviations on the diagonal, "
        "correlations below it; without nuisance parameters that of the bootstrap, where there is "
        "one. A parameter on a bound has none.</p>"
    )


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


def exclusions(result: FitResult) -> str:
    """Notes, frames without an area, and excluded trials."""
    text = listing([f"{escape(note)}." for note in result.problems])
    dropped = sum(t.dropped for fit in result.fits.values() for t in fit.problem.trials)
    if dropped:
        text += f"<p>{dropped} frames inside the window had no measurable contact; not used.</p>"
    number = len(result.exclusions)
    if not number:
        return text + "<p>No trial was excluded.</p>"
    rows = [
        [escape(e.label), escape(e.condition or "–"), escape(e.reason)] for e in result.exclusions
    ]
    text += f"<p>{number} trial{'s' if number != 1 else ''} excluded:</p>"
    return text + table(["trial", "condition", "reason"], rows, (1, 2))


def costs(result: FitResult) -> str:
    """J and R² of model and power law, and the power law's constants."""
    decimals = {"k_mm2_per_Nm": 1, "m": 3, "R2": 3, "R2_power_law": 3, "rms_mm2": 2}
    rows = [
        [
            escape(name),
            str(row["trials"]),
            str(row["frames"]),
            *(
                minus(three_digits(row[key]))
                for key in ("J_mm4", "J_full_order_mm4", "J_power_law_mm4")
            ),
            *(
                with_interval(row[key], row[f"{key}_low_95"], row[f"{key}_high_95"], number)
                if key in row
                else "–"
                for key, number in decimals.items()
            ),
        ]
        for name, row in zip(result.fits, goodness_rows(result))
    ]
    header = [
        "condition", "trials", "frames", "<i>J</i> model (mm⁴)", "<i>J</i> full order (mm⁴)",
        "<i>J</i> power law (mm⁴)", "<i>k</i> (mm²/N<sup><i>m</i></sup>)", "<i>m</i>",
        "<i>R</i>² model", "<i>R</i>² power law", "RMS error (mm²)",
    ]  # fmt: skip
    ends = {"loading": "the first frame at or after the target force", "contact": "lift-off"}
    return table(header, rows) + (
        "<p class=lead><i>J</i>: sum over trials of the mean squared area difference over the "
        f"frames from onset to {ends[result.options.window]}. The power law "
        "<i>A</i> = <i>kF</i><sup><i>m</i></sup> minimises the same <i>J</i>. Intervals: 95 %, "
        "percentile bootstrap over trials; <i>R</i>² and RMS error of the model with its "
        "parameters held.</p>"
    )


def indentations(result: FitResult) -> str:
    """Measured indentation beside the model's; nothing where none was used."""
    rows = [
        [
            escape(name),
            f"{len(found.zeros)} of {len(fit.problem)}",
            str(len(found.measured)),
            f"{found.travel * 1e3:.2f}",
            f"{found.rms * 1e6:.0f}",
            f"{found.sd * 1e6:.0f}",
            f"{found.gain:.3f}",
        ]
        for name, fit in result.fits.items()
        if (found := fit.indentation) is not None
    ]
    if not rows:
        return ""
    header = [
        "condition", "trials", "frames", "travel (mm)", "RMS difference (µm)", "weighed with (µm)",
        "gain",
    ]  # fmt: skip
    return table(header, rows) + (
        "<p class=lead>The fit used the measured indentation beside the areas. Its zero is unknown "
        "and was fitted in each trial. Travel: change of the measured indentation in a trial "
        "(median). Weighed with: the stated deviation and the model's own error, as squares. "
        "<i>J</i> is that of the areas alone, except in the search, where the indentation is "
        "included.</p>"
    )


def trials(result: FitResult) -> str:
    """One row per trial."""
    formats = {
        "moisture_au": (1.0, ".1f"), "loading_s": (1.0, ".2f"), "peak_force_n": (1.0, ".2f"),
        "frames": (1, "d"), "largest_area_mm2": (1.0, ".1f"), "J_mm4": None,
        "J_power_law_mm4": None, "lag_s": (1e3, ".0f"), "tare_n": (1.0, ".3f"),
        "gain": (1.0, ".3f"),
    }  # fmt: skip
    rows = [
        [escape(row["trial"]), escape(row["condition"])]
        + [_number(row[key], form) for key, form in formats.items()]
        for row in trial_rows(result)
    ]
    header = [
        "trial", "condition", "moisture (a.u.)", "loading (s)", "peak force (N)", "frames",
        "largest area (mm²)", "<i>J</i> model (mm⁴)", "<i>J</i> power law (mm⁴)", "lag (ms)",
        "tare (N)", "gain",
    ]  # fmt: skip
    return table(header, rows, (1,)) + (
        "<p class=lead>Loading: time from first touch to the last frame that counts. <i>J</i>: the "
        "trial's part of the cost. Lag: of the areas behind the fitted model. Tare: force before "
        "the contact. Gain: measured area over the model's.</p>"
    )


def _number(value: float, form: tuple[float, str] | None) -> str:
    """A value by its factor and format, or with three digits; a dash for NaN."""
    if form is None or not np.isfinite(value):
        return minus(three_digits(value))
    return minus(f"{form[0] * value:{form[1]}}")


def force_modes(result: FitResult) -> str:
    """J and the headline quantity in both modes of the force."""
    if not result.force_modes:
        return ""
    space = result.space
    modes = {"full": "full rate", "paper": "as in the paper"}
    (heading,) = headings(space, [space.headline])
    header = ["condition", *(f"<i>J</i> {text}" for text in modes.values())]
    header += [f"{heading} {text}" for text in modes.values()]
    rows = [
        [
            escape(name),
            *(three_digits(values[mode]["J"]) for mode in modes),
            *(show(space, space.headline, values[mode][space.headline]) for mode in modes),
        ]
        for name, values in result.force_modes.items()
    ]
    return (
        "<p>The model driven by the force at its full rate, and by the force low-passed and "
        "sampled at the frames as in the paper; each refitted:</p>" + table(header, rows)
    )


def identifiability(result: FitResult) -> str:
    """Parameters on bounds, correlations, spread of the headline quantity, noise."""
    space = result.space
    headline = space.describe(space.headline)
    rows, notes = [], []
    for name, fit in result.fits.items():
        if fit.covariance is None:
            continue
        found = fit.covariance
        active = ", ".join(f"{space[n].html} ({end})" for n, end in found.active.items())
        deviation = fit.found(space.headline).sd
        rows.append(
            [
                escape(name),
                active or "none",
                _correlations(fit),
                f"{100 * deviation:.1f}",
                f"{found.noise * MM2:.2f}",
            ]
        )
        unknown = [space.describe(n).html for n, p in fit.profiles.items() if not p.identifiable]
        if unknown:
            notes.append(
                f"<b>{escape(name)}</b>: {', '.join(unknown)} not identifiable from these data; "
                "the value above is poorly constrained."
            )
    if not rows:
        return ""
    header = [
        "condition",
        "on a bound",
        "strongest correlations",
        f"SD of ln {headline.html} (%)",
        "noise of a frame (mm²)",
    ]
    return table(header, rows, (1, 2)) + listing(notes)


def _correlations(fit: ConditionFit) -> str:
    """The two strongest correlations between parameters' estimates."""
    assert fit.covariance is not None
    pairs = [
        (fit.covariance.correlation(a, b), a, b)
        for a, b in itertools.combinations(fit.space.names, 2)
    ]
    strongest = sorted((p for p in pairs if np.isfinite(p[0])), key=lambda p: -abs(p[0]))[:2]
    cells = [f"{fit.space[a].html}, {fit.space[b].html}: {value:.2f}" for value, a, b in strongest]
    return minus("; ".join(cells))


def bootstrap(result: FitResult) -> str:
    """Bootstrap intervals of every quantity."""
    space = result.space
    samples = next((len(f.samples) for f in result.fits.values() if f.samples is not None), 0)
    if not samples:
        return ""
    rows = []
    for condition, fit in result.fits.items():
        cells = [escape(condition)]
        for name in space.quantity_names:
            ends = fit.found(name).bootstrap
            cells.append("–" if math.isnan(ends[0]) else _span(space, name, ends))
        rows.append(cells)
    return f"<p>Bootstrap over trials, {samples} samples, 95 % (percentiles):</p>" + table(
        ["condition", *headings(space, space.quantity_names)], rows
    )


def search(result: FitResult) -> str:
    """How the search was made, and J after each of its stages."""
    options, space = result.options, result.space
    points = len(result.example()[0].grid.costs)
    along = round(points ** (1 / len(space)))
    box = ", ".join(
        f"{q.html} {show(space, q.name, low)}–{show(space, q.name, high)} {q.display_unit}"
        for q, (low, high) in zip(space, options.box(space))
    )
    changed = " (changed from the default)" if options.bounds else ""
    text = (
        f"<p>Brute-force grid of {along}<sup>{len(space)}</sup> = "
        f"{points} points, evenly spaced in the logarithm; particle swarm of "
        f"{options.particles} candidates over {options.rounds} rounds from the best grid points, "
        f"seed {options.seed}. Box: {box}{changed}. "
        + (
            "Bounded local least squares follow; their share is listed separately.</p>"
            if options.polish
            else "No local polish.</p>"
        )
    )
    rows = []
    for name, fit in result.fits.items():
        checks = "; ".join(
            f"{c.name}: {area_cost(c.cost)} → {area_cost(c.polished_cost)}, "
            + ("agrees" if c.agrees else "<b>disagrees</b>")
            for c in fit.cross_checks
        )
        rows.append(
            [
                escape(name),
                area_cost(fit.grid.best[1]),
                area_cost(fit.pso.best[1]),
                str(fit.pso.costs.size),
                area_cost(fit.polish.cost) if fit.polish else "–",
                str(fit.polish.evaluations) if fit.polish else "–",
                checks or "–",
            ]
        )
    header = [
        "condition", "<i>J</i> grid", "<i>J</i> PSO", "PSO candidates", "<i>J</i> polished",
        "polish candidates", "cross-checks (<i>J</i> before → after polish)",
    ]  # fmt: skip
    return text + table(header, rows, (6,))


def _chance(probability: float) -> str:
    """A probability of many draws, which never show one that is 0 or 1."""
    if probability < 0.001:
        return "&lt; 0.001"
    return "&gt; 0.999" if probability > 0.999 else f"{probability:.3f}"


def candidates(result: FitResult) -> str:
    """The correction to full order, and the top candidates by both models."""
    space = result.space
    quantity = space.describe(space.headline)
    rows, changed = [], []
    for name, fit in result.fits.items():
        full = fit.full_order
        for k, (vector, cost) in enumerate(zip(fit.top, fit.top_costs)):
            values = space.quantities(vector)
            rows.append(
                [
                    f"{escape(name)} {k + 1}",
                    *(show(space, n, value) for n, value in values.items()),
                    area_cost(cost),
                    area_cost(cost - fit.top_costs[0]),
                    area_cost(full.full_costs[k]) if full else "–",
                    area_cost(full.full_costs[k] - full.full_costs[0]) if full else "–",
                ]
            )
        if fit.correction is not None:
            before = float(space.quantity(quantity.name, fit.correction.parameters_before))
            changed.append(
                f"<b>{escape(name)}</b>: {quantity.html} {quantity.text(before)} → "
                f"{quantity.text(fit.quantity(quantity.name))} {quantity.display_unit}, areas "
                f"changed by at most {100 * fit.correction.largest_factor:.1f} %, "
                f"{fit.correction.rounds} rounds."
            )
    text = ""
    if changed:
        text = (
            "<p>After the search, the reduced model's areas were corrected to full order around "
            "the best candidate, frame by frame, and the fit was polished again:</p>"
        ) + listing(changed)
    header = ["candidate", *headings(space, space.quantity_names)]
    header += ["<i>J</i> reduced", "Δ<i>J</i>", "<i>J</i> full order", "Δ<i>J</i>"]
    text += "<p>Top distinct candidates, by both models:</p>" + table(header, rows)
    if any(fit.nuisance is not None for fit in result.fits.values()):
        text += (
            "<p class=lead><i>J</i> of the candidates is what the fit minimised: with the best "
            "nuisance parameters for each, among them a gain of each press. It is less than "
            "<i>J</i> of the parameters above, which has no such gains.</p>"
        )
    return text


def additional_fits(result: FitResult) -> str:
    """Joint fit and epidermis thickness, where they were asked for."""
    space = result.space
    names = headings(space, space.names)
    text = ""
    if result.shared:
        shared = result.shared
        rows = [
            [escape(name), *(show(space, n, v[n]) for n in space.names), three_digits(v["J"])]
            for name, v in shared["conditions"].items()
        ]
        common = ", ".join(space[n].html for n in shared["parameters"])
        text += (
            f"<p>Joint fit with {common} shared by all conditions: <i>J</i> = "
            f"{three_digits(shared['J'])} mm⁴; separate fits "
            f"{three_digits(shared['J_separate'])} mm⁴.</p>"
        ) + table(["condition", *names, "<i>J</i> (mm⁴)"], rows)
    if result.thickness:
        rows = [
            [
                escape(name),
                f"{v['epidermis_thickness'] * 1e3:.3f}",
                f"{v['sd_log'] * 100:.0f}",
                *(show(space, n, v[n]) for n in space.names),
                three_digits(v["J"]),
            ]
            for name, v in result.thickness.items()
        ]
        text += (
            "<p>Epidermis thickness as an additional parameter (full-order ratios of area at three "
            "thicknesses):</p>"
        ) + table(
            ["condition", "thickness (mm)", "SD of its ln (%)", *names, "<i>J</i> (mm⁴)"], rows
        )
    return "<h2>Additional fits</h2>" + text if text else ""


def provenance(result: FitResult) -> str:
    """Software, models, options, time and bags."""
    sources, options = result.sources, result.options
    default = type(options)().to_dict()
    changed = [f"{k} = {v}" for k, v in options.to_dict().items() if v != default[k]]
    seconds = ", ".join(f"{stage} {spent:.1f} s" for stage, spent in result.seconds.items())
    libraries = [f"{name} {v}" for name, v in sources.get("libraries", {}).items() if v]
    rows = [
        ["command", _code(sources.get("command") or "–")],
        ["software", escape(str(sources.get("software_version", "–")))],
        ["Python, libraries", escape(", ".join([str(sources.get("python", "–")), *libraries]))],
        ["machine", escape(str(sources.get("platform", "–")))],
        ["date (UTC)", escape(f"{sources.get('date', '–')} {sources.get('time_utc', '')}")],
        ["seed", str(options.seed)],
        ["material law", escape(str(sources.get("law", "–")))],
        ["geometry", _code(sources.get("geometry_hash", "–"))],
        ["reduced model", _code(sources.get("reduced_model_hash", "–"))],
        [
            "measured error of the reduced model",
            model_error(dict(sources.get("reduced_model_error", {}))),
        ],
        ["search box", escape(", ".join(options.bounds)) or "default of the law"],
        ["time", escape(f"{seconds} (the paper: {PAPER_TIME})")],
        ["options other than default", escape(", ".join(changed) or "none")],
    ]
    text = table(["item", "value"], rows, (1,))
    bags = [
        [escape(b["bag"]), str(b["trials"]), escape(", ".join(b["areas"])), escape(b["force"]),
         _code(b["sha256"][:16])]
        for b in sources.get("bags", [])
    ]  # fmt: skip
    if bags:
        header = ["bag", "trials", "areas", "force", "SHA-256, first 16 digits"]
        text += table(header, bags, (2, 3, 4))
    return text


def _code(text: object) -> str:
    return f"<code>{escape(str(text))}</code>"


def model_error(error: dict[str, float]) -> str:
    """The reduced model's error against full order, as its file records it."""
    if not {"pairs", "rms_p99", "worst_p99"} <= set(error):
        return "–"
    return (
        f"area {100 * error['rms_p99']:.2f} % RMS and {100 * error['worst_p99']:.2f} % at the "
        "worst instant, in % of a history's largest area, at the 99th percentile of "
        f"{error['pairs']:g} histories held out from its training"
    )
