"""Put measured tables into docs/study.md.

python scripts/study_tables.py --fit out/study_fit/fit.json --recovery out/recovery/recovery.json \\
    --misfit out/recovery/recovery_misfit.json --write
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from recovery import misfit_table, tables
from throughput import replace_between

from finger_common.files import atomic_write
from finger_sim.conditions import STUDY

PAGE = Path(__file__).resolve().parent.parent / "docs" / "study.md"

PAPER = {
    "moisture (a.u.)": ("37.56 ± 3.34", "69.31 ± 6.54", "105.33 ± 4.93"),
    "exponent m": ("0.67", "0.68", "0.50"),
    "J of the power law (mm⁴)": ("2650", "4767", "1807"),
    "J of the model (mm⁴)": ("≤ 2150", "≤ 4267", "≤ 1307"),
    "composite E (kPa)": ("30.23", "19.27", "13.71"),
    "E2 (kPa)": ("1652", "1795", "700 (bound)"),
    "τ1 (s)": ("low", "highest", "0.01 (bound)"),
}
"""Printed in Nam and Kuchenbecker 2021; J of the model from "at least 500 mm⁴ below the power law"."""


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
        ("recovery", args.recovery, tables),
        ("misfit", args.misfit, misfit_table),
    ):
        if path is None:
            continue
        text = make(json.loads(path.read_text(encoding="utf-8")))
        print(text)
        page = replace_between(page, marker, text)
    if args.write:
        with atomic_write(PAGE) as file:
            file.write(page)


if __name__ == "__main__":
    main()
