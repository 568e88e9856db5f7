# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How well model and power law fit, as HTML."""

from __future__ import annotations

from html import escape

import numpy as np

from ..report_units import minus, three_digits
from ..results import FitResult
from ..results.tables import goodness_rows
from .markup import headings, show, table


def with_interval(value: float, low: float, high: float, decimals: int) -> str:
    """A value, and its 95 % interval below it where there is one."""
    text = f"{value:.{decimals}f}"
    if not np.isfinite(low):
        return text
    return f"{text}<small>{low:.{decimals}f} – {high:.{decimals}f}</small>"


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
