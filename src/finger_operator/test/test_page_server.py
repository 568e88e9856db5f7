# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The page's server over real sockets: who may see what, who may command, what bad messages do."""

from __future__ import annotations

import asyncio
import json
import random
import time
from collections.abc import Iterator
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest
from served_page import Served, next_of, received, run, served_all

from finger_common.errors import InputError
from finger_common.flags import AreaFlag, StateFlag
from finger_operator.page.access import is_loopback
from finger_operator.page.browser import IMAGE_BYTES, READABLE, Browser, smaller_image
from finger_operator.page.commands import COMMANDS, SEEN, check_command, stale
from finger_operator.page.feed import (
    AREA_DOUBTS,
    ESTIMATE_DOUBTS,
    CurveMemory,
    ForceMemory,
    HealthBoard,
    doubt,
    estimate_point,
    measured_point,
)
from finger_operator.page.server import PageServer
from finger_operator.page.settings import PageSettings


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.server.stop()


def test_operator_page_carries_the_token_and_loads_nothing_from_elsewhere(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with session.get(served.url()) as page:
            text = await page.text()
            assert page.status == 200 and served.server.token in text
            assert "frame-ancestors 'none'" in page.headers["Content-Security-Policy"]
            assert "default-src 'self'" in page.headers["Content-Security-Policy"]
        for name in ("app.js", "cue.js", "charts.js", "uplot.min.js", "style.css", "icon.svg"):
            async with session.get(served.url(f"/static/{name}")) as file:
                assert file.status == 200
                source = await file.text()
                # Names, not addresses that are loaded.
                for name in ("http://www.w3.org/2000/svg", "https://github.com/leeoniya/uPlot"):
                    source = source.replace(name, "")
                text += source
        assert "http://" not in text and "https://" not in text
        async with session.get(served.url("/participant")) as page:
            assert served.server.token not in await page.text()
        for path in ("/static/../server.py", "/static/index.html", "/etc/passwd"):
            async with session.get(served.url(path)) as missing:
                assert missing.status == 404

    run(body)


@pytest.mark.parametrize(
    ("namespace", "title"), [("/finger", "Finger rig"), ("/hand/thumb", "Finger rig hand/thumb")]
)
def test_the_title_tells_the_pages_of_fingers_apart(namespace: str, title: str) -> None:
    served = Served(namespace=namespace)

    async def body(session: aiohttp.ClientSession) -> None:
        async with session.get(served.url()) as page:
            text = await page.text()
            assert f"<title>{title}</title>" in text and f"<h1>{title}</h1>" in text

    try:
        run(body)
    finally:
        served.server.stop()


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "", "[", ":{port}"])
def test_requests_under_a_foreign_name_are_refused(served: Served, host: str) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        headers = {"Host": host.format(port=served.server.port)}
        async with session.get(served.url(), headers=headers) as page:
            assert page.status in (400, 403)
            assert served.server.token not in await page.text()

    run(body)


@pytest.mark.parametrize("host", ["localhost:9000", "127.0.0.1:1", "[::1]:9000"])
def test_a_forwarded_port_needs_the_right_token(served: Served, host: str) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        headers = {"Host": host, "Origin": f"http://{host}"}
        for query, status in (("", 403), ("?token=x", 403), (f"?token={served.server.token}", 200)):
            async with session.get(served.url(f"/{query}"), headers=headers) as page:
                assert page.status == status
                assert (served.server.token in await page.text()) is (status == 200)
        address = served.url(f"/ws?token={served.server.token}")
        async with session.ws_connect(address, headers=headers) as socket:
            await next_of(socket, "hello")
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            await session.ws_connect(served.url("/ws"), headers=headers)

    run(body)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "", "http://127.0.0.1:1", "file://{host}"]
)
def test_other_origins_cannot_connect(served: Served, origin: str) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        headers = {"Origin": origin.format(host=served.host)} if origin else {}
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(served.url("/ws"), headers=headers)
        assert refused.value.status == 403

    run(body)


