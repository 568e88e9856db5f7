# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The page node over DDS, with a WebSocket in place of a browser."""

from __future__ import annotations

import asyncio
import itertools
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from finger_operator.study_plan import PREPARATIONS


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
                assert (await command("start", seen_step="closed"))["success"]
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
