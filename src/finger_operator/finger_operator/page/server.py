# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Web server of the operator's page, on aiohttp, without ROS. One WebSocket per browser.

What protects the rig:

- requests whose Host is not this server are refused (a foreign name that resolves here), and so
  are WebSockets whose Origin is another page;
- the operator's page is for this machine, and for others that name the token; a proxy or forwarded
  port counts as another machine;
- the operator's WebSocket and each command carry the token, which only that page contains;
- a connection without a complete request, and a browser that does not read or does not confirm what
  it got, are closed after a while; there is a limit of connections;
- images go to this machine only, not through a forwarded port either, unless `share_images`;
- messages are small JSON objects of known form; any other is answered with a sentence and has no
  effect.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import struct
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError

from finger_common.errors import FingerError, InputError
from finger_common.moisture import MOISTURE_RANGE
from finger_common.namespaces import DEFAULT_NAMESPACE, own_name
from finger_common.stamps import seconds

from ..study_plan import PlanSettings
from .access import from_this_machine, host_allowed, same_secret
from .browser import Browser
from .commands import check_command
from .settings import USUAL_PORT, PageSettings

STATIC = Path(__file__).resolve().parent / "static"
MESSAGE_LIMIT = 16384
"""Bytes of the longest message a browser may send."""
BAD_MESSAGES = 20
"""Bad messages after which a connection is closed."""
PATIENCE = 10.0
"""s for a request to be complete and for what is sent to be read."""
CARRIED_OUT = 10.0
"""s for a command to be carried out; what became of it is unknown after them."""
CONNECTIONS = 100
"""Connections at a time; further ones are closed at once."""
BATCH = 0.04
"""s between batches of force samples."""
MEDIA_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}

_LOGGER = logging.getLogger(__name__)
# What is no HTTP is answered with 400; it is no defect of the server that a traceback would help.
_LOGGER.addFilter(lambda r: not (r.exc_info and isinstance(r.exc_info[1], HttpProcessingError)))

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

BEAT = json.dumps({"type": "beat"})
"""What participants hear with each `alive` of the operators: one who hears nothing sees no cue."""

NO_CUE = json.dumps({"type": "cue", "id": -1, "phase": "idle"})
"""What participants see while there is no cue."""


def to_json(message: Mapping[str, Any]) -> str:
    """A number that is not finite becomes null: JSON has none, and a browser drops the message."""
    try:
        return json.dumps(message, allow_nan=False)
    except ValueError:
        known = json.loads(json.dumps(message), parse_constant=lambda name: None)
        return json.dumps(known)


def operator_page(token: str, finger: str = "") -> str:
    """The operator's page, its inputs limited as the parameters that they set.

    finger: name in the title, "" for none.
    """
    text = (STATIC / "index.html").read_text(encoding="utf-8")
    low, high = MOISTURE_RANGE
    facts: dict[str, Any] = {"token": token, "moisture.minimum": low, "moisture.maximum": high}
    facts["title"] = f"Finger rig {finger}".rstrip()
    for parameter in PlanSettings.parameters():
        facts[f"{parameter.name}.minimum"] = parameter.minimum
        facts[f"{parameter.name}.maximum"] = parameter.maximum
    for name, value in facts.items():
        shown = f"{value:g}" if isinstance(value, (int, float)) else str(value)
        text = text.replace("{{" + name + "}}", shown)
    return text