def test_command_with_the_token_is_carried_out_and_answered(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as socket:
            base = {"type": "command", "token": served.server.token}
            await socket.send_json({**base, "name": "start", "id": 1})
            assert await next_of(socket, "answer") == {
                "type": "answer", "id": 1, "success": True, "message": "did start",
            }  # fmt: skip
            await socket.send_json({**base, "name": "repeat", "arguments": {"index": 3}, "id": 2})
            assert (await next_of(socket, "answer"))["success"]
            await socket.send_json({**base, "name": "skip", "id": 3})
            assert not (await next_of(socket, "answer"))["success"]

    run(body)
    assert served.commands == [("start", {}), ("repeat", {"index": 3}), ("skip", {})]


@pytest.mark.parametrize(
    ("view", "token"), [("operator", "wrong"), ("operator", None), ("participant", True)]
)
def test_without_token_or_from_the_participants_view_nothing_is_commanded(
    served: Served, view: str, token: Any
) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session, view) as socket:
            given = served.server.token if token is True else token
            await socket.send_json({"type": "command", "name": "start", "token": given, "id": 1})
            answer = await next_of(socket, "answer")
            assert not answer["success"] and "may not command" in answer["message"]

    run(body)
    assert served.commands == []


def test_bad_messages_do_no_harm_and_end_in_a_closed_connection(served: Served) -> None:
    rng = random.Random(1)
    pieces = [
        "{",
        "}",
        "[",
        '"',
        ":",
        ",",
        "command",
        "type",
        "null",
        "1e999",
        "\\u0000",
        "shown",
        "id",
    ]
    bad = [
        "", "no json", "[]", "3", "null", "{}", "[" * 5000, '{"type": []}', '{"type": "command"}',
        '{"type": "command", "name": ["start"], "token": 3}', '{"type": "shown", "id": "x"}',
        '{"type": "shown", "id": 99999999999999999999}', '{"type": "watch", "images": 3}',
        *("".join(rng.choices(pieces, k=rng.randrange(1, 40))) for _ in range(300)),
    ]  # fmt: skip

    async def body(session: aiohttp.ClientSession) -> None:
        closed = 0
        socket = await served.connect(session)
        for text in bad:
            if socket.closed:
                closed += 1
                socket = await served.connect(session)
            try:
                await socket.send_str(text)
            except (aiohttp.ClientError, ConnectionError):
                continue
            if rng.random() < 0.2:
                while not socket.closed:
                    try:
                        await asyncio.wait_for(socket.receive(), 0.02)
                    except asyncio.TimeoutError:
                        break
        await socket.close()
        assert closed > 3
        async with served.connect(session) as huge:
            await huge.send_str("x" * 100_000)
            while (await huge.receive()).type is not aiohttp.WSMsgType.CLOSE:
                pass
        async with served.connect(session) as binary:
            await binary.send_bytes(b"\x00" * 100)
            assert "must be text" in (await next_of(binary, "answer"))["message"]
        async with served.connect(session) as good:
            await good.send_json({"type": "command", "name": "tare", "token": served.server.token})
            assert (await next_of(good, "answer"))["success"]

    run(body)
    assert served.commands == [("tare", {})]


