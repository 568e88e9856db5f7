"""Put measured tables into docs/study.md.

python scripts/study_tables.py --fit out/study_fit/fit.json --recovery out/recovery/recovery.json \\
    --misfit out/recovery/recovery_misfit.json --write
"""

from __future__ import annotations

import argparse
import itertools
import json
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from doc_tables import replace_between
from recovery import FEWEST_FREE, QUANTITIES, SPACE, WINDOWS, statistics

from finger_common.files import atomic_write
from finger_model.paper import CONDITIONS
from finger_sim.conditions import STUDY

PAGE = Path(__file__).resolve().parent.parent / "docs" / "study.md"

PAPER = {
    "moisture (a.u.)": [f"{c.moisture:.2f} ± {c.moisture_sd:.2f}" for c in CONDITIONS.values()],
    "exponent m": [f"{c.power_law_exponent:.2f}" for c in CONDITIONS.values()],
    "J of the power law (mm⁴)": [f"{c.power_law_cost * 1e12:.0f}" for c in CONDITIONS.values()],
    "J of the model (mm⁴)": [f"≤ {c.power_law_cost * 1e12 - 500:.0f}" for c in CONDITIONS.values()],
    "composite E (kPa)": [f"{c.composite_E * 1e-3:.2f}" for c in CONDITIONS.values()],
    "E2 (kPa)": ("1652", "1795", "700 (bound)"),
    "τ1 (s)": ("low", "highest", "0.01 (bound)"),
}
"""Printed in Nam and Kuchenbecker 2021; J of the model: at least 500 mm⁴ below the power law."""


def paper_table(data: dict[str, Any]) -> str:
    """The paper's table beside a fit.json."""
    found = data["conditions"]

    def interval(entry: dict[str, Any], name: str, factor: float, digits: int) -> str:
        span = entry.get("interval_95", {}).get(name)
        text = f"{entry[name] * factor:.{digits}f}"
        if span:
            text += f" ({span['low'] * factor:.{digits}f}–{span['high'] * factor:.{digits}f})"
        corrected = entry.get("bias_corrected", {}).get(name)
        return text + (f"; {corrected['value'] * factor:.{digits}f}" if corrected else "")

    ours = {
        "moisture (a.u.)": lambda e: f"{e['moisture_mean']:.2f} ± {e['moisture_sd']:.2f}",
        "exponent m": lambda e: (
            f"{e['power_law']['m']:.2f} (log–log {e['power_law']['log_log_m']:.2f})"
        ),
        "J of the power law (mm⁴)": lambda e: f"{e['J_power_law']:.1f}",
        "J of the model (mm⁴)": lambda e: f"{e['J']:.1f}",
        "composite E (kPa)": lambda e: interval(e, "composite_E", 1e-3, 2),
        "E2 (kPa)": lambda e: interval(e, "E2", 1e-3, 0),
        "τ1 (s)": lambda e: interval(e, "tau1", 1.0, 3),
    }
    lines = ["| | " + " | ".join(f"{n}, paper | {n}, fit" for n in STUDY) + " |"]
    lines.append("|---" * (1 + 2 * len(STUDY)) + "|")
    for row, printed in PAPER.items():
        cells = [
            f"{value} | {ours[row](found[name]) if name in found else '–'}"
            for name, value in zip(STUDY, printed)
        ]
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    seconds = data.get("seconds", {})
    spent = ", ".join(f"{stage} {value:.1f} s" for stage, value in seconds.items())
    status = ", ".join(f"{name}: {entry['status']}" for name, entry in found.items())
    lines += ["", f"Time: {spent}. The paper: 27,000 min (19 days). Status: {status}."]
    return "\n".join(lines)


# Recovery --------------------------------------------------------------------------------------

Rows = list[dict[str, Any]]


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


def symbol(q: str) -> str:
    """The quantity's symbol."""
    return SPACE.describe(q).symbol


def part(rows: Rows, name: str, window: str) -> Rows:
    """The rows of one condition and window."""
    return [r for r in rows if r["condition"] == name and r["window"] == window]