class PageServer:
    """Serves the page in a thread of its own.

    command: called in the server's thread with (name, arguments); returns an awaitable of (success,
    sentence). now: time (ns) on the clock that stamps samples, called there too. namespace: of the
    finger, for the title. The `publish…` methods may be called from any thread.
    """

    def __init__(
        self,
        settings: PageSettings,
        command: Callable[[str, dict[str, Any]], Awaitable[tuple[bool, str]]],
        now: Callable[[], int] = time.time_ns,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        self.settings = settings
        self.token = settings.token or secrets.token_urlsafe(16)
        self.port = settings.port
        self._command = command
        self._now = now
        self._finger = own_name(namespace, "/")
        self._allowed = {name for name in settings.allowed_hosts if name}
        self._browsers: set[Browser] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._streaming: set[Any] = set()
        self._newest: dict[str, str] = {}
        self._cue_stamps: dict[int, int] = {}
        self._next_cue = 0
        self._last_cue = ""
        self._held = False
        self._latencies: deque[float] = deque(maxlen=1000)
        self._curve: deque[tuple[str, list[float]]] = deque(maxlen=5000)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._stop: asyncio.Event | None = None
        self._started = threading.Event()
        self._error: BaseException | None = None

    # Life ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to serve; raises InputError when the address cannot be used."""
        self._started.clear()
        self._error = None
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        self._started.wait(15)
        if self._error is not None:
            where = f"{self.settings.host}:{self.settings.port}"
            raise InputError(
                f"the page cannot be served on {where} ({self._error}); choose another host or port"
            )

    def stop(self) -> None:
        """Close all connections and end the thread."""
        if self._loop is not None and self._stop is not None and self._loop.is_running():
            self._loop.call_soon_threadsafe(self._stop.set)
        if self._thread is not None:
            self._thread.join(5)

    @property
    def url(self) -> str:
        """Address of the operator's page on this machine."""
        host = self.settings.host
        host = "127.0.0.1" if host in ("0.0.0.0", "::", "") else host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/"

    @property
    def watchers(self) -> int:
        """Browsers that want images and may have them."""
        return sum(b.wants_images and b.images for b in list(self._browsers))

    @property
    def latencies(self) -> list[float]:
        """s from the stamp of each cue until the browser had it on the screen, newest last."""
        return list(self._latencies)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except (OSError, ValueError) as error:  # ValueError: of a name that is no host
            self._error = error
        finally:
            self._started.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._stop = asyncio.Event()
        app = web.Application(middlewares=[self._guard], client_max_size=MESSAGE_LIMIT)
        app.router.add_get("/", self._operator_page)
        app.router.add_get("/participant", self._participant_page)
        app.router.add_get("/ws", self._socket)
        for file in sorted(STATIC.iterdir()):
            if file.suffix in MEDIA_TYPES:
                app.router.add_get(f"/static/{file.name}", self._static(file))
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0, logger=_LOGGER)
        await runner.setup()
        try:
            await self._listen(runner)
            self.port = runner.addresses[0][1]
            self._started.set()
            tasks = [
                asyncio.create_task(self._flush_force()),
                asyncio.create_task(self._close_idle(runner)),
            ]
            await self._stop.wait()
            for task in tasks:
                task.cancel()
            for browser in list(self._browsers):
                await browser.socket.close(code=1001)
        finally:
            await runner.cleanup()

    async def _listen(self, runner: web.AppRunner) -> None:
        """On the port of the settings, or else on the usual one, or else on a free one."""
        wanted = self.settings.port
        for port in [wanted] if wanted else [USUAL_PORT, 0]:
            try:
                await web.TCPSite(runner, self.settings.host or None, port).start()
                return
            except OSError:
                if port == wanted:
                    raise

    # Guards ----------------------------------------------------------------------------------

    @web.middleware
    async def _guard(self, request: web.Request, handler: Any) -> web.StreamResponse:
        header = request.headers.get("Host")
        if not host_allowed(header, self.settings.host, self._allowed):
            return web.Response(
                status=403,
                text="The page is not served under this name; see allowed_hosts.\n",
                headers=HEADERS,
            )
        try:
            response = await handler(request)
        except web.HTTPException as error:
            error.headers.update(HEADERS)
            raise
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    def _has_token(self, request: web.Request) -> bool:
        return same_secret(request.query.get("token"), self.token)

    async def _close_idle(self, runner: web.AppRunner) -> None:
        """Close connections that make no progress: half a request, an answer that is not read."""
        since: dict[Any, float] = {}
        while True:
            await asyncio.sleep(min(PATIENCE / 4, 1.0))
            now, patience = time.monotonic(), PATIENCE
            transports = [c.transport for c in runner.server.connections if c.transport is not None]  # type: ignore[union-attr]
            since = {t: since.get(t, now) for t in transports if t not in self._streaming}
            surplus = sorted(since, key=lambda t: since[t])[: max(0, len(transports) - CONNECTIONS)]
            for transport, begun in since.items():
                if now - begun > patience or transport in surplus:
                    transport.abort()
            for browser in list(self._browsers):
                if browser.stuck(now - patience):
                    browser.drop()

    # Pages -----------------------------------------------------------------------------------

    async def _operator_page(self, request: web.Request) -> web.Response:
        local = from_this_machine(request.remote, self.port, request.headers)
        if not (local or self._has_token(request)):
            return web.Response(
                status=403,
                text="From another machine or port the operator's page needs ?token=… behind its "
                "address, as the page node's log shows it; /participant needs no token.\n",
            )
        return web.Response(text=operator_page(self.token, self._finger), content_type="text/html")

    async def _participant_page(self, request: web.Request) -> web.Response:
        text = (STATIC / "participant.html").read_text(encoding="utf-8")
        return web.Response(text=text, content_type="text/html")

    def _static(self, file: Path) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
        async def answer(request: web.Request) -> web.Response:
            return web.Response(
                text=file.read_text(encoding="utf-8"), content_type=MEDIA_TYPES[file.suffix]
            )

        return answer

    # The socket ------------------------------------------------------------------------------

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        scheme, _, origin = request.headers.get("Origin", "").partition("://")
        if scheme not in ("http", "https") or origin != request.headers.get("Host"):
            return web.Response(status=403, text="Only the page itself may connect.\n")
        operator = request.query.get("view") != "participant"
        if operator and not self._has_token(request):
            return web.Response(status=403, text="The operator's view needs the token.\n")
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=MESSAGE_LIMIT, compress=False)
        await socket.prepare(request)
        local = from_this_machine(request.remote, self.port, request.headers)
        browser = Browser(socket, operator, operator and (local or self.settings.share_images))
        browser.add_state("hello", json.dumps({"type": "hello", "images": browser.images}))
        if operator:
            browser.newest.update(self._newest)
        if self._last_cue:
            browser.add_cue(NO_CUE if self._held and not operator else self._last_cue)
        transport = request.transport
        browser.transport = transport
        self._browsers.add(browser)
        self._streaming.add(transport)
        sender = asyncio.create_task(browser.send())
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    await self._receive(browser, message.data)
                elif message.type == WSMsgType.BINARY:
                    browser.complain("messages must be text")
                if browser.bad_messages >= BAD_MESSAGES:
                    await socket.close(code=1008, message=b"too many bad messages")
        finally:
            self._browsers.discard(browser)
            self._streaming.discard(transport)
            sender.cancel()
        return socket

    async def _receive(self, browser: Browser, text: str) -> None:
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            browser.complain("the message is not JSON")
            return
        if not isinstance(message, dict):
            browser.complain("the message is not an object")
            return
        kind, number = message.get("type"), message.get("id")
        if kind == "shown" and isinstance(number, int):
            stamp = self._cue_stamps.get(number)
            if stamp is not None and browser.operator:
                self._latencies.append(seconds(self._now() - stamp))
        elif kind == "got" and isinstance(number, int):
            browser.confirm(number)
        elif kind == "watch" and isinstance(message.get("images"), bool):
            browser.wants_images = message["images"] and browser.images
        elif kind == "command":
            if not browser.operator or not same_secret(message.get("token"), self.token):
                browser.complain("this page may not command the rig; reload it", number)
                return
            try:
                name, arguments = check_command(message)
            except InputError as error:
                browser.complain(str(error), number)
                return
            task = asyncio.create_task(self._carry_out(browser, number, name, arguments))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            browser.complain("the message is of no known type", number)

    async def _carry_out(
        self, browser: Browser, number: Any, name: str, arguments: dict[str, Any]
    ) -> None:
        unknown = False
        try:
            carried_out = self._command(name, arguments)
            success, sentence = await asyncio.wait_for(carried_out, CARRIED_OUT)
        except asyncio.TimeoutError:
            success, unknown = False, True
            within = f"no answer within {CARRIED_OUT:g} s"
            sentence = f"{name}: {within}; check the state of the devices"
        except FingerError as error:
            success, sentence = False, str(error)
        browser.answer(number, success, sentence, unknown)

    async def _flush_force(self) -> None:
        """Hand on samples in batches: a call per sample into this thread would delay the cue."""
        while True:
            await asyncio.sleep(BATCH)
            batch = []
            while self._curve:
                batch.append(self._curve.popleft())
            for browser in self._browsers:
                if batch and browser.operator:
                    browser.add_points(batch)

    # What the node publishes -----------------------------------------------------------------

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        loop = self._loop
        if loop is not None and not loop.is_closed():
            try:
                loop.call_soon_threadsafe(function, *arguments)
            except RuntimeError:
                pass  # the loop ended in between

    def publish(self, kind: str, data: Mapping[str, Any]) -> None:
        """State of some kind for all operators, also for browsers that connect later."""
        self._call(self._publish, kind, to_json({"type": kind, **data}))

    def _publish(self, kind: str, text: str) -> None:
        self._newest[kind] = text
        for browser in self._browsers:
            if browser.operator:
                browser.add_state(kind, text)
            elif kind == "alive":
                browser.add_state("beat", BEAT)

    def publish_cue(self, stamp_ns: int, data: Mapping[str, Any]) -> None:
        """A cue for every browser, at once. stamp_ns: of the sample that caused it."""
        self._call(self._publish_cue, stamp_ns, dict(data))

    def _publish_cue(self, stamp_ns: int, data: dict[str, Any]) -> None:
        number = self._next_cue
        self._next_cue += 1
        self._cue_stamps[number] = stamp_ns
        self._cue_stamps.pop(number - 100, None)
        text = json.dumps({"type": "cue", "id": number, **data})
        for browser in self._browsers:
            browser.add_cue(text)
        # A browser that connects later shows the cue; its delay is not measured.
        self._last_cue = json.dumps({"type": "cue", "id": -1, **data})
        self._held = False

    def hold_cue(self, held: bool) -> None:
        """Whether participants are told to wait, because what gave the cue is silent.

        The cue stands there again when it is held no longer. Operators see more, and why.
        """
        self._call(self._hold_cue, held)

    def _hold_cue(self, held: bool) -> None:
        if held == self._held or not self._last_cue:
            return
        self._held = held
        for browser in self._browsers:
            if not browser.operator:
                browser.add_cue(NO_CUE if held else self._last_cue)

    def publish_point(self, kind: str, point: list[Any]) -> None:
        """A point of the curve `kind` ("force", "measured" or "model"), beginning with its time."""
        self._curve.append((kind, point))

    def publish_image(self, jpeg: bytes, stamp_ns: int) -> None:
        """An image for the browsers that want it and may have it."""
        self._call(self._publish_image, struct.pack("<q", stamp_ns), jpeg)

    def _publish_image(self, head: bytes, jpeg: bytes) -> None:
        for browser in self._browsers:
            if browser.images and browser.wants_images:
                browser.add_image(head, jpeg)
