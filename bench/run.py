"""Measure the key figures of the suite and write them to bench/results.json.

`python bench/run.py [NAME …]` runs all benchmarks, or those of the modules named (`full_order` for
bench_full_order.py). Results of modules not run are kept in the file. `--quick` shortens the runs
that last a fixed time; its figures are for trying the benchmark out, not for quoting, and are not
written.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from finger_common.files import atomic_write

FOLDER = Path(__file__).resolve().parent
RESULTS = FOLDER / "results.json"


class Report:
    """Collects figures and notes of one run. `quick` asks for short runs."""

    def __init__(self, console: Console, quick: bool) -> None:
        self.console = console
        self.quick = quick
        self.results: list[dict[str, Any]] = []

    def add(
        self, name: str, value: float, unit: str, goal: float | None = None, better: str = "lower"
    ) -> None:
        """Add one figure; `goal` None where there is none, `better` "lower" or "higher"."""
        if better not in ("lower", "higher"):
            raise ValueError(f"better is {better!r}, 'lower' or 'higher' is needed")
        self.results.append(
            {"name": name, "value": float(value), "unit": unit, "goal": goal, "better": better}
        )
        self.console.print(f"  {name} = {value:.6g} {unit}", highlight=False)

    def note(self, text: str) -> None:
        """Print a line that is not a figure."""
        self.console.print(f"  {text}", highlight=False)


def machine() -> str:
    """The machine in one line."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    return (
        f"{model}, {len(os.sched_getaffinity(0))} cores, {platform.system()}, "
        f"Python {platform.python_version()}"
    )


def reached(result: dict[str, Any]) -> bool | None:
    """Whether a figure meets its goal; None without a goal."""
    if result["goal"] is None:
        return None
    if result["better"] == "lower":
        return result["value"] <= result["goal"]
    return result["value"] >= result["goal"]


def table(results: list[dict[str, Any]]) -> Table:
    """Figures as a table for the terminal."""
    view = Table(Column("figure", overflow="fold"), "value", "unit", "goal", "", title=machine())
    for result in results:
        goal = result["goal"]
        sign = "≤" if result["better"] == "lower" else "≥"
        mark = {True: "[green]met[/]", False: "[red]missed[/]", None: ""}[reached(result)]
        view.add_row(
            result["name"],
            f"{result['value']:.4g}",
            result["unit"],
            "" if goal is None else f"{sign} {goal:g}",
            mark,
        )
    return view


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="benchmark modules to run")
    parser.add_argument("--quick", action="store_true", help="short runs, nothing written")
    args = parser.parse_args()
    console = Console()
    modules = sorted(FOLDER.glob("bench_*.py"))
    known = [m.stem.removeprefix("bench_") for m in modules]
    for name in args.names:
        if name not in known:
            print(f"bench: no benchmark '{name}'; known are {', '.join(known)}", file=sys.stderr)
            return 2
    # Benchmarks end the processes they started when they are left, by an exception too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    console.print(machine())
    failed = []
    all_results: list[dict[str, Any]] = []
    for module, name in zip(modules, known):
        if args.names and name not in args.names:
            continue
        console.print(f"[bold]{name}[/]")
        report = Report(console, args.quick)
        start = time.perf_counter()
        try:
            spec = importlib.util.spec_from_file_location(module.stem, module)
            assert spec is not None and spec.loader is not None
            loaded = importlib.util.module_from_spec(spec)
            sys.modules[module.stem] = loaded
            spec.loader.exec_module(loaded)
            loaded.run(report)
        except Exception:
            traceback.print_exc()
            failed.append(name)
        console.print(f"  ({time.perf_counter() - start:.0f} s)", highlight=False)
        all_results += report.results
    if not args.quick:
        old = json.loads(RESULTS.read_text()) if RESULTS.exists() and args.names else []
        names = {r["name"] for r in all_results}
        merged = [r for r in old if r["name"] not in names] + all_results
        with atomic_write(RESULTS) as file:
            json.dump(merged, file, indent=1)
    console.print(table(all_results))
    if failed:
        print(f"bench: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
