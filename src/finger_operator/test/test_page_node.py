# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The page node over DDS, with a WebSocket in place of a browser."""

from __future__ import annotations

import asyncio
import itertools
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from finger_common.errors import InputError
from finger_operator.study_plan import PREPARATIONS


async def here(action: Callable[[], Any]) -> Any:
    """In place of the node's thread."""
    return action()


def test_commands_reach_the_protocol_and_its_cues_come_back(
    ros_domain: int, process: Any, free_port: Callable[[], int], tmp_path: Path
) -> None:
    port = free_port()

    def start(module: str, *parameters: str) -> None:
        flags = [flag for parameter in parameters for flag in ("-p", parameter)]
        process("-m", f"finger_operator.{module}", "--ros-args", *flags)

    start("protocol_node", f"output:={tmp_path}", "need_recorder:=false")
    start("page_node", f"port:={port}")

    async def page(session: aiohttp.ClientSession) -> str:
        end = time.monotonic() + 60
        while time.monotonic() < end:
            try:
                async with session.get(f"http://127.0.0.1:{port}/") as answer:
                    return await answer.text()
            except aiohttp.ClientError:
                await asyncio.sleep(0.2)
        raise AssertionError("the page is not served")

    async def run() -> None:
        async with aiohttp.ClientSession() as session:
            text = await page(session)
            assert "{{" not in text
            assert 'id="plan-trials" type="number" min="1" max="1000"' in text
            token = re.search(r'name="token" content="([^"]+)"', text)
            assert token is not None
            origin = f"http://127.0.0.1:{port}"
            url = f"{origin}/ws?token={token[1]}"
            async with session.ws_connect(url, headers={"Origin": origin}) as socket:
                numbers = itertools.count()
                received: list[dict[str, Any]] = []

                async def receive_one() -> None:
                    received.append(await socket.receive_json())
                    if received[-1]["type"] == "round":  # confirmed, as the page does
                        await socket.send_json({**received[-1], "type": "got"})

                async def receive(kind: str, **wanted: Any) -> dict[str, Any]:
                    """The first message of that kind and content, also one that came before."""
                    wanted["type"] = kind
                    for message in received:
                        if wanted.items() <= message.items():
                            return message
                    while True:
                        await receive_one()
                        if wanted.items() <= received[-1].items():
                            return received[-1]

                async def send(name: str, **arguments: Any) -> int:
                    number = next(numbers)
                    await socket.send_json(
                        {
                            "type": "command",
                            "name": name,
                            "arguments": arguments,
                            "token": token[1],
                            "id": number,
                        }
                    )
                    return number

                async def command(name: str, **arguments: Any) -> dict[str, Any]:
                    return await receive("answer", id=await send(name, **arguments))

                closed = await receive("status", step="closed")
                assert closed["plan"]["trials"] == 15
                plan = {"conditions": ["dry"], "trials": 2, "readings": 3, "target_force": 1.2}
                refused = await command("configure", subject="S01", **{**plan, "trials": 0})
                assert not refused["success"] and "1 … 1000" in refused["message"]
                assert (await command("configure", subject="S01", **plan))["success"]
                refused = await command("calibrate")
                assert not refused["success"]
                # No force driver, and the protocol's heartbeat may not have come yet.
                assert refused["message"].startswith("Not ready: The ")
                refused = await command("start", seen_step="closed", for_subject="S09")
                assert not refused["success"], "of another dialog"
                assert "would be of S01," in refused["message"] and "S09" in refused["message"]
                begin = {"seen_step": "closed", "for_subject": "S01"}
                assert (await command("start", **begin))["success"]
                assert (await receive("cue", phase="prepare"))["index"] == 0
                session = (await receive("status", step="prepare"))["session"]
                refused = await command("start", seen_step="closed")  # of a second tab
                assert "trial 1 is at 'prepare' meanwhile" in refused["message"]
                refused = await command("close", seen_session="S00_earlier")
                assert f"session {session} is open meanwhile" in refused["message"]
                text = "Wash with soap."
                seen = {"seen_session": session}
                assert (await command("preparation", condition="dry", text=text, **seen))["success"]
                assert (await receive("status", preparation=text))["step"] == "prepare"
                assert (await receive("status", step="prepare"))["target_force"] == 1.2
                # Two notes at once, as of an operator who is quick.
                notes = {1: "sneezed", 2: "window opened"}
                sent = [await send("note", text=notes[trial], trial=trial) for trial in notes]
                for number, trial in zip(sent, notes, strict=True):
                    answer = await receive("answer", id=number)
                    assert answer["message"] == f"note added to trial {trial}"

                def kept() -> list[list[str]]:
                    """Texts of the notes of each trial in the newest status."""
                    status = [message for message in received if message["type"] == "status"][-1]
                    return [[note["text"] for note in row["notes"]] for row in status["trials"]]

                while kept() != [["sneezed"], ["window opened"]]:
                    await receive_one()
                assert (await command("repeat", index=1))["success"]
                await receive("status", index=1)
                # A dialog that was open meanwhile meant another trial.
                refused = await command("skip", seen_trial=0, seen_step="prepare")
                assert not refused["success"]
                assert "trial 2 is at 'prepare' meanwhile" in refused["message"]
                assert not (await command("tare"))["success"], "no force driver runs"
                assert (await command("end"))["success"]
                await receive("status", step="finished")
                assert (await command("close"))["success"]
                # The next session begins with the text that was edited, and with the others.
                await receive("status", step="closed", preparations={**PREPARATIONS, "dry": text})

    asyncio.run(asyncio.wait_for(run(), 45))