def accuracy_row(s: dict[str, float], window: str, name: str, q: str) -> list[str]:
    """Cells of bias, spread and coverage."""
    free = f"{s['free_spread'] / s['bound']:.2f}" if s["free"] >= FEWEST_FREE else "–"
    return [
        window,
        name,
        symbol(q),
        f"{100 * s['bias']:+.1f}",
        f"{100 * s['spread']:.1f}",
        f"{100 * s['bound']:.1f}",
        f"{s['bias'] / max(s['spread'], 1e-12):+.2f}",
        f"{s['spread'] / s['bound']:.2f}",
        free,
        f"{100 * s['coverage']:.0f} %",
    ]


ACCURACY = (
    "window", "condition", "quantity", "bias (%)", "spread (%)", "Cramér–Rao (%)", "bias / spread",
    "spread / bound", "the same, fits off the bounds", "covered",
)  # fmt: skip


def recovery_tables(result: dict[str, Any]) -> str:
    """Markdown tables of a run of recovery.py without misfit."""
    rows = result["rows"]
    cells = list(itertools.product(WINDOWS, STUDY, QUANTITIES))
    estimates, corrected = [], []
    for window, name, q in cells:
        s = statistics(rows, name, window, q)
        more = [f"{100 * s['interval_sd']:.1f}", f"{100 * s['at_bound']:.0f} %"]
        estimates.append([*accuracy_row(s, window, name, q), *more])
        s = statistics(rows, name, window, q, "corrected_")
        corrected.append(accuracy_row(s, window, name, q))
    lines = [
        "Estimates, which minimise J:",
        "",
        *markdown([*ACCURACY, "mean interval SD (%)", "fits on a bound"], estimates),
        "",
        "Bias-corrected (covered: by the interval shifted with the value):",
        "",
        *markdown(ACCURACY, corrected),
        *antithetic_table(result),
        "",
        "Without noise (in brackets: before the correction to full order):",
        "",
    ]
    header = ["window", "condition", *(f"{symbol(q)} error (%)" for q in QUANTITIES), "J (mm⁴)"]
    clean = []
    for row in result["clean"]:
        before = row["uncorrected_error_log"]
        found = [
            f"{100 * error:+.2f} ({100 * before[q]:+.1f})" for q, error in row["error_log"].items()
        ]
        cost = f"{row['J']:.3f} ({row['J_uncorrected']:.2f})"
        clean.append([row["window"], row["condition"], *found, cost])
    lines += [*markdown(header, clean), "", "Cost, mean over seeds (mm⁴):", ""]
    lines += [*cost_table(rows), "", searches(result)]
    return "\n".join(lines)


def cost_table(rows: Rows) -> list[str]:
    """J of fit, truth and power law."""
    header = [
        "window", "condition", "J fit", "J truth", "largest J fit / J truth", "J power law",
        "largest difference of J_pl − J at fit and truth", "power law m", "log–log m",
    ]  # fmt: skip
    lines = []
    for window, name in itertools.product(WINDOWS, STUDY):
        chosen = part(rows, name, window)
        keys = ("J", "J_truth", "J_power_law", "power_law_m", "power_law_log_m")
        fit, truth, law, m, log_m = (float(np.mean([r[k] for r in chosen])) for k in keys)
        worst = max(r["J"] / r["J_truth"] for r in chosen)
        apart = [abs(r["J"] - r["J_truth"]) for r in chosen]
        share = max(d / abs(r["J_power_law"] - r["J_truth"]) for d, r in zip(apart, chosen))
        largest = f"{max(apart):.1f} mm⁴, {100 * share:.0f} %"
        lines.append(
            [window, name, f"{fit:.1f}", f"{truth:.1f}", f"{worst:.3f}", f"{law:.1f}", largest,
             f"{m:.2f}", f"{log_m:.2f}"]
        )  # fmt: skip
    return markdown(header, lines)


def antithetic_bias(
    result: dict[str, Any], name: str, window: str, q: str, kind: str = ""
) -> tuple[float, float]:
    """Bias over spread and its standard error, from pairs of fits with opposite area noise."""
    first, second = (
        {r["seed"]: r[f"{kind}error_log"][q] for r in part(result[key], name, window)}
        for key in ("rows", "antithetic")
    )
    means = np.array([0.5 * (first[s] + second[s]) for s in sorted(second) if s in first])
    spread = statistics(result["rows"], name, window, q, kind)["spread"]
    error = means.std(ddof=1) / np.sqrt(len(means))
    return float(means.mean() / spread), float(error / spread)


