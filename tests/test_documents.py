"""Commands shown in README.md and docs/ run, links lead somewhere, figures are the measured ones.

A fenced block marked `sh` is a script. It runs in an empty folder that holds links to `bags`,
`examples` and `docs`, with the environment's commands on the path. Blocks of one document run in
order in the same folder. A comment line before the fence changes that: `<!-- not run: reason -->`
leaves the block out and gives the reason, `<!-- slow -->` runs it with the slow tests only.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

from finger_common.flags import StateFlag

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "bags" / "README.md",
    ROOT / "scripts" / "README.md",
]


@dataclass
class Block:
    """One fenced `sh` block of a document."""

    document: Path
    line: int
    script: str
    slow: bool


def blocks(document: Path) -> list[Block]:
    """The blocks of a document that are to run."""
    found: list[Block] = []
    comment = ""
    script: list[str] | None = None
    line = 0
    for number, text in enumerate(document.read_text().splitlines(), 1):
        if script is not None:
            if text.startswith("```"):
                if not comment.startswith("not run"):
                    found.append(Block(document, line, "\n".join(script), comment == "slow"))
                script, comment = None, ""
            else:
                script.append(text)
        elif re.match(r"```sh\s*$", text):
            script, line = [], number
        elif match := re.match(r"<!-- (.*) -->", text):
            comment = match.group(1).strip()
        elif text.strip():
            comment = ""
    return found


def name_of(document: Path) -> str:
    """Name of a document in the checkout."""
    return str(document.relative_to(ROOT))


def documents_with_blocks() -> Iterator[Any]:
    """(document, slow) of every document with blocks; those with slow ones again for slow tests."""
    for document in filter(Path.exists, DOCUMENTS):
        kinds = {block.slow for block in blocks(document)}
        if False in kinds:
            limit = pytest.mark.timeout(900)
            yield pytest.param(document, False, id=name_of(document), marks=limit)
        if True in kinds:
            marks = (pytest.mark.slow, pytest.mark.timeout(1800))
            yield pytest.param(document, True, id=f"{name_of(document)}, slow", marks=marks)


def run_blocks(document: Path, folder: Path, slow: bool) -> None:
    for name in ("bags", "examples", "docs", "src"):
        (folder / name).symlink_to(ROOT / name)
    env = {
        **os.environ,
        "PATH": f"{Path(sys.prefix) / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "MPLBACKEND": "Agg",
    }
    for block in blocks(document):
        if block.slow and not slow:
            continue
        result = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block.script],
            cwd=folder,
            env=env,
            capture_output=True,
            text=True,
            timeout=1700 if slow else 850,
        )
        assert result.returncode == 0, (
            f"{document.name}, line {block.line}:\n{block.script}\n{result.stdout[-2000:]}"
            f"{result.stderr[-2000:]}"
        )


@pytest.mark.parametrize(("document", "slow"), list(documents_with_blocks()))
def test_commands_shown_run(document: Path, slow: bool, tmp_path: Path, ros_domain: int) -> None:
    run_blocks(document, tmp_path, slow)


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if d.exists()], ids=name_of)
def test_links_between_documents_lead_somewhere(document: Path) -> None:
    broken = []
    text = re.sub(r"`[^`\n]*`", "", document.read_text())  # what stands in code is no link
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if "://" not in target and not (document.parent / target).exists():
            broken.append(target)
    assert not broken, f"{document.name}: {broken}"


@pytest.mark.parametrize(("folder", "kinds"), [("docs", "*.md"), ("scripts", "*.[ps][yh]")])
def test_index_of_a_folder_names_every_file(folder: str, kinds: str) -> None:
    text = (ROOT / folder / "README.md").read_text()
    files = [file.name for file in (ROOT / folder).glob(kinds) if file.name != "README.md"]
    assert files
    missing = [name for name in sorted(files) if not re.search(rf"[(`]{re.escape(name)}[)`]", text)]
    assert not missing


def test_architecture_names_every_module_or_its_folder() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    code = re.findall(r"```.*?```|`[^`]+`", text, re.DOTALL)
    named = set(re.findall(r"\w+", " ".join(code)))
    missing = [
        name_of(part)
        for part in sorted(ROOT.glob("src/*/*/*"))
        if part.parent.name == part.parent.parent.name
        and (part.suffix == ".py" or (part / "__init__.py").exists())
        and part.stem != "__init__"
        and part.stem not in named
    ]
    assert not missing, f"name them in docs/architecture.md: {missing}"


def test_architecture_says_where_each_flag_is_decided() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    table = text.split("| flag | decided in |", 1)[1].split("\n\n", 1)[0]
    named = re.findall(r"`([^`]+)`", table)
    missing = [name for name in StateFlag.__members__ if not any(fnmatch(name, n) for n in named)]
    messages = ("contact_area", "contact_slip", "contact_shape", "moisture")
    missing += [m for m in messages if f"flags of `{m}`" not in table]
    assert not missing


def test_architecture_names_every_folder_of_the_checkout_with_code() -> None:
    text = (ROOT / "docs/architecture.md").read_text().split("## Rules", 1)[0]
    folders = {file.parent.name for file in ROOT.glob("*/*.py")}
    folders |= {folder.name for folder in (ROOT / "src").iterdir() if folder.is_dir()}
    missing = [name for name in sorted(folders) if not re.search(rf"^(src/)?{name}\b", text, re.M)]
    assert not missing


def test_help_of_make_names_every_target() -> None:
    """setup-test is a part of others."""
    text = (ROOT / "Makefile").read_text()
    (listed,) = re.findall(r"^\.PHONY: ((?:.*\\\n)*.*)$", text, re.M)
    shown = "\n".join(re.findall(r"@echo \"(.*)\"", text))
    targets = set(re.findall(r"[\w-]+", listed)) - {"help", "setup-test"}
    missing = [t for t in sorted(targets) if not re.search(rf"(?<![\w-]){t}(?![\w-])", shown)]
    assert not missing
