# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What was fitted to: checks of the data, trials, and what was excluded, as HTML."""

from __future__ import annotations

from html import escape

import numpy as np

from ..problem import by_reason
from ..report_units import minus, three_digits
from ..results import FitResult
from ..results.tables import trial_rows
from .markup import LONG_TABLE, listing, table


def quality(result: FitResult) -> str:
    """What the checks found in the data: failures and notes in words, the rest in a table."""
    checked = {n: f.quality for n, f in result.fits.items() if f.quality is not None}
    conditions = {*result.fits, *result.missing}
    words = {"fail": "<b class=bad>fails</b>", "note": "note", "ok": "<span class=final>ok</span>"}
    why = "interrupted" if result.stopped else "lost"
    rows = [
        ["fit", words["note"], f"{escape(name)}: {why}, not checked"] for name in result.unfinished
    ]
    for name in dict.fromkeys(c.name for q in checked.values() for c in q.checks):
        # Not all conditions have all checks, such as that of an indentation.
        of_name = {n: c for n, q in checked.items() for c in q.checks if c.name == name}
        worst = min(of_name.values(), key=lambda c: ["fail", "note", "ok"].index(c.status)).status
        details: dict[str, list[str]] = {}
        for condition, check in of_name.items():
            if check.status == worst or len(of_name) <= LONG_TABLE // 3:
                details.setdefault(check.detail, []).append(condition)
        several = len(details) > 1 or len(conditions) > len(next(iter(details.values())))
        text = "<br>".join(
            (f"{escape(', '.join(names))}: " if several else "") + escape(detail)
            for detail, names in list(details.items())[:LONG_TABLE]
        )
        rows.append([escape(name), words[worst], text])
    return table(["check", "", "found"], rows, (1, 2)) if rows else ""


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
        [escape(", ".join(labels)), escape(condition or "–"), escape(reason)]
        for (condition, reason), labels in by_reason(result.exclusions).items()
    ]
    text += f"<p>{number} trial{'s' if number != 1 else ''} excluded:</p>"
    return text + table(["trials", "condition", "reason"], rows, (1, 2))


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
        "<p class=lead>Loading: time from first touch to the largest force. <i>J</i>: the "
        "trial's part of the cost. Lag: of the areas behind the fitted model. Tare: force before "
        "the contact. Gain: measured area over the model's.</p>"
    )


def _number(value: float, form: tuple[float, str] | None) -> str:
    """A value by its factor and format, or with three digits; a dash for NaN."""
    if form is None or not np.isfinite(value):
        return minus(three_digits(value))
    return minus(f"{form[0] * value:{form[1]}}")
