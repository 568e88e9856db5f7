# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables of a fit as files: CSV for programs, LaTeX (booktabs) for a paper.

`parameters`, `goodness` and `contrasts` come in both forms; `trials`, `frames` and `indentation`,
which are long, as CSV only. Units stand in the headings.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.files import atomic_write

from ..report_units import MM, MM2, MM4, three_digits
from .contrasts import Contrast
from .fits import ConditionFit, FitResult, codes_of

Rows = list[dict[str, Any]]


def write_tables(result: FitResult, folder: Path) -> None:
    """Write tables/*.csv and *.tex into the folder."""
    for name, rows in (
        ("parameters", parameter_rows(result)),
        ("goodness", goodness_rows(result)),
        ("contrasts", contrast_rows(result, result.contrasts)),
        ("trials", trial_rows(result)),
        ("frames", list(frame_rows(result))),
        ("indentation", list(indentation_rows(result))),
    ):
        if not rows:
            for suffix in ("csv", "tex"):  # of an earlier fit in this folder
                (folder / "tables" / f"{name}.{suffix}").unlink(missing_ok=True)
            continue
        with atomic_write(folder / "tables" / f"{name}.csv") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows({k: _cell(v) for k, v in row.items()} for row in rows)
        if name in ("parameters", "goodness", "contrasts"):
            with atomic_write(folder / "tables" / f"{name}.tex") as file:
                file.write(latex(rows))


def parameter_rows(result: FitResult) -> Rows:
    """One row per condition and quantity: value, standard deviation of its logarithm, intervals.

    low_95, high_95: with all that is unknown; data_…: from the data alone.
    """
    rows = []
    for subject, condition, fit in named(result):
        for name in fit.space.quantity_names:
            quantity = fit.space.describe(name)
            factor, found = quantity.display_factor, fit.found(name)
            rows.append(
                {
                    "subject": subject,
                    "condition": condition,
                    "quantity": name,
                    "unit": quantity.display_unit,
                    "value": factor * found.value,
                    "low_95": factor * found.interval[0],
                    "high_95": factor * found.interval[1],
                    "identifiable": "" if found.identifiable is None else found.identifiable,
                    "sd_log": found.sd,
                    "data_low_95": factor * found.data_interval[0],
                    "data_high_95": factor * found.data_interval[1],
                    "sd_log_data": found.data_sd,
                    "sd_log_assumed": found.assumed_sd,
                    "bootstrap_low_95": factor * found.bootstrap[0],
                    "bootstrap_high_95": factor * found.bootstrap[1],
                    "bias_corrected": factor * found.bias.value if found.bias else np.nan,
                    "status": fit.status,
                }
            )
    return rows


def goodness_rows(result: FitResult) -> Rows:
    """One row per condition: J, and k, m, R² and RMS with intervals."""
    rows = []
    for subject, condition, fit in named(result):
        row: dict[str, Any] = {
            "subject": subject,
            "condition": condition,
            "trials": len(fit.problem),
            "frames": len(fit.problem.measured),
            "J_mm4": fit.cost * MM4,
            "J_full_order_mm4": fit.full_order_cost * MM4,
            "J_power_law_mm4": fit.power_law.cost * MM4,
        }
        found = fit.goodness
        if found is not None:
            for name, value, factor in (
                ("k_mm2_per_Nm", found.k, MM2),
                ("m", found.m, 1.0),
                ("R2", found.model, 1.0),
                ("R2_power_law", found.power_law, 1.0),
                ("rms_mm2", found.rms, MM2),
            ):
                row[name] = value.value * factor
                row[f"{name}_low_95"] = value.low * factor
                row[f"{name}_high_95"] = value.high * factor
        rows.append(row)
    return rows


def contrast_rows(result: FitResult, found: Sequence[Contrast]) -> Rows:
    """One row per contrast, in display units."""
    rows = []
    for c in found:
        quantity = result.space.describe(c.quantity)
        factor = quantity.display_factor
        rows.append(
            {
                "subject": c.subject,
                "first": c.first,
                "second": c.second,
                "quantity": c.quantity,
                "ratio": c.ratio,
                "ratio_low_95": c.ratio_95[0],
                "ratio_high_95": c.ratio_95[1],
                "unit": quantity.display_unit,
                "difference": c.difference * factor,
                "difference_low_95": c.difference_95[0] * factor,
                "difference_high_95": c.difference_95[1] * factor,
                "probability_greater": c.probability_greater,
                "separated": c.separated,
                "on_bound": " ".join(c.on_bound),
            }
        )
    return rows


