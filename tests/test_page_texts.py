"""Texts that people type are shown as text by the page, in a real browser."""

from __future__ import annotations

import time
from typing import Any

import pytest

from finger_operator.page.server import PageServer
from finger_operator.page.settings import PageSettings
from finger_operator.study_plan import PlanSettings

EVIL = '<img src=x onerror="window.evil=1"><script>window.evil=1</script><b id="evil">'


@pytest.mark.parametrize("path", ["/", "/participant"])
def test_texts_are_shown_as_text(browser: Any, path: str) -> None:
    async def command(name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
        return False, EVIL + name

    server = PageServer(PageSettings(port=0), command)
    server.start()
    page = browser.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    trial = {
        "index": 0, "condition": EVIL, "verdict": "pending", "attempts": 1, "reason": EVIL,
        "time_to_target": None, "peak_force": None, "notes": [], "markers": [],
    }  # fmt: skip
    status = {
        "step": "prepare", "instruction": EVIL, "session": EVIL, "subject": EVIL, "index": 0,
        "plan": {**PlanSettings().to_dict(), "subject": EVIL, "conditions": [EVIL]},
        "preparations": {EVIL: EVIL}, "trials": [trial], "condition": EVIL, "readings": [],
        "message": EVIL, "reason": EVIL, "notes": [], "events": [],
    }  # fmt: skip
    item = {"name": EVIL, "level": 2, "message": EVIL, "values": {EVIL: EVIL}, "age": 0.1}
    try:
        page.goto(server.url.rstrip("/") + path)
        page.wait_for_function("document.readyState === 'complete'")
        for _ in range(3):
            server.publish("status", status)
            server.publish("health", {"items": [item]})
            server.publish_cue(time.time_ns(), {"phase": "invalid", "index": 0, "note": EVIL})
            page.wait_for_timeout(300)
        if path == "/":
            assert "<img src=x" in page.inner_text("body")
        assert page.evaluate("window.evil") is None
        assert page.query_selector("#evil, img[src=x]") is None
    finally:
        page.close()
        server.stop()
