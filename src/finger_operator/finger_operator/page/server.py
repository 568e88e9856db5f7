"""Web server of the operator's page, on aiohttp, without ROS.

One WebSocket per browser. Cues are sent at once and never dropped; everything else is the newest of its kind, so that
a slow tablet falls behind in nothing but frame rate. What protects the rig:

- requests whose Host is not this server are refused (a foreign name that resolves here), and so are WebSockets whose
  Origin is another page;
- commands carry a token that only the operator's page contains; that page is given without further ado to this machine
  only, to others with the token in the address;
- images go to this machine only, unless `share_images`;
- messages are small JSON objects of known form; anything else is answered with a sentence and has no effect.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import secrets
import struct
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from aiohttp import WSMsgType, web

from finger_common.errors import FingerError, InputError

STATIC = Path(__file__).resolve().parent / "static"
MESSAGE_LIMIT = 16384
"""Bytes of the longest message a browser may send."""
BAD_MESSAGES = 20
"""Bad messages after which a connection is closed."""
BATCH = 0.04
"""s between batches of force samples."""

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

COMMANDS: dict[str, dict[str, type]] = {
    "start": {},
    "pause": {},
    "resume": {},
    "redo": {},
    "skip": {},
    "close": {},
    "tare": {},
    "repeat": {"index": int},
    "moisture": {"value": float},
    "preparation": {"condition": str, "text": str},
    "configure": {
        "subject": str,
        "conditions": list,
        "trials": int,
        "readings": int,
        "target_force": float,
    },
}
"""Commands of the page with the names and types of their arguments."""


@dataclass(frozen=True)
class PageSettings:
    """host, port: where to serve; port 0 takes a free one. token: empty makes one up.

    allowed_hosts: further names under which the page may be opened. share_images: images beyond this machine.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token: str = ""
    share_images: bool = False
    allowed_hosts: tuple[str, ...] = ()


@dataclass(eq=False)
class _Client:
    socket: web.WebSocketResponse
    operator: bool
    images: bool
    wants_images: bool = False
    bad: int = 0
    cues: deque[str] = field(default_factory=deque)
    newest: dict[str, str] = field(default_factory=dict)
    force: list[list[float]] = field(default_factory=list)
    points: dict[str, list[list[float]]] = field(default_factory=dict)
    image: bytes | None = None
    wake: asyncio.Event = field(default_factory=asyncio.Event)

    def add(self, batch: list[tuple[str, list[float]]]) -> None:
        """Samples and points for the plots; a browser that does not take them in time misses some."""
        for kind, value in batch:
            values = self.force if kind == "force" else self.points.setdefault(kind, [])
            if len(values) < 5000:
                values.append(value)


def is_loopback(address: str | None) -> bool:
    """Whether a peer's address is this machine."""
    try:
        peer = ipaddress.ip_address((address or "").split("%")[0])
    except ValueError:
        return False
    mapped = getattr(peer, "ipv4_mapped", None)
    return (mapped or peer).is_loopback


