# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How well the data determine the parameters, as HTML."""

from __future__ import annotations

import itertools
import math
from html import escape

import numpy as np

from ..report_units import MM2, minus
from ..results import ConditionFit, FitResult
from .markup import headings, listing, span, table


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
        "strongest correlations, all free",
        f"SD of ln {headline.html} (%)",
        "noise of a frame (mm²)",
    ]
    return (
        table(header, rows, (1, 2))
        + "<p class=lead>Correlations, all free: which parameters these data trade against each "
        "other. No parameter is held at a bound, and the assumed lengths and gain may change with "
        "them, within their priors. The table of covariances below answers another question.</p>"
        + listing(notes)
    )


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
                known = f"{100 * deviation[i]:.1f} %" if deviation[i] > 0 else "–"
                cells.append(known if i == j else minus(text))
            rows.append([escape(condition) if not i else "", space[name].html, *cells])
    header = ["condition", "", *(space[n].html for n in space.names)]
    return table(header, rows, (1,)) + (
        "<p class=lead>Covariance of the logarithms of these estimates "
        "(<code>covariance_log</code> in fit.json): standard deviations on the diagonal, "
        "correlations below it. It says how far the estimates of this fit err together: a "
        "parameter on a bound is held there and has no entry, and the errors of the assumed "
        "lengths and gain are included, so that correlations differ from those above. Without "
        "nuisance parameters it is that of the bootstrap, where there is one.</p>"
    )


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
            cells.append("–" if math.isnan(ends[0]) else span(space, name, ends))
        rows.append(cells)
    return f"<p>Bootstrap over trials, {samples} samples, 95 % (percentiles):</p>" + table(
        ["condition", *headings(space, space.quantity_names)], rows
    )
