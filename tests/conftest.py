"""A headless browser for the page's tests; the nodes of several fingers in one process."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

OPTIONS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
).split()


def chromium() -> str | None:
    """Path of an installed Chromium or Chrome, None without one."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)


@contextmanager
def driver() -> Iterator[tuple[Any, str]]:
    """The browser's driver, and the path of an installed browser; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = chromium()
    if path is None:
        pytest.skip("no Chromium on this machine (Debian, Ubuntu: apt install chromium)")
    with playwright.sync_playwright() as running:
        yield running.chromium, path


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    """A headless browser with a profile of its own."""
    with driver() as (engine, path):
        context = engine.launch_persistent_context(
            str(tmp_path / "profile"),
            executable_path=path,
            headless=True,
            args=OPTIONS,
            viewport={"width": 1366, "height": 900},
        )
        yield context
        context.close()


@pytest.fixture(scope="module")
def chrome() -> Iterator[Any]:
    """A headless browser for all tests of a module; each makes a context of its own."""
    with driver() as (engine, path):
        running = engine.launch(executable_path=path, headless=True, args=OPTIONS)
        yield running
        running.close()


@pytest.fixture
def hand(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_port: Any
) -> Iterator[Any]:
    """Nodes of several fingers, in an empty folder."""
    from fingers_side_by_side import Hand

    monkeypatch.chdir(tmp_path)
    # The usual port belongs to whoever uses this machine.
    monkeypatch.setattr("finger_operator.page.server.USUAL_PORT", free_port())
    hand = Hand(ros_domain)
    yield hand
    hand.close()
