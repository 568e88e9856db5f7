"""Write docs/faults_drivers.md from the recorded results of the fault tests.

`python scripts/driver_faults.py --measure` runs the tests and records their rows beside them, with
`--only EXPRESSION` those that pytest's -k selects, which replace the rows of the same names;
without it the page is written from the rows recorded last. `--check` only reports whether the page
is current (exit code 1 if not).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

from finger_common.files import atomic_write

ROOT = Path(__file__).resolve().parent.parent
TESTS = ROOT / "src" / "finger_driver" / "test" / "test_fault_matrix.py"
RECORDED = TESTS.with_name("recorded_faults.json")
PAGE = ROOT / "docs" / "faults_drivers.md"

INTRODUCTION = """# What the drivers do when devices fail

<!-- Written by scripts/driver_faults.py from recorded results; a test holds it against them. -->

The real nodes against simulated devices in other processes, as measured by
`src/finger_driver/test/test_fault_matrix.py`, which asserts the level of every row. Recovery is
measured from the end of the fault to the next good message; it includes the pause between attempts
to reconnect (parameters `reconnect_first_pause` 0.1 s and `reconnect_longest_pause` 0.5 s in these
tests). Nothing here was tried on hardware. `python scripts/driver_faults.py --measure` measures
again.

| device | fault | published meanwhile | diagnostics | recovery |
|---|---|---|---|---|
"""


def measure(only: str = "") -> list[list[str]]:
    """Rows of the table from a run of the tests, all of which must pass."""
    selected = f"not recorded and ({only})" if only else "not recorded"
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "results.xml"
        command = [sys.executable, "-m", "pytest", "-q", str(TESTS), f"--junitxml={report}"]
        subprocess.run(
            [*command, "-o", "junit_family=xunit1", "-k", selected], cwd=ROOT, check=True
        )
        properties = list(ElementTree.parse(report).iter("property"))
    rows = [json.loads(p.attrib["value"]) for p in properties if p.get("name") == "fault"]
    return merged(json.loads(RECORDED.read_text(encoding="utf-8")), rows) if only else rows


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


def page(rows: list[list[str]]) -> str:
    """Text of the page."""
    return INTRODUCTION + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measure", action="store_true", help="run the tests first")
    parser.add_argument("--only", default="", help="measure the tests that this selects (-k)")
    parser.add_argument("--check", action="store_true", help="only report whether it is current")
    arguments = parser.parse_args()
    if arguments.measure:
        rows = measure(arguments.only)
        with atomic_write(RECORDED) as file:
            json.dump(rows, file, ensure_ascii=False, indent=1)
            file.write("\n")
    text = page(json.loads(RECORDED.read_text(encoding="utf-8")))
    if PAGE.exists() and PAGE.read_text(encoding="utf-8") == text:
        return 0
    if arguments.check:
        print("docs/faults_drivers.md is not current; run python scripts/driver_faults.py")
        return 1
    with atomic_write(PAGE) as file:
        file.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
