# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The search for the parameters and its best candidates, as HTML."""

from __future__ import annotations

from html import escape

from ..report_units import three_digits
from ..results import FitResult
from .markup import area_cost, headings, listing, show, table


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