@contextmanager
def page_here(ros_domain: int, port: int, **values: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The node in this process, active, and the newest that it has published of each kind. values:
    parameters beside the port."""
    import rclpy
    from rclpy.parameter import Parameter

    from finger_operator.page_node import PageNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    overrides = [Parameter(name, value=value) for name, value in {"port": port, **values}.items()]
    node = PageNode(context=context, parameter_overrides=overrides)
    told: dict[str, Any] = {}
    try:
        assert node.bring_up()
        node._server.publish = told.__setitem__
        yield node, told
    finally:
        node.release()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_the_order_of_a_session_is_told_before_it_begins(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    given = {"subject": "2026_S02", "conditions": ["dry", "moist"], "order_seed": 0}
    with page_here(ros_domain, free_port()) as (node, _):
        node._in_node = here
        for order, blocks in (("as_given", "dry, moist"), ("counterbalanced", "moist, dry")):
            good, sentence = asyncio.run(node._command("order", {**given, "order": order}))
            assert good and sentence.startswith(f"Blocks: {blocks}")


def test_a_condition_that_may_be_misspelt_is_told_before_a_session_begins(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    with page_here(ros_domain, free_port()) as (node, _):
        node._in_node = here
        node._status = {"step": "closed", "preparations": {**PREPARATIONS, "greasy": "Oil."}}
        given = {"conditions": ["natrual", "greasy", "dry"]}
        assert asyncio.run(node._command("new_conditions", given)) == (
            True,
            "'natrual' is a new condition without a preparation text. Write natural if that is "
            "meant.",
        )


def test_a_session_with_readings_needs_a_probe(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    from finger_common.errors import DeviceError
    from finger_msgs.msg import Moisture

    with page_here(ros_domain, free_port()) as (node, told):
        node._in_node = here

        def missing(readings: int) -> bool:
            node._status = {"step": "prepare", "readings": readings}
            node._alive()
            return "No moisture probe runs." in [p["text"] for p in told["alive"]["problems"]]

        assert missing(3) and not missing(0)
        node._status = {"step": "closed", "plan": {"readings": 3}}
        node._alive()
        assert "moisture" not in [p["source"] for p in told["alive"]["problems"]]
        with pytest.raises(DeviceError, match="start it, or skip this trial and begin a session"):
            asyncio.run(node._command("moisture", {"value": 44.4}))
        # A probe of another make has no heartbeat.
        probe = node.create_publisher(Moisture, "moisture", 1)
        end = time.monotonic() + 20
        while missing(3):
            assert time.monotonic() < end
        node.destroy_publisher(probe)


def test_a_reading_that_is_entered_on_two_pages_at_once_counts_once(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    with page_here(ros_domain, free_port()) as (node, _):
        node._in_node = here
        node._status = {"session": "S01_a", "index": 0, "step": "moisture_before"}
        entered: list[float] = []

        async def probe(service: str, request: Any) -> Any:
            entered.append(request.value)
            told = {**node._status, "moisture_before": [*entered]}
            # The protocol's word comes after the answer of the moisture node.
            asyncio.get_running_loop().call_later(0.1, setattr, node, "_status", told)
            return SimpleNamespace(success=True, message="published")

        async def enter_twice(value: float) -> list[Any]:
            given = {"value": value, "seen_trial": 0, "seen_readings": len(entered)}
            commands = [node._command("moisture", dict(given)) for _ in range(2)]
            return await asyncio.gather(*commands, return_exceptions=True)

        async def enter() -> None:
            for number, value in enumerate((42.0, 43.0), 1):
                first, second = await enter_twice(value)
                assert first == (True, "published")
                assert f"a reading of {value:g} came meanwhile; look, and try again" in str(second)
                assert len(entered) == number

        node._call = probe
        asyncio.run(enter())


def test_messages_of_another_format_are_left_out_and_named(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    from geometry_msgs.msg import WrenchStamped
    from rclpy.serialization import serialize_message

    from finger_msgs.msg import ContactState

    with page_here(ros_domain, free_port()) as (node, told):
        kinds = {"wrench": WrenchStamped, "contact_state": ContactState}
        publishers = [node.create_publisher(kind, topic, 10) for topic, kind in kinds.items()]
        for publisher in publishers:
            end = time.monotonic() + 20
            while not publisher.get_subscription_count():
                assert time.monotonic() < end
                time.sleep(0.02)
        for publisher, kind in zip(publishers, kinds.values()):
            message = kind()
            message.header.stamp.sec = 1
            raw = serialize_message(message)
            message.header.stamp.sec = 2
            # Cut in the header, cut behind it, of XCDR2, and one that can be read.
            for sent in (raw[:6], raw[:-4], b"\x00\x07" + raw[2:], serialize_message(message)):
                publisher.publish(sent)
        end = time.monotonic() + 20
        while "estimate" not in told or node._last_force != 2 * 10**9:
            assert time.monotonic() < end
            node._poll()
            time.sleep(0.02)
        node.publish_diagnostics()
        assert node.healths[0].report().values["unreadable"] == "/wrench 3, /contact_state 3"


def test_an_area_that_is_not_known_is_told_with_the_reason(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    import math

    from finger_msgs.msg import ContactArea, ContactState

    nan, failed = math.nan, ContactState.FLAG_MODEL_FAILED
    with page_here(ros_domain, free_port()) as (node, told):
        node._show_state(ContactState(in_contact=True, normal_force=1.0, area=nan, flags=failed))
        assert told["estimate"] == {"contact": True, "known": False, "doubt": "model failed"}
        node._show_state(ContactState(in_contact=True, normal_force=1.0, area=5e-5))
        assert told["estimate"] == {"contact": True, "known": True, "doubt": ""}
        node._show_state(ContactState(in_contact=False, area=0.0))
        assert told["estimate"] == {"contact": False, "known": True, "doubt": ""}
        flags = ContactArea.FLAG_LOW_CONTRAST
        node._on_area(ContactArea(gross_area=nan, flags=flags))
        assert math.isnan(told["contact"]["area"]) and told["contact"]["doubt"] == "low contrast"


@pytest.mark.parametrize(
    ("step", "paused", "counts"),
    [
        ("closed", False, True),
        ("moisture_before", False, True),
        ("moisture_after", False, True),
        ("moisture_before", True, False),
        ("prepare", False, False),
        ("press", False, False),
    ],
)
def test_a_reading_that_does_not_count_is_not_confirmed(
    ros_domain: int, free_port: Callable[[], int], step: str, paused: bool, counts: bool
) -> None:
    """Without a session it is for the model alone."""
    from finger_msgs.srv import SetMoisture

    async def published(service: str, request: Any) -> Any:
        return SetMoisture.Response(success=True, message="reading 44.4 a.u. published")

    with page_here(ros_domain, free_port()) as (node, _):
        node._call, node._in_node = published, here
        node._status = {"step": step, "paused": paused}
        good, sentence = asyncio.run(node._command("moisture", {"value": 44.4}))
    assert good is counts and "44.4 a.u. published" in sentence
    assert ("it does not count" in sentence) is not counts


def test_no_zero_is_set_during_a_press(ros_domain: int, free_port: Callable[[], int]) -> None:
    """With a finger on the plate it would read as lift-off. A force without a zero may get one."""
    from std_srvs.srv import Trigger

    async def tared(service: str, request: Any) -> Any:
        return Trigger.Response(success=True, message="tared")

    with page_here(ros_domain, free_port()) as (node, _):
        node._call, node._in_node = tared, here
        for known, step, good in (
            ("yes", "press", False),
            ("yes", "pull", False),
            ("yes", "lift", False),
            ("no", "press", True),
            ("yes", "moisture_after", True),
            ("yes", "clear", True),
        ):
            node._readiness.report("force", "force", 0, "", {"tared": known}, time.monotonic())
            node._status = {"step": step}
            try:
                answer = asyncio.run(node._command("tare", {}))
            except InputError as refused:
                answer = False, str(refused)
            assert answer[0] is good, (known, step)
            assert good or "a press is under way" in answer[1]


def test_a_reading_and_the_warning_of_its_probe_are_told(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    from finger_msgs.msg import Moisture

    with page_here(ros_domain, free_port()) as (node, told):
        node._on_moisture(Moisture(value=42.0))
        assert told["moisture"]["value"] == 42.0
        assert abs(told["moisture"]["time"] - node.sample_time() * 1e-9) < 20.0
        for level, said in ((b"\x01", "a line broke off"), (b"\x00", "")):
            status = DiagnosticStatus(level=level, name="moisture: probe", message=said)
            node._on_diagnostics(DiagnosticArray(status=[status]))
            node._alive()
            assert told["alive"]["probe"] == said


def test_the_page_shows_the_force_of_the_topic_that_the_model_reads(
    ros_domain: int, free_port: Callable[[], int]
) -> None:
    from geometry_msgs.msg import WrenchStamped

    with page_here(ros_domain, free_port(), wrench_topic="wrench_turned") as (node, _):
        force = node.create_publisher(WrenchStamped, "wrench_turned", 10)
        message = WrenchStamped()
        message.header.stamp.sec = 5
        message.wrench.force.z = -1.35
        end = time.monotonic() + 20
        while node._last_force != 5 * 10**9:
            assert time.monotonic() < end
            force.publish(message)
            node._poll()
            time.sleep(0.02)
        assert node._memory.at(5 * 10**9) == pytest.approx(1.35)