@pytest.mark.parametrize(
    "message",
    [
        {"name": "shutdown"},
        {"name": "start", "arguments": {"x": 1}},
        {"name": "start", "arguments": []},
        {"name": "repeat"},
        {"name": "repeat", "arguments": {"index": -1}},
        {"name": "repeat", "arguments": {"index": True}},
        {"name": "repeat", "arguments": {"index": 1.5}},
        {"name": "moisture", "arguments": {"value": float("nan")}},
        {"name": "moisture", "arguments": {"value": "50"}},
        {"name": "preparation", "arguments": {"condition": 1, "text": ""}},
    ],
)
def test_commands_of_a_wrong_form_are_refused(message: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        check_command(message)


def test_every_command_of_the_page_is_one_the_server_knows(project_root: Any) -> None:
    folder = project_root / "src/finger_operator/finger_operator/page/static"
    script = (folder / "app.js").read_text()
    for name in COMMANDS:
        assert f'"{name}"' in script, name


def test_cues_are_never_dropped_and_come_before_the_rest(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> list[int]:
        seen = []
        async with served.connect(session) as socket:
            await next_of(socket, "hello")
            for number in range(50):
                served.server.publish("status", {"number": number, "padding": "x" * 20000})
                served.server.publish_cue(time.time_ns(), {"phase": number})
            while len(seen) < 50:
                seen.append((await next_of(socket, "cue"))["phase"])
        return seen

    assert run(body) == list(range(50))


def test_one_round_is_on_its_way_and_of_what_waits_the_newest_is_kept(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as socket:
            await next_of(socket, "hello")
            await socket.send_json({"type": "watch", "images": True})
            await served_all(socket)
            served.server.publish("status", {"number": -1})
            while (message := json.loads((await socket.receive()).data))["type"] != "round":
                pass
            for number in range(20):
                served.server.publish("status", {"number": number})
                served.server.publish_image(b"x" * 1000, number)
                served.server.publish_cue(number, {"phase": number})
            seen = []
            while len(seen) < 20:
                cue = json.loads((await socket.receive()).data)
                assert cue["type"] == "cue", "the round before is not confirmed"
                seen.append(cue["phase"])
            await socket.send_json({**message, "type": "got"})
            assert (await next_of(socket, "status"))["number"] == 19
            assert (await received(socket))[:8] == (19).to_bytes(8, "little")

    run(body)


def test_images_get_smaller_as_rounds_take_long() -> None:
    rng = np.random.default_rng(1)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (512, 640), dtype=np.uint8), (0, 0), 2)
    jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
    for limit in (len(jpeg), 20_000, 5_000):
        small = smaller_image(jpeg, limit)
        assert len(small) <= limit
        assert min(cv2.imdecode(np.frombuffer(small, np.uint8), 0).shape) >= 64
    assert smaller_image(b"no image", 3) == b"no image"
    browser = Browser(None, True, True)
    for took, larger in ((1.0, False), (0.5, False), (0.0, True)):
        before = browser.image_bytes
        browser.confirmed, browser.sending_since = False, time.monotonic() - took
        browser.confirm(browser.rounds)
        assert (browser.image_bytes > before) is larger

    def after(*rounds: float) -> int:
        for took in rounds:
            browser.confirmed, browser.sending_since = False, time.monotonic() - took
            browser.confirm(browser.rounds)
        return browser.image_bytes

    # A busy machine leaves the picture readable; a slow link does not, as long as it is slow.
    assert after(*[0.3] * 20) == READABLE[0]
    assert after(*[0.9] * 20) == IMAGE_BYTES[0]
    assert after(*[0.3] * 20) == IMAGE_BYTES[0]
    assert READABLE[0] <= after(*[0.15] * 20) <= 1.25 * READABLE[0]


def test_late_browser_learns_state_and_cue_participant_only_the_cue(served: Served) -> None:
    served.server.publish("status", {"step": "prepare"})
    served.server.publish("health", {"items": []})
    served.server.publish_cue(time.time_ns(), {"phase": "prepare"})

    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as socket:
            assert (await next_of(socket, "cue"))["phase"] == "prepare"
            assert (await next_of(socket, "status"))["step"] == "prepare"
        async with served.connect(session, "participant") as socket:
            await next_of(socket, "cue")
            served.server.publish("status", {"step": "press"})
            served.server.publish_point("force", [0.0, 1.0])
            served.server.publish_cue(time.time_ns(), {"phase": "lift"})
            kinds = []
            while "cue" not in kinds:
                kinds.append((await received(socket))["type"])
            assert set(kinds) <= {"cue", "hello"}

    run(body)


def test_images_go_to_watchers_only(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as watcher, served.connect(session) as other:
            assert (await next_of(watcher, "hello"))["images"] is True
            await watcher.send_json({"type": "watch", "images": True})
            await served_all(watcher)
            assert served.server.watchers == 1
            served.server.publish_image(b"jpeg", 7)
            assert await received(watcher) == (7).to_bytes(8, "little") + b"jpeg"
            served.server.publish_cue(time.time_ns(), {"phase": "prepare"})
            await next_of(other, "hello")
            assert (await received(other))["type"] == "cue", "no image for the other"
        async with served.connect(session, "participant") as participant:
            await participant.send_json({"type": "watch", "images": True})
            await served_all(participant)
            assert served.server.watchers == 0

    run(body)


@pytest.mark.parametrize("share", [False, True])
def test_beyond_this_machine_images_need_a_setting_and_the_operators_view_the_token(
    monkeypatch: pytest.MonkeyPatch, share: bool
) -> None:
    monkeypatch.setattr("finger_operator.page.access.is_loopback", lambda address: False)
    served = Served(share_images=share)

    async def body(session: aiohttp.ClientSession) -> None:
        async with session.get(served.url()) as page:
            assert page.status == 403 and served.server.token not in await page.text()
        async with session.get(served.url("/?token=wrong")) as page:
            assert page.status == 403
        async with session.get(served.url(f"/?token={served.server.token}")) as page:
            assert page.status == 200
        for token in ("", "wrong"):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await served.connect(session, token=token)
        async with served.connect(session, "participant"):
            pass
        async with served.connect(session, token=served.server.token) as socket:
            assert (await next_of(socket, "hello"))["images"] is share
            await socket.send_json({"type": "watch", "images": True})
            await served_all(socket)
            assert served.server.watchers == (1 if share else 0)

    try:
        run(body)
    finally:
        served.server.stop()


def test_port_in_use_is_reported_in_one_sentence(served: Served) -> None:
    second = PageServer(PageSettings(port=served.server.port), served.command)
    with pytest.raises(InputError, match="choose another host or port"):
        second.start()


def test_a_server_starts_again_as_often_as_its_port_is_free() -> None:
    first = Served()
    port = first.server.port
    second = PageServer(PageSettings(port=port), first.command)
    with pytest.raises(InputError, match="cannot be served"):
        second.start()
    first.server.stop()
    second.start()
    second.stop()
    third = PageServer(PageSettings(port=port), first.command)
    third.start()
    with pytest.raises(InputError, match="cannot be served"):
        second.start()
    third.stop()


def test_a_second_page_takes_a_free_port_unless_one_is_asked_for(
    free_port: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = free_port()
    monkeypatch.setattr("finger_operator.page.server.USUAL_PORT", usual)
    first, second = Served(), Served()
    assert first.server.port == usual
    assert second.server.port not in (usual, 0) and f":{second.server.port}/" in second.server.url
    with pytest.raises(InputError, match=f"cannot be served on 127.0.0.1:{usual} "):
        PageServer(PageSettings(port=usual), second.command).start()
    for served in (first, second):
        served.server.stop()


def test_loopback_addresses() -> None:
    assert all(map(is_loopback, ["127.0.0.1", "127.1.2.3", "::1", "::ffff:127.0.0.1"]))
    assert not any(map(is_loopback, ["192.168.0.7", "::ffff:10.0.0.1", "fe80::1%eth0", "", None]))


def test_participants_hear_that_the_rig_is_alive_and_no_more(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session, "participant") as socket:
            await next_of(socket, "hello")
            served.server.publish("alive", {"time": 1.0, "problems": [{"text": "No force."}]})
            assert await next_of(socket, "beat") == {"type": "beat"}

    run(body)


def test_commands_for_what_is_no_longer_there_are_refused() -> None:
    closed = {"step": "closed"}
    now = {"session": "S02_a", "index": 1, "step": "prepare"}
    begin = {"seen_step": "closed"}
    assert stale(dict(begin), closed) == ""
    # A second tab, or one more try: nobody has prepared the trial yet.
    assert stale(dict(begin), now) == "trial 2 is at 'prepare'"
    assert stale({"seen_session": "S02_a", "seen_trial": 1}, now) == ""
    assert stale({"seen_session": "S01_a", "seen_trial": 1}, now) == "session S02_a is open"
    assert stale({"seen_session": "S01_a"}, closed) == "no session is open"
    assert stale({"seen_trial": 0, "seen_step": "prepare"}, now) == "trial 2 is at 'prepare'"
    reading = {"seen_trial": 1, "seen_readings": 1}
    taken = {**now, "moisture_before": [41.0], "moisture_after": []}
    assert stale(dict(reading), taken) == ""
    assert stale(dict(reading), {**taken, "moisture_after": [42.5]}) == "a reading of 42.5 came"
    assert stale(dict(reading), now) == "trial 2 is at 'prepare'"
    given = {"index": 0, "seen_step": "done"}
    assert stale(given, now) and given == {"index": 0}
    assert {"start", "calibrate", "pause", "resume", "redo", "repeat", "skip", "end", "abort",
            "marker", "note", "close", "preparation", "moisture"} == {
        name for name, command in COMMANDS.items() if SEEN.keys() <= command.arguments.keys()
    }  # fmt: skip


def test_participants_see_no_cue_of_a_protocol_that_is_silent(served: Served) -> None:
    async def phase(socket: Any) -> str:
        return str((await next_of(socket, "cue"))["phase"])

    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session, "participant") as participant:
            served.server.hold_cue(True)  # there is no cue yet
            served.server.publish_cue(time.time_ns(), {"phase": "press", "index": 0})
            assert await phase(participant) == "press"
            for _ in range(2):
                served.server.hold_cue(True)
            assert await phase(participant) == "idle"
            async with served.connect(session, "participant") as later:
                assert await phase(later) == "idle"
            async with served.connect(session) as operator:
                assert await phase(operator) == "press", "the operator's page says what is wrong"
            served.server.hold_cue(False)
            assert await phase(participant) == "press"
            served.server.hold_cue(True)
            served.server.publish_cue(time.time_ns(), {"phase": "paused", "index": 0})
            assert [await phase(participant) for _ in range(2)] == ["idle", "paused"]
            async with served.connect(session, "participant") as later:
                assert await phase(later) == "paused", "a new cue is held no longer"
            served.server.hold_cue(True)
            assert await phase(participant) == "idle"

    run(body)


def test_shown_cue_gives_its_delay_from_the_force_sample(served: Served, step: float = 0.0) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as socket:
            await next_of(socket, "hello")
            stamp = time.time_ns() + round(step * 1e9) - 30_000_000
            served.server.publish_cue(stamp, {"phase": "lift"})
            cue = await next_of(socket, "cue")
            await socket.send_json({"type": "shown", "id": cue["id"]})
            await socket.send_json({"type": "shown", "id": 12345})
            await served_all(socket)

    run(body)
    assert len(served.server.latencies) == 1 and 0.03 <= served.server.latencies[0] < 30.0


def test_the_delay_of_a_cue_is_measured_on_the_clock_of_the_samples() -> None:
    """The system clock was stepped by an hour since the rig was started."""
    served = Served(now=lambda: time.time_ns() - 3600 * 10**9)
    test_shown_cue_gives_its_delay_from_the_force_sample(served, -3600.0)
    served.server.stop()


def test_force_memory_interpolates_and_forgets() -> None:
    memory = ForceMemory()
    for k in range(3000):
        memory.add(k * 2_000_000, k * 0.001)
    assert memory.at(5_000_000_000 + 1_000_000) == pytest.approx(2.5005)
    assert memory.at(100) is None and memory.at(7_000_000_000) is None
    assert measured_point(memory, 5_000_000_000, 42e-6, 0) == [5.0, 2.5, 42.0]
    assert measured_point(memory, 5_000_000_000, 42e-6, 1) is None
    memory.add(9_500_000_000, float("nan"))
    assert measured_point(memory, 9_500_000_000, 42e-6, 0) is None
    memory.add(0, 9.0)  # time began again
    assert memory.at(0) == 9.0


def test_health_of_a_silent_node_is_stale() -> None:
    board = HealthBoard()
    board.add(0.0, "finger/force: sensor", 0, "active", {"measured_rate_hz": "500"})
    assert board.snapshot(1.0)[0]["level"] == 0
    late = board.snapshot(5.0)[0]
    assert late["level"] == 3 and "silent" in late["message"]
    of_finger = HealthBoard("/finger")
    for name in ("finger/force: sensor", "thumb/force: sensor"):
        of_finger.add(0.0, name, 0, "active", {})
    assert [item["level"] for item in of_finger.snapshot(1.0, {"force"})] == [3, 0]
    for k in range(1000):
        board.add(1.0, f"n{k}", 0, "", {})
    assert len(board.snapshot(1.0)) <= HealthBoard.LIMIT


def test_estimates_are_drawn_in_the_pages_units_and_only_in_contact() -> None:
    nan = float("nan")
    values = [5e-5, 1e-6, 8e-4, 2e4, nan]
    assert estimate_point(2_000_000_000, 1.0, values) == [2.0, 1.0, 50.0, 1.0, 0.8, 20.0, None]
    assert estimate_point(0, 1.0, [nan] * 5) is None
    assert estimate_point(0, nan, values) is None and estimate_point(0, 0.0, values) is None


def test_the_gravest_flag_is_named() -> None:
    failed = StateFlag.MODEL_FAILED | StateFlag.FORCE_OUT_OF_RANGE | StateFlag.FORCE_INVALID
    assert doubt(failed, ESTIMATE_DOUBTS) == "model failed"
    assert doubt(StateFlag.FORCE_OUT_OF_RANGE, ESTIMATE_DOUBTS) == "force out of range"
    without = StateFlag.AREA_MISSING | StateFlag.MOISTURE_MISSING
    assert doubt(without, ESTIMATE_DOUBTS) == "", "a rig without camera and probe"
    pale = AreaFlag.SPARSE | AreaFlag.LOW_CONTRAST | AreaFlag.UNCALIBRATED
    assert doubt(pale, AREA_DOUBTS) == "low contrast"
    assert doubt(AreaFlag.NO_CONTACT | AreaFlag.SLIDING, AREA_DOUBTS) == ""


def test_a_number_that_is_not_finite_is_sent_as_null(served: Served) -> None:
    async def body(session: aiohttp.ClientSession) -> None:
        async with served.connect(session) as socket:
            data = {"area": float("nan"), "deep": [{"value": float("-inf")}, 1.5]}
            served.server.publish("contact", data)
            contact = await next_of(socket, "contact")
            assert contact == {"type": "contact", "area": None, "deep": [{"value": None}, 1.5]}

    run(body)


def test_curve_memory_keeps_the_last_seconds_and_the_last_press() -> None:
    memory = CurveMemory()
    for k in range(1000):
        time = 100.0 + 0.1 * k
        if k == 500:
            memory.press_begins(4, time)
        if k == 530:
            assert memory.snapshot()["press"] == pytest.approx(150.0)
            memory.press_ends(time)
        memory.add("force", [time, 1.0])
    found = memory.snapshot()
    assert found["press"] is None
    assert found["live"]["force"][0][0] == pytest.approx(199.9 - CurveMemory.SPAN, abs=0.2)
    last = found["last"]
    assert (last["index"], last["began"]) == (4, pytest.approx(150.0))
    assert [p[0] for p in last["force"]] == pytest.approx([150.0 + 0.1 * k for k in range(30)])
    memory.add("force", [0.0, 2.0])  # time began again
    assert memory.snapshot()["live"]["force"] == [[0.0, 2.0]]
