"""The page's server with a stand-in for the node behind it: made-up values, no ROS."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections import deque
from contextlib import suppress
from typing import Any

import cv2
import numpy as np

from finger_operator.page.commands import COMMANDS
from finger_operator.page.feed import CurveMemory
from finger_operator.page.server import PageServer
from finger_operator.page.settings import PageSettings
from finger_operator.readiness import Problem
from finger_operator.study_plan import CLEAN_PLATE, PREPARATIONS, PlanSettings

TARE_NEEDED = Problem("tare", "Tare needed.", "Take the finger off the plate, then press Tare (T).")

CLOSED = {
    "step": "closed",
    "instruction": "Press Space to start a session.",
    "plan": {**PlanSettings().to_dict(), "subject": "S01"},
    "preparations": PREPARATIONS,
    "used_subjects": {"S01": ["S01_20261120T101500"]},
    "disk": {"free_gb": 34.5},
}


def trial(index: int, condition: str, verdict: str = "pending", **fields: Any) -> dict[str, Any]:
    """A row of the list of trials."""
    row = {
        "index": index, "condition": condition, "verdict": verdict, "attempts": 0, "reason": "",
        "time_to_target": None, "peak_force": None, "notes": [], "markers": [],
    }  # fmt: skip
    return {**row, **fields}


def session(step: str, **fields: Any) -> dict[str, Any]:
    """A status in the middle of a session."""
    kept = {"attempts": 1, "time_to_target": 0.83, "peak_force": 1.52}
    conditions = ("dry", "natural")
    trials = [trial(i, conditions[i // 3]) for i in range(6)]
    trials[0].update(verdict="done", **{**kept, "attempts": 2})
    trials[1].update(verdict="skipped")
    trials[2].update(
        attempts=1,
        reason="lifted at 0.94 N, before the target of 1.35 N",
        notes=[{"time": time.time(), "text": "finger slipped", "attempt": 0}],
    )
    events = [
        {"time": 1795368000.0 + 7.3 * i, "text": text, "kind": kind, "index": 2, "attempt": 0}
        for i, (kind, text) in enumerate(
            [
                ("session", "session begun"), ("step", "prepare"), ("kept", "trial 1 kept"),
                ("failed", "lifted at 0.94 N, before the target of 1.35 N"),
                ("note", "finger slipped"), ("fault", "camera: no image for 1.0 s"),
            ]
        )
    ]  # fmt: skip
    status = {
        "subject": "S01", "session": "S01_20261122T101500", "step": step, "paused": False,
        "ended": "", "message": "", "instruction": "", "waiting_for": "", "index": 2, "attempt": 1,
        "condition": "dry", "preparation": PREPARATIONS["dry"], "preparations": PREPARATIONS,
        "prompt": CLEAN_PLATE, "target_force": 1.35, "readings": 3,
        "moisture_before": [35.5, 36.0], "moisture_after": [], "recording": "on",
        "conditions": list(conditions), "folder": "/data", "trials": trials, "notes": [],
        "markers": [], "events": events, "warnings": [], "time_left": 540.0,
        "disk": {"free_gb": 34.5, "needed_gb": 1.2, "trials_left": 150, "enough": True},
        "summary": {}, "plan": PlanSettings().to_dict(),
    }  # fmt: skip
    return {**status, **fields}


TEXTURE = np.random.default_rng(1).integers(60, 120, (512, 640, 3), dtype=np.uint8)


def picture(area: float, textured: bool = False) -> bytes:
    """JPEG of a made-up contact (mm²); textured: with as many bytes as a picture can have."""
    image = TEXTURE.copy() if textured else np.full((512, 640, 3), 90, np.uint8)
    radius = round(12 * math.sqrt(max(area, 0.0) / math.pi))
    if radius:
        cv2.ellipse(image, (330, 250), (radius, round(radius * 1.3)), 0, 0, 360, (190,) * 3, -1)
        cv2.ellipse(image, (330, 250), (radius, round(radius * 1.3)), 0, 0, 360, (0, 200, 0), 2)
    return cv2.imencode(".jpg", image)[1].tobytes()


class ForwardedPort:
    """A port that is forwarded to another one of this machine, as by ssh, over a slow link.

    rate: bytes/s towards the browser. bytes: how many went there. dead: nothing comes through, and
    nobody is told. connections: made so far.
    """

    def __init__(self, port: int, rate: float) -> None:
        self._to, self._rate = port, rate
        self.bytes = self.connections = 0
        self.dead = False
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)

    def __enter__(self) -> ForwardedPort:
        self._thread.start()
        assert self._ready.wait(60)
        return self

    def __exit__(self, *_: Any) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(5)

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self._free_at = 0.0
        server = await asyncio.start_server(self._forward, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        await self._end.wait()
        server.close()

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        source, sink = await asyncio.open_connection("127.0.0.1", self._to, limit=4096)
        both = (self._copy(reader, sink, None), self._copy(source, writer, self._rate))
        with suppress(asyncio.CancelledError):  # when all ends
            await asyncio.gather(*both, return_exceptions=True)

    async def _copy(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, rate: float | None
    ) -> None:
        try:
            while data := await reader.read(1024):
                while self.dead:
                    await asyncio.sleep(0.02)
                if rate is not None:  # one link for all connections
                    self._free_at = max(self._free_at, self._loop.time()) + len(data) / rate
                    await asyncio.sleep(self._free_at - self._loop.time())
                    self.bytes += len(data)
                writer.write(data)
                await writer.drain()
        finally:
            writer.close()


class StandIn:
    """A page server fed with presses of 3 s, one every 6 s, until `stop`.

    `problems`, `tared`, `probe`, `estimate` and the measured `area` (mm²; None: that of the
    presses) may be changed; with `silent` nothing is sent.
    """

    def __init__(self, port: int = 0, **settings: Any) -> None:
        self.commands: deque[tuple[str, dict[str, Any]]] = deque()
        self.answers: dict[str, tuple[bool, str]] = {}
        self.problems: list[Problem] = []
        self.gone: set[str] = set()
        self.tared = True
        self.probe = ""
        self.estimate = {"known": True, "doubt": ""}
        self.area: float | None = None
        self.silent = False
        self.textured = False
        self.health = [
            {"name": f"finger/{n}: {n}", "level": 0, "message": "active",
             "values": {"measured_rate_hz": "10.0", "samples": "120"}}
            for n in ("camera", "force", "model", "moisture", "protocol", "recorder", "vision")
        ]  # fmt: skip
        self.curves = CurveMemory()
        self._lock = threading.Lock()
        self.server = PageServer(PageSettings(port=port, **settings), self._command)
        self._end = threading.Event()
        self._last: dict[str, float] = {}
        self._thread = threading.Thread(target=self._feed, daemon=True)

    def __enter__(self) -> StandIn:
        self.server.start()
        self.server.publish("status", CLOSED)
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._end.set()
        self._thread.join(5)
        self.server.stop()

    async def _command(self, name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
        if name == "curves":
            with self._lock:
                curves = self.curves.snapshot()
            self.server.publish("curves", curves)
            return True, ""
        if name in ("order", "new_conditions"):
            return True, COMMANDS[name].answer(arguments, CLOSED)
        self.commands.append((name, arguments))
        return self.answers.get(name, (True, f"did {name}"))

    def status(self, **status: Any) -> None:
        """Show a status."""
        self.server.publish("status", status)

    def cue(self, phase: str, **fields: Any) -> None:
        """Show a cue."""
        now = time.time_ns()
        self.server.publish_cue(now, {"phase": phase, "index": 2, "time": now * 1e-9, **fields})
        with self._lock:
            if phase == "press":
                self.curves.press_begins(2, now * 1e-9)
            elif phase != "lift":
                self.curves.press_ends(now * 1e-9)

    def _draw(self, kind: str, point: list[Any]) -> None:
        with self._lock:
            self.curves.add(kind, point)
        self.server.publish_point(kind, point)

    def _feed(self) -> None:
        step = 0
        while not self._end.wait(0.02):
            step += 1
            if self.silent:
                continue
            now = time.time()
            in_press = now % 6.0
            force = 1.5 * math.sin(math.pi * in_press / 3.0) if in_press < 3.0 else 0.0
            area = 46.0 * force**0.67 * (1.0 if in_press < 1.5 else 1.08)
            if "force" not in self.gone:
                self._last["force"] = now
                self._draw("force", [round(now, 3), round(force, 4)])
            if step % 2 == 0 and "model" not in self.gone:
                self._last["model"] = now
                self.server.publish("estimate", {"contact": force > 0.02, **self.estimate})
                if force > 0.02:
                    point = [now, force, area, 1.2, 0.9 * force, 20 + 6 * force, 40 + 12 * force]
                    self._draw("model", point)
            if step % 5 == 0 and "area" not in self.gone:
                self._last["area"] = now
                if force > 0.02:
                    self._draw("measured", [now, force, area + math.sin(7 * now)])
                shown = round(area, 2) if self.area is None else self.area
                contact = {"area": shown, "doubt": "clipped" if force > 1.45 else ""}
                self.server.publish("contact", contact)
                self.server.publish_image(picture(area, self.textured), int(now * 1e9))
            if step % 10 == 0:
                ages = {k: now - self._last[k] if k in self._last else None
                        for k in ("force", "area", "model")}  # fmt: skip
                problems = [vars(problem) for problem in self.problems]
                alive = {"time": now, "ages": ages, "tared": self.tared, "problems": problems,
                         "probe": self.probe}  # fmt: skip
                self.server.publish("alive", alive)
            if step % 25 == 0:
                self.server.publish("health", {"items": self.health})
