"""Write docs/faults.md, the table of all provoked faults, from recorded results.

The results are those of the driver tests (`--measure` runs them and records their rows, with
`--only EXPRESSION` those that pytest's -k selects), of `scripts/random_faults.py --record` and of
`tests/fuzz --record`. Without an option the page is written from what was recorded last; `--check`
only reports whether it is current (exit code 1 if not).
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from finger_common.files import atomic_write

ROOT = Path(__file__).resolve().parent.parent
DRIVER_TESTS = ROOT / "src" / "finger_driver" / "test" / "test_fault_matrix.py"
DRIVERS = DRIVER_TESTS.with_name("recorded_faults.json")
RIG = ROOT / "tests" / "recorded_random_faults.json"
FILES = ROOT / "tests" / "fuzz" / "recorded.json"
PAGE = ROOT / "docs" / "faults.md"

NAMED, GONE = 2.0, 5.0
"""s: bounds of the rig's diagnostics."""

PAGE_TEXT = """# When something fails

<!-- Written by scripts/faults.py from recorded results; a test holds it against them. -->

Every fault that was provoked, what comes meanwhile, and what is said. [Faults of the contact
state](grasp-integration.md#faults) lists what a grasp controller receives in each case.
`make faults` provokes all of them again and writes this page. Nothing here was tried on hardware.

- **Devices**: the real driver nodes against simulated devices in other processes
  (`src/finger_driver/test/test_fault_matrix.py`, which asserts the level of every row). *Over*:
  time from the end of the fault to the next good message. It includes the pause between attempts
  to reconnect (parameters `reconnect_first_pause` 0.1 s, `reconnect_longest_pause` 0.5 s there).
- **Rig**: `finger-rig up --simulated` with a recording, one random fault after the other at random
  times for {minutes:g} minutes (`scripts/random_faults.py --seed {seed}`). *Named*: longest time
  from the begin of the fault until `/diagnostics` names it. *Over*: longest time from its end
  until it is no longer named. The fault of a killed node ends when the node is active again.
  - {named} of {faults} faults were named, {named_in} within {NAMED:g} s (median
    {named_median:.2f} s).
  - {gone} went, {gone_in} within {GONE:g} s (median {gone_median:.2f} s).
  - {tracebacks} tracebacks in the log.
  - {messages:,} messages recorded, with {gaps} gaps; {silent} of them without a report of a fault.
{rig_note}\
- **Files**: {cases:,} changed files of a corpus, each given to its readers in a process of its own
  that is measured (`tests/fuzz`, seed {file_seed}). At most {cpu:g} s of processor time and
  {megabytes} MB were used (limits: 10 s, 500 MB); {failed} cases failed. [What was tried on
  bags](faults_bags.md) has the kinds of damage, the limits and the recorder.
- **Decoders** receive random and mutated inputs, 100,000 for each of seven in `make test-slow`,
  3,000 in `make test` (`src/finger_driver/test/test_fuzz.py`): no exception escapes, none blocks,
  memory does not grow.

| where | fault | comes meanwhile | is said | named | over |
|---|---|---|---|---|---|
"""


def measure(only: str = "") -> list[list[str]]:
    """Rows of the drivers from a run of the tests, all of which must pass."""
    selected = f"not recorded and ({only})" if only else "not recorded"
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "results.xml"
        command = [sys.executable, "-m", "pytest", "-q", str(DRIVER_TESTS), f"--junitxml={report}"]
        subprocess.run(
            [*command, "-o", "junit_family=xunit1", "-k", selected], cwd=ROOT, check=True
        )
        properties = list(ElementTree.parse(report).iter("property"))
    rows = [json.loads(p.attrib["value"]) for p in properties if p.get("name") == "fault"]
    return merged(json.loads(DRIVERS.read_text(encoding="utf-8")), rows) if only else rows


def merged(old: list[list[str]], new: list[list[str]]) -> list[list[str]]:
    """Old rows with new ones in their places, or after those of their device."""
    rows = list(old)
    for row in new:
        places = [i for i, other in enumerate(rows) if other[:2] == row[:2]]
        if places:
            rows[places[0]] = row
        else:
            last = max((i for i, other in enumerate(rows) if other[0] == row[0]), default=len(rows))
            rows.insert(last + 1, row)
    return rows