def check_command(message: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and checked arguments of a command; raises InputError saying what is wrong with it."""
    name = message.get("name")
    if not isinstance(name, str) or name not in COMMANDS:
        raise InputError("no such command")
    given = message.get("arguments", {})
    wanted = COMMANDS[name]
    if not isinstance(given, dict) or set(given) != set(wanted):
        raise InputError(f"command '{name}' takes the arguments {', '.join(wanted) or 'none'}")
    arguments = {}
    for key, kind in wanted.items():
        value: Any = given[key]
        if kind is float and type(value) is int:
            value = float(value)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(f"command '{name}': '{key}' is not a {kind.__name__}")
        if isinstance(value, float) and not abs(value) < 1e9:
            raise InputError(f"command '{name}': '{key}' is not a finite number")
        if isinstance(value, int) and not 0 <= value < 1_000_000:
            raise InputError(f"command '{name}': '{key}' is out of range")
        if isinstance(value, list) and not (
            0 < len(value) < 100 and all(isinstance(v, str) for v in value)
        ):
            raise InputError(f"command '{name}': '{key}' is not a list of names")
        arguments[key] = value
    return name, arguments


class PageServer:
    """Serves the page in a thread of its own.

    command: called in the server's thread with (name, arguments); returns an awaitable of (success, sentence).
    The `publish…` methods may be called from any thread.
    """

    def __init__(
        self,
        settings: PageSettings,
        command: Callable[[str, dict[str, Any]], Awaitable[tuple[bool, str]]],
    ) -> None:
        self.settings = settings
        self.token = settings.token or secrets.token_urlsafe(16)
        self.port = settings.port
        self._command = command
        self._clients: set[_Client] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._newest: dict[str, str] = {}
        self._cue_stamps: dict[int, int] = {}
        self._next_cue = 0
        self._last_cue = ""
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
        return sum(c.wants_images and c.images for c in list(self._clients))

    @property
    def latencies(self) -> list[float]:
        """s from the stamp of each cue to the browser's word that it is on the screen, newest last."""
        return list(self._latencies)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except OSError as error:
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
            if file.suffix in (".js", ".css", ".svg"):
                app.router.add_get(f"/static/{file.name}", self._static(file))
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        site = web.TCPSite(runner, self.settings.host or None, self.settings.port)
        try:
            await site.start()
            self.port = runner.addresses[0][1]
            self._started.set()
            flush = asyncio.create_task(self._flush_force())
            await self._stop.wait()
            flush.cancel()
            for client in list(self._clients):
                await client.socket.close(code=1001)
        finally:
            await runner.cleanup()

    # Guards ----------------------------------------------------------------------------------

    def _host_allowed(self, host: str | None) -> bool:
        if not host:
            return False
        try:
            parts = urlsplit(f"//{host}")
            name, port = parts.hostname or "", parts.port or 80
        except ValueError:
            return False
        if name in self.settings.allowed_hosts:
            return True
        if port != self.port:
            return False
        if name in ("localhost", self.settings.host):
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    @web.middleware
    async def _guard(self, request: web.Request, handler: Any) -> web.StreamResponse:
        if not self._host_allowed(request.headers.get("Host")):
            return web.Response(
                status=403,
                text="This name is not one the page is served under; see allowed_hosts.\n",
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

    def _token_fits(self, token: Any) -> bool:
        return isinstance(token, str) and hmac.compare_digest(token.encode(), self.token.encode())

    # Pages -----------------------------------------------------------------------------------

    async def _operator_page(self, request: web.Request) -> web.Response:
        if not is_loopback(request.remote) and not self._token_fits(request.query.get("token")):
            return web.Response(
                status=403,
                text="Open the operator's page with ?token=… as the page node's log shows it; "
                "/participant needs no token.\n",
            )
        text = (STATIC / "index.html").read_text(encoding="utf-8").replace("{{token}}", self.token)
        return web.Response(text=text, content_type="text/html")

    async def _participant_page(self, request: web.Request) -> web.Response:
        text = (STATIC / "participant.html").read_text(encoding="utf-8")
        return web.Response(text=text, content_type="text/html")

    def _static(self, file: Path) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
        types = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}

        async def answer(request: web.Request) -> web.Response:
            return web.Response(
                text=file.read_text(encoding="utf-8"), content_type=types[file.suffix]
            )

        return answer

    # The socket ------------------------------------------------------------------------------

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        scheme, _, origin = request.headers.get("Origin", "").partition("://")
        if scheme not in ("http", "https") or origin != request.headers.get("Host"):
            return web.Response(status=403, text="Only the page itself may connect.\n")
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=MESSAGE_LIMIT, compress=False)
        await socket.prepare(request)
        operator = request.query.get("view") != "participant"
        local = is_loopback(request.remote)
        client = _Client(socket, operator, operator and (local or self.settings.share_images))
        client.newest["hello"] = json.dumps({"type": "hello", "images": client.images})
        if operator:
            client.newest.update(self._newest)
        if self._last_cue:
            client.cues.append(self._last_cue)
        client.wake.set()
        self._clients.add(client)
        sender = asyncio.create_task(self._send(client))
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    await self._receive(client, message.data)
                elif message.type == WSMsgType.BINARY:
                    self._complain(client, "messages must be text")
                if client.bad >= BAD_MESSAGES:
                    await socket.close(code=1008, message=b"too many bad messages")
        finally:
            self._clients.discard(client)
            sender.cancel()
        return socket

    def _complain(self, client: _Client, sentence: str, number: Any = None) -> None:
        client.bad += 1
        self._answer(client, number, False, sentence)

    def _answer(self, client: _Client, number: Any, success: bool, sentence: str) -> None:
        number = number if isinstance(number, int) else None
        answer = {"type": "answer", "id": number, "success": success, "message": sentence}
        client.cues.append(json.dumps(answer))
        client.wake.set()

    async def _receive(self, client: _Client, text: str) -> None:
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            self._complain(client, "the message is not JSON")
            return
        if not isinstance(message, dict):
            self._complain(client, "the message is not an object")
            return
        kind, number = message.get("type"), message.get("id")
        if kind == "shown" and isinstance(number, int):
            stamp = self._cue_stamps.get(number)
            if stamp is not None and client.operator:
                self._latencies.append(time.time() - stamp * 1e-9)
        elif kind == "watch" and isinstance(message.get("images"), bool):
            client.wants_images = message["images"] and client.images
        elif kind == "command":
            if not client.operator or not self._token_fits(message.get("token")):
                self._complain(client, "this page may not command the rig; open it anew", number)
                return
            try:
                name, arguments = check_command(message)
            except InputError as error:
                self._complain(client, str(error), number)
                return
            task = asyncio.create_task(self._carry_out(client, number, name, arguments))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            self._complain(client, "the message is of no known type", number)

    async def _carry_out(
        self, client: _Client, number: Any, name: str, arguments: dict[str, Any]
    ) -> None:
        try:
            success, sentence = await asyncio.wait_for(self._command(name, arguments), 10.0)
        except asyncio.TimeoutError:
            success, sentence = (
                False,
                f"{name}: no answer within 10 s; see the state of the devices",
            )
        except FingerError as error:
            success, sentence = False, str(error)
        self._answer(client, number, success, sentence)

    async def _send(self, client: _Client) -> None:
        """Cues first, then the newest of everything; one writer per socket."""
        socket = client.socket
        try:
            while not socket.closed:
                await client.wake.wait()
                client.wake.clear()
                while client.cues:
                    await socket.send_str(client.cues.popleft())
                newest, client.newest = client.newest, {}
                for text in newest.values():
                    await socket.send_str(text)
                    while client.cues:
                        await socket.send_str(client.cues.popleft())
                if client.force:
                    force, client.force = client.force, []
                    await socket.send_str(json.dumps({"type": "force", "samples": force}))
                if client.points:
                    points, client.points = client.points, {}
                    await socket.send_str(json.dumps({"type": "points", **points}))
                while client.cues:
                    await socket.send_str(client.cues.popleft())
                if client.image is not None:
                    image, client.image = client.image, None
                    await socket.send_bytes(image)
        except (ConnectionError, RuntimeError):
            # The browser went away in the middle of a message; the reader notices and cleans up.
            pass

    async def _flush_force(self) -> None:
        """Hand on what has gathered: a call into this thread for each sample would cost the cue its turn."""
        while True:
            await asyncio.sleep(BATCH)
            batch = []
            while self._curve:
                batch.append(self._curve.popleft())
            for client in self._clients:
                if batch and client.operator:
                    client.add(batch)
                    client.wake.set()

    # What the node publishes -----------------------------------------------------------------

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        loop = self._loop
        if loop is not None and not loop.is_closed():
            try:
                loop.call_soon_threadsafe(function, *arguments)
            except RuntimeError:
                pass  # the loop ended in between

    def publish(self, kind: str, data: Mapping[str, Any]) -> None:
        """State of some kind for all operators; only the newest counts, later browsers receive it too."""
        self._call(self._publish, kind, json.dumps({"type": kind, **data}))

    def _publish(self, kind: str, text: str) -> None:
        self._newest[kind] = text
        for client in self._clients:
            if client.operator:
                client.newest[kind] = text
                client.wake.set()

    def publish_cue(self, stamp_ns: int, data: Mapping[str, Any]) -> None:
        """A cue for everybody, at once. stamp_ns: of the sample that caused it."""
        self._call(self._publish_cue, stamp_ns, dict(data))

    def _publish_cue(self, stamp_ns: int, data: dict[str, Any]) -> None:
        number = self._next_cue
        self._next_cue += 1
        self._cue_stamps[number] = stamp_ns
        self._cue_stamps.pop(number - 100, None)
        text = json.dumps({"type": "cue", "id": number, **data})
        for client in self._clients:
            client.cues.append(text)
            client.wake.set()
        # A browser that connects later shows the cue, but its delay says nothing.
        self._last_cue = json.dumps({"type": "cue", "id": -1, **data})

    def publish_force(self, time_s: float, force: float) -> None:
        """A force sample (s, N) for the live curve."""
        self._curve.append(("force", [round(time_s, 4), round(force, 4)]))

    def publish_point(self, kind: str, point: list[float]) -> None:
        """A pair [force N, area mm²], `kind` "measured" or "model"."""
        self._curve.append((kind, point))

    def publish_image(self, jpeg: bytes, stamp_ns: int) -> None:
        """A picture for those who watch and may."""
        self._call(self._publish_image, struct.pack("<q", stamp_ns) + jpeg)

    def _publish_image(self, data: bytes) -> None:
        for client in self._clients:
            if client.images and client.wants_images:
                client.image = data
                client.wake.set()
