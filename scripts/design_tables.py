"""Put the deviations that `finger-fit design` expects into docs/your_data.md.

    python scripts/design_tables.py [--write]

Its own plans for the natural finger of the study, measured with calipers: one table of the areas
alone, one of what a displacement sensor adds.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from doc_tables import replace_between

from finger_common.files import atomic_write
from finger_fit.design.command import command

PAGE = Path(__file__).resolve().parent.parent / "docs" / "your_data.md"
COMMAND = ["--guess", "natural", "--geometry-sd", "calipers", "--wanted", "composite_E=0.1"]
PLANS = {
    "paper": "15 presses of 0.5–2 s to 1.35 N, loading alone",
    "30 presses": "30 of them",
    "release": "15, release included",
    "hold": "15, hold of 1 s and release",
    "rates": "15 of 0.2–6 s, with release",
    "3 N": "15 to 3 N, with release",
}
"""Name of the command -> words of the page."""
SYMBOLS = {"E0": "E0", "E1": "E1", "tau1": "τ1", "E2": "E2", "composite_E": "E"}


def percent(plan: dict[str, Any], name: str) -> tuple[str, str]:
    """Deviation from the data and in all, in %."""
    return f"{100 * plan['sd_log_data'][name]:.0f}", f"{100 * plan['sd_log'][name]:.0f}"


def table(heading: list[str], rows: list[list[str]]) -> str:
    """Rows of cells as a table of the page."""
    lines = [f"| {' | '.join(row)} |" for row in (heading, *rows)]
    return "\n".join([lines[0], "|---" * len(heading) + "|", *lines[1:]])


def of_areas(plans: dict[str, Any]) -> str:
    """What areas alone tell, and the presses for E ± 10 %."""
    rows = []
    for name, words in PLANS.items():
        cells = [f"{data} ({total})" for data, total in (percent(plans[name], s) for s in SYMBOLS)]
        rows.append([words, *cells, str(plans[name]["presses_from_data"])])
    heading = ["plan", *SYMBOLS.values(), "presses for E ± 10 % from the data"]
    return table(heading, rows)


def of_sensor(plans: dict[str, Any]) -> str:
    """Without → with a measured indentation."""
    rows = []
    for name, words in PLANS.items():
        pairs = zip(
            *([percent(plans[n], s) for s in SYMBOLS] for n in (name, f"{name} + indentation"))
        )
        cells = [f"{a} → {b} ({all_a} → {all_b})" for (a, all_a), (b, all_b) in pairs]
        rows.append([words, *cells])
    return table(["plan", *SYMBOLS.values()], rows)


def main() -> None:
    """Print the tables, or write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put them into docs/your_data.md")
    write = parser.parse_args().write
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "design.json"
        command([*COMMAND, "-o", str(file)])
        plans = json.loads(file.read_text())["plans"]
    if write:
        page = PAGE.read_text(encoding="utf-8")
        page = replace_between(page, "design", of_areas(plans))
        page = replace_between(page, "design-indentation", of_sensor(plans))
        with atomic_write(PAGE) as out:
            out.write(page)


if __name__ == "__main__":
    main()