def trial_rows(result: FitResult) -> Rows:
    """One row per trial: J, lag, tare and gain beside what was pressed."""
    rows = []
    for subject, condition, fit in named(result):
        problem = fit.problem
        costs = problem.trial_costs(fit.areas)
        by_law = problem.trial_costs(fit.power_law.area(problem.force))
        found = {t.label: t for t in fit.quality.trials} if fit.quality else {}
        for index, trial in enumerate(problem.trials):
            known = found.get(trial.label)
            rows.append(
                {
                    "subject": subject,
                    "condition": condition,
                    "trial": trial.label,
                    "moisture_au": trial.moisture,
                    "loading_s": trial.loading,
                    "peak_force_n": trial.drive.record_force.max(),
                    "frames": len(trial.area),
                    "largest_area_mm2": trial.area.max() * MM2,
                    "J_mm4": costs[index] * MM4,
                    "J_power_law_mm4": by_law[index] * MM4,
                    "lag_s": known.lag if known else np.nan,
                    "tare_n": known.tare if known else np.nan,
                    "gain": known.gain if known else np.nan,
                    "saturated_frames": known.saturated if known else "",
                }
            )
    return rows


def frame_rows(result: FitResult) -> Iterator[dict[str, Any]]:
    """One row per frame that counts: observed and predicted area, and the residual."""
    for subject, condition, fit in named(result):
        problem = fit.problem
        law = fit.power_law.area(problem.force)
        time = np.concatenate([t.frame_time for t in problem.trials])
        for k, index in enumerate(problem.trial_of):
            yield {
                "subject": subject,
                "condition": condition,
                "trial": problem.trials[index].label,
                "time_s": time[k],
                "force_n": problem.force[k],
                "area_mm2": problem.measured[k] * MM2,
                "predicted_mm2": fit.areas[k] * MM2,
                "residual_mm2": (problem.measured[k] - fit.areas[k]) * MM2,
                "power_law_mm2": law[k] * MM2,
                "weight": problem.weight[k],
            }


def indentation_rows(result: FitResult) -> Iterator[dict[str, Any]]:
    """One row per measured indentation that was compared: less its trial's zero, predicted, and the
    residual."""
    for subject, condition, fit in named(result):
        found = fit.indentation
        if found is None:
            continue
        for k, index in enumerate(found.trial_of):
            yield {
                "subject": subject,
                "condition": condition,
                "trial": fit.problem.trials[index].label,
                "time_s": found.time[k],
                "force_n": found.force[k],
                "indentation_mm": found.measured[k] * MM,
                "predicted_mm": found.predicted[k] * MM,
                "residual_mm": (found.measured[k] - found.predicted[k]) * MM,
            }


def named(result: FitResult) -> Iterator[tuple[str, str, ConditionFit]]:
    """Subject, condition and fit of everything that was fitted."""
    for part in result.parts.values():
        for condition, fit in part.fits.items():
            yield codes_of(fit.problem.trials), condition, fit


def latex(rows: Rows) -> str:
    """A booktabs table of the rows; a value and its interval share a cell."""
    pairs = [k.removesuffix("_low_95") for k in rows[0] if k.endswith("_low_95")]
    # "low_95" and "high_95" alone belong to "value".
    columns = [k for k in rows[0] if not k.endswith(("low_95", "high_95"))]
    lines = [
        r"% \usepackage{booktabs}",
        r"\begin{tabular}{" + "".join("l" if _is_text(rows, k) else "r" for k in columns) + "}",
        r"\toprule",
        " & ".join(_escape(k.replace("_", " ")) for k in columns) + r" \\",
        r"\midrule",
    ]
    for row in rows:
        cells = []
        for key in columns:
            prefix = "" if key == "value" and "low_95" in row else f"{key}_"
            text = _latex_cell(row[key])
            low, high = row.get(f"{prefix}low_95"), row.get(f"{prefix}high_95")
            if (key in pairs or not prefix) and low is not None and np.isfinite(low):
                text += f" [{_latex_cell(low)}, {_latex_cell(high)}]"
            cells.append(text)
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _is_text(rows: Rows, key: str) -> bool:
    return any(isinstance(row[key], str) for row in rows)


def _latex_cell(value: Any) -> str:
    if isinstance(value, (float, np.floating)):
        return f"${three_digits(float(value))}$" if np.isfinite(value) else "--"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    return _escape(str(value))


def _escape(text: str) -> str:
    for sign in "&%$#_{}":
        text = text.replace(sign, "\\" + sign)
    return text


def _cell(value: Any) -> Any:
    """A value of a CSV file: six significant digits, empty for NaN."""
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}" if np.isfinite(value) else ""
    return value