def clean(text: str) -> str:
    """Without the paths and numbers of a run."""
    text = re.sub(r"(/[\w.-]+){2,}", "PATH", text.replace("|", "/"))
    return re.sub(r"\b\d{19}_\d{8}\b", "STAMP_NUMBER", text)


def longest(values: list[float | None]) -> str:
    """The largest of some times (s), of which None is never."""
    known = [v for v in values if v is not None]
    return f"{max(known):.2f} s" if len(known) == len(values) else "never"


def rig_rows(results: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """One row for each kind of fault of the rig."""
    kinds: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for result in results:
        kinds[result["fault"]].append(result)
    rows = []
    for name, found in sorted(kinds.items()):
        back = [r["restart"] for r in found if r["restart"] is not None]
        over = longest([r["gone"] for r in found])
        over += f"; node back {max(back):.1f} s after the kill" if back else ""
        said = clean(next((r["text"] for r in found if r["text"]), ""))
        times = f"{len(found)} times"
        rows.append(
            ("rig", f"{name}, {times}", "", said, longest([r["named"] for r in found]), over)
        )
    return rows


def file_rows(outcomes: dict[str, int]) -> list[tuple[str, ...]]:
    """One row for each kind of file and its reader."""
    found: dict[tuple[str, str], dict[str, int]] = defaultdict(dict)
    for key, count in outcomes.items():
        kind, reader, outcome = key.split(", ")
        found[kind, reader][outcome] = count
    return [
        (
            f"file: {kind}",
            f"{sum(counts.values())} changed ones, for {reader}",
            f"{counts.get('success', 0)} were read, whole or in part",
            f"one sentence: {counts.get('refused', 0)}"
            + (f"; FAILED: {counts['FAILED']}" if "FAILED" in counts else ""),
            "",
            "",
        )
        for (kind, reader), counts in sorted(found.items())
    ]


def page() -> str:
    """Text of the page."""
    drivers = json.loads(DRIVERS.read_text(encoding="utf-8"))
    rig = json.loads(RIG.read_text(encoding="utf-8"))
    files = json.loads(FILES.read_text(encoding="utf-8"))
    results = rig["results"]
    named = [r["named"] for r in results if r["named"] is not None]
    gone = [r["gone"] for r in results if r["gone"] is not None]
    facts = {
        **{key: rig[key] for key in ("minutes", "seed", "messages", "gaps")},
        "faults": len(results), "named": len(named), "gone": len(gone),
        "named_in": sum(v <= NAMED for v in named), "gone_in": sum(v <= GONE for v in gone),
        "named_median": statistics.median(named), "gone_median": statistics.median(gone),
        "tracebacks": len(rig["tracebacks"]), "silent": len(rig["silent_losses"]),
        "rig_note": f"  - {rig['note']}\n" if rig.get("note") else "",
        "cases": files["cases"], "file_seed": files["seed"], "cpu": files["longest"],
        "megabytes": files["most_megabytes"], "failed": len(files["failed"]),
        "NAMED": NAMED, "GONE": GONE,
    }  # fmt: skip
    rows = [(where, what, comes, said, "", over) for where, what, comes, said, over in drivers]
    rows += rig_rows(results) + file_rows(files["outcomes"])
    return PAGE_TEXT.format(**facts) + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def write() -> None:
    """Write the page."""
    with atomic_write(PAGE) as file:
        file.write(page())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measure", action="store_true", help="run the tests of the drivers first")
    parser.add_argument("--only", default="", help="measure the tests that this selects (-k)")
    parser.add_argument("--check", action="store_true", help="only report whether it is current")
    arguments = parser.parse_args()
    if arguments.measure:
        rows = measure(arguments.only)
        with atomic_write(DRIVERS) as file:
            json.dump(rows, file, ensure_ascii=False, indent=1)
            file.write("\n")
    if arguments.check:
        if not PAGE.exists() or PAGE.read_text(encoding="utf-8") != page():
            print("docs/faults.md is not current; run python scripts/faults.py")
            return 1
        return 0
    write()
    return 0


if __name__ == "__main__":
    sys.exit(main())
