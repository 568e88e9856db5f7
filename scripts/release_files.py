"""Write what each package needs for a release, from the one home of each fact.

`python scripts/release_files.py` writes into every package below src/: LICENSE (a copy of the
project's), CHANGELOG.rst (from CHANGELOG.md), and the copyright lines at the head of each Python
file. `--check` only checks (exit code 1 if something is missing or old).
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(p.parent for p in (ROOT / "src").glob("*/package.xml"))
HEADER = "# Copyright 2026 Finger contact maintainers\n# SPDX-License-Identifier: Apache-2.0\n"


def restructured(text: str) -> str:
    """Inline markup of Markdown as reStructuredText."""
    text = re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", text)
    return re.sub(r"`([^`]+)`", r"``\1``", text)


def changelog(markdown: str, package: str) -> str:
    """CHANGELOG.rst of a package in the form that catkin_pkg reads.

    A version that is not released yet is called "Forthcoming", as bloom asks.
    """
    title = f"Changelog for package {package}"
    lines = ["^" * len(title), title, "^" * len(title), ""]
    indent = ""
    for line in map(str.rstrip, restructured(markdown).splitlines()[1:]):
        if line.startswith("## "):
            name = line[3:]
            name = "Forthcoming" if "unreleased" in name else name
            lines += [name, "-" * len(name)]
            indent = ""
        elif line.startswith("### "):
            lines += [f"* {line[4:]}:"]
            indent = "  "
        elif line.startswith("- "):
            lines.append(f"{indent}* {line[2:]}")
        elif line.startswith("  "):
            lines.append(f"{indent}{line}")
        elif not line:
            lines.append("")
        elif lines[-1].lstrip().startswith("* ") or indent:
            lines.append(f"{indent}{line}" if indent else line)
        else:
            lines.append(line)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).rstrip() + "\n"


def with_header(text: str) -> str:
    """Source text with the copyright lines, behind a line that names the interpreter."""
    if HEADER in text:
        return text.rstrip("\n") + "\n"
    first, rest = text.split("\n", 1) if text.startswith("#!") else ("", text)
    return (f"{first}\n" if first else "") + HEADER + (f"\n{rest}" if rest.strip() else "")


def wanted() -> dict[Path, str]:
    """Every file that this script writes, with its text."""
    licence = (ROOT / "LICENSE").read_text(encoding="utf-8")
    log = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    files: dict[Path, str] = {}
    for package in PACKAGES:
        files[package / "LICENSE"] = licence
        files[package / "CHANGELOG.rst"] = changelog(log, package.name)
        for source in sorted(package.rglob("*.py")):
            if "build" not in source.relative_to(package).parts:
                files[source] = with_header(source.read_text(encoding="utf-8"))
    return files


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only check")
    arguments = parser.parse_args()
    files = wanted()
    stale = [
        file
        for file, text in files.items()
        if not file.exists() or file.read_text(encoding="utf-8") != text
    ]
    if not arguments.check:
        for file in stale:
            file.write_text(files[file], encoding="utf-8")
        return 0
    for file in stale:
        print(f"{file.relative_to(ROOT)} is not current; run python scripts/release_files.py")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
