"""What is checked of the page's looks: sizes, overflow, axe."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

SIZES = ((1920, 1080), (1366, 768), (1280, 800), (1024, 768), (390, 844))
"""Pixels; 1024 × 768 is a tablet with touch, 390 × 844 a phone."""

OVERFLOW = """() => {
  const root = document.documentElement;
  const found = root.scrollWidth > root.clientWidth ? ["the page scrolls sideways"] : [];
  for (const e of document.querySelectorAll("button, p, h2, section, output, input, li")) {
    const box = e.getBoundingClientRect();
    if (box.width && !e.closest(".unseen, dialog") && box.right > innerWidth + 1) {
      found.push(`${e.id || e.tagName} beyond the right edge`);
    }
    if (e.tagName === "BUTTON" && e.scrollWidth > e.clientWidth + 1) found.push(`${e.id} cut`);
  }
  for (const e of document.querySelectorAll(".legend, #left, .scroll")) {
    if (e.scrollWidth > e.clientWidth + 1) found.push(`${e.parentElement.textContent} cut`);
  }
  for (const e of document.querySelectorAll("#controls, #moisture, #cue")) {
    if (e.scrollHeight > e.clientHeight + 1) found.push(`${e.id} does not fit`);
  }
  if (innerWidth >= 1024) for (const id of ["tare", "start", "end", "moisture-input"]) {
    const box = document.getElementById(id).getBoundingClientRect();
    if (box.bottom > innerHeight) found.push(`${id} is below the fold`);
  }
  return found;
}"""


def shots(project_root: Path) -> Path:
    """Folder of the pictures of the page: out/page, or as PAGE_SHOTS says."""
    folder = Path(os.environ.get("PAGE_SHOTS", project_root / "out" / "page"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def violations(page: Any) -> list[tuple[str, list[Any]]]:
    """What axe finds."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    found = axe.run(page).response["violations"]
    return [(v["id"], [node["target"] for node in v["nodes"]]) for v in found]