def antithetic_table(result: dict[str, Any]) -> list[str]:
    """Lines of the table of biases from antithetic pairs; none without such fits."""
    pairs = len({r["seed"] for r in result["antithetic"]})
    if pairs < 2:
        return []
    columns = list(itertools.product(QUANTITIES, ("", "corrected_")))
    header = [f"{symbol(q)}, {'corrected' if kind else 'estimate'}" for q, kind in columns]
    rows = []
    for window, name in itertools.product(WINDOWS, STUDY):
        found = [antithetic_bias(result, name, window, q, kind) for q, kind in columns]
        rows.append([window, name, *(f"{bias:+.2f} ± {error:.2f}" for bias, error in found)])
    return [
        "",
        f"Bias / spread of {pairs} seeds, each fitted also with sign-flipped area noise "
        "(± standard "
        "error of the mean):",
        "",
        *markdown(["window", "condition", *header], rows),
    ]


def searches(result: dict[str, Any]) -> str:
    """What the search may have missed."""
    rows = result["rows"]
    searched = [r for r in rows if "start_from_truth" in r]
    missed = sum(r["start_from_truth"] < 0.999 for r in searched)
    return (
        f"{len({r['seed'] for r in rows})} seeds, {len(rows)} fits. {len(searched)} of them began "
        f"with the search; in {missed} of these a start at the truth found a J lower by more than "
        f"0.1 %. Reduced model {result['model'][:12]}."
    )


def misfit_table(result: dict[str, Any]) -> str:
    """Markdown table of the bias that misfit makes."""
    rows, clean = result["rows"], result["clean"]
    header = [
        "window", "condition", "quantity", "epidermis −25 %", "epidermis +25 %",
        f"areas scattered by 5 %: bias ± spread, {len({r['seed'] for r in rows})} seeds",
        "bias-corrected", "covered, estimate and corrected",
    ]  # fmt: skip
    lines, costs = [], []
    for window in WINDOWS:
        texts = []
        for name in STUDY:
            by_finger = {r["finger"]: r for r in part(clean, name, window)}
            texts.append(
                f"{name} "
                + ", ".join(f"{by_finger[f]['J']:.2f}" for f in ("thin", "true", "thick"))
            )
            for q in QUANTITIES:
                both = [statistics(rows, name, window, q, k) for k in ("", "corrected_")]
                cells = [
                    f"{100 * np.expm1(by_finger[f]['error_log'][q]):+.0f} %"
                    for f in ("thin", "thick")
                ]
                cells += [f"{100 * s['bias']:+.0f} ± {100 * s['spread']:.0f} %" for s in both]
                cells.append(", ".join(f"{100 * s['coverage']:.0f} %" for s in both))
                lines.append([window, name, symbol(q), *cells])
        costs.append(f"- {window}: {'; '.join(texts)}.")
    title = "J of the fit without noise (mm⁴), epidermis thinner, as assumed, thicker:"
    return "\n".join([*markdown(header, lines), "", title, "", *costs])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", type=Path, help="fit.json of the study")
    parser.add_argument("--recovery", type=Path, help="recovery.json")
    parser.add_argument("--misfit", type=Path, help="recovery_misfit.json")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/study.md")
    args = parser.parse_args()
    page = PAGE.read_text(encoding="utf-8")
    for marker, path, make in (
        ("paper", args.fit, paper_table),
        ("recovery", args.recovery, recovery_tables),
        ("misfit", args.misfit, misfit_table),
    ):
        if path is None:
            continue
        text = make(json.loads(path.read_text(encoding="utf-8")))
        lines = [
            line if line[:1] in "|-" else textwrap.fill(line, 100) for line in text.split("\n")
        ]
        text = "\n".join(lines)
        print(text)
        page = replace_between(page, marker, text)
    if args.write:
        with atomic_write(PAGE) as file:
            file.write(page)


if __name__ == "__main__":
    main()
