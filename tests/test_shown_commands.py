"""Commands that documents only name exist, with the options, scripts and targets they are shown
with; links to a heading find it. `test_documents.py` runs the blocks that can be run.
"""

from __future__ import annotations

import ast
import contextlib
import io
import re
import signal
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from test_documents import DOCUMENTS, ROOT, name_of

SHELL = ("", "sh", "bash")
"""Languages of fenced blocks that hold commands."""

EXAMPLE_PARTS = {"capacitive_array", "load_cell"}
"""Parts that a page builds: their options exist once its package is installed, and the tests that
the page is named in run these commands with it."""


def code(text: str) -> Iterator[tuple[int, str]]:
    """(line, code) of blocks, fenced or indented, and of inline code; continued lines joined."""
    pattern = r"^```(\w*)\n(.*?)^```$|^ {4,}(\S.*(?:\\\n.*)*)$|`([^`]+)`"
    for match in re.finditer(pattern, text, re.MULTILINE | re.DOTALL):
        language, fenced, indented, inline = match.groups()
        if language in SHELL or language is None:
            line = text.count("\n", 0, match.start()) + 1
            lines = re.sub(r"\\\n\s*", " ", fenced or indented or "").splitlines()
            yield from ((line, part) for part in lines or [" ".join(inline.split())])


def commands(document: Path) -> Iterator[tuple[int, list[str]]]:
    """(line, words) of every command of the suite that the code of a document names."""
    for line, text in code(document.read_text()):
        for part in re.split(r"\||&&|;|\s#\s|\s{3,}", text):
            words = part.strip().removeprefix("$ ").removeprefix(".venv/bin/").split()
            if words and (words[0] in HELP or words[:1] in (["python"], ["make"])):
                yield line, words


HELP = {
    entry.name: entry
    for entry in entry_points(group="console_scripts")
    if entry.name.startswith("finger-")
}


@cache
def help_of(*words: str) -> str | None:
    """What a command or subcommand says to --help; None where there is no such subcommand."""
    said = io.StringIO()
    with contextlib.ExitStack() as around:
        around.enter_context(pytest.MonkeyPatch.context()).setattr(sys, "argv", [*words, "--help"])
        around.enter_context(contextlib.redirect_stdout(said))
        around.enter_context(contextlib.redirect_stderr(said))
        around.callback(signal.signal, signal.SIGINT, signal.getsignal(signal.SIGINT))
        end = around.enter_context(pytest.raises(SystemExit))
        HELP[words[0]].load()()
    return said.getvalue() if end.value.code == 0 else None


def options(words: list[str]) -> list[str]:
    """The long options among the words, as `--wide` in `[--wide]` and `--seed=1`."""
    return [match[0] for word in words if (match := re.search(r"(?<![\w-])--[a-z][\w-]*", word))]


def wrong_with(words: list[str]) -> str | None:
    """What does not exist of a shown command, None where all of it does."""
    if words[0] == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        return None if words[1:2] == [] or words[1] in targets else f"no target {words[1]}"
    if words[0] == "python":
        script = ROOT / (words[1] if words[1:2] else "")
        if script.suffix != ".py" and not (script / "__main__.py").is_file():
            return None  # a module of another project
        if not script.exists():
            return f"no file {words[1]}"
        names = [script] if script.is_file() else sorted(script.glob("*.py"))
        trees = [ast.parse(file.read_text()) for file in names]
        texts = {n.value for t in trees for n in ast.walk(t) if isinstance(n, ast.Constant)}
        # Behind --ros-args an option is ROS's.
        own = words[: words.index("--ros-args")] if "--ros-args" in words else words
        unknown = [option for option in options(own) if option not in texts]
        if words[1] == "bench/run.py":
            unknown += [w for w in words[2:] if not (ROOT / f"bench/bench_{w}.py").exists()]
        return f"{words[1]} has no {unknown}" if unknown else None
    if EXAMPLE_PARTS & set(words):
        return None
    sub = [w for w in words[1:2] if re.fullmatch(r"[a-z][a-z-]*", w)]
    said = help_of(words[0], *sub)
    if said is None:
        return f"no command {' '.join(words[:2])}"
    unknown = [o for o in options(words) if not re.search(rf"{o}(?![\w-])", said)]
    return f"{' '.join([words[0], *sub])} has no {unknown}" if unknown else None


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if d.exists()], ids=name_of)
def test_commands_that_a_document_names_exist(document: Path) -> None:
    wrong = [
        f"line {line}: {' '.join(words)}: {why}"
        for line, words in commands(document)
        if (why := wrong_with(words)) is not None
    ]
    assert not wrong, "\n".join(wrong)


def test_a_command_that_does_not_exist_is_found() -> None:
    """The check itself: one of each kind."""
    for shown in (
        "finger-bag validat BAG",
        "finger-bag process BAG -o OUT --sllip",
        "finger-fit bags/ --no-such",
        "python scripts/no_such.py",
        "python scripts/length_changes.py --no-such",
        "python bench/run.py no_such",
        "make no-such",
    ):
        assert wrong_with(shown.split()) is not None, shown


def anchors(document: Path) -> set[str]:
    """Names by which links reach the headings of a document, as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", document.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if d.exists()], ids=name_of)
def test_links_to_headings_find_them(document: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", document.read_text())
    targets = [(document.parent / page if page else document, name) for page, name in links]
    broken = [
        f"{page.name}#{name}"
        for page, name in targets
        if page.suffix == ".md" and name not in anchors(page)
    ]
    assert not broken, broken
