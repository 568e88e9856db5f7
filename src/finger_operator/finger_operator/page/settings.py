# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the page: where it is served, to whom, and what it shows."""

from __future__ import annotations

from dataclasses import dataclass

from finger_common.settings import Settings, setting

from ..normal_force import normal_axis_setting, wrench_topic_setting

USUAL_PORT = 8080
"""Port of the page where nothing else serves it."""


@dataclass(frozen=True)
class PageSettings(Settings):
    """Parameters of the page node."""

    host: str = setting(
        "127.0.0.1",
        "Address to serve on; 0.0.0.0 for all networks of this machine.",
        advice="For a tablet set 0.0.0.0 and open this machine's address with the token "
        "from the log.",
    )
    port: int = setting(
        0,
        f"TCP port of the page; 0 is {USUAL_PORT}, or a free one while that is taken. The log "
        "names it.",
        minimum=0,
        maximum=65535,
    )
    token: str = setting(
        "",
        "Secret that commands, and operators on other machines, must carry; empty: a new one "
        "at each start, shown in the log.",
        advice="Set one to keep a tablet's bookmark valid; other people on the network must not "
        "know it.",
    )
    share_images: bool = setting(
        False, "Send live images beyond this machine. Prints are biometric data."
    )
    allowed_hosts: list = setting(
        [""],
        "Further host names under which the page may be opened, such as that of a reverse proxy.",
    )
    wrench_topic: str = wrench_topic_setting()
    normal_axis: str = normal_axis_setting(
        "If the curve goes down under a press, try the opposite sign."
    )
    display_rate: float = setting(
        100.0,
        "Force samples per second that the page shows; a quarter as many of the model's areas.",
        "Hz",
        5.0,
        1000.0,
        advice="Lower it when the page node needs too much of the processor.",
    )
    image_width: int = setting(640, "Width of the live image.", "pixel", 64, 4096, runtime=True)
    jpeg_quality: int = setting(
        80, "Quality of the live image.", minimum=10, maximum=100, runtime=True
    )
