# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Viewer layouts name topics and fields that exist."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from finger_bag.definitions import typestore
from finger_bag.schema import TOPICS


def check(topic: str, field: str | None) -> None:
    short = topic.removeprefix("/finger/")
    assert short in TOPICS, topic
    _, fields = typestore().fielddefs[TOPICS[short].type]
    assert not field or field in {name for name, _ in fields}, f"{topic} has no field {field}"


@pytest.fixture
def config(project_root: Path) -> Path:
    return project_root / "src" / "finger_bringup" / "config"


def test_foxglove_layout(config: Path) -> None:
    layout = json.loads((config / "foxglove_layout.json").read_text())
    panels: list[str] = []

    def walk(node: Any) -> None:
        if isinstance(node, str):
            panels.append(node)
        else:
            assert node["direction"] in ("row", "column")
            walk(node["first"])
            walk(node["second"])

    walk(layout["layout"])
    assert sorted(panels) == sorted(layout["configById"])
    paths = re.findall(r'"(/[\w/]+)(?:\.(\w+))?"', json.dumps(layout))
    assert len(paths) > 8
    # "currentCustom" would show the newest pair alone.
    assert layout["configById"]["Plot!area_over_force"]["xAxisVal"] == "custom"
    for topic, field in paths:
        check(topic, field)


def test_plotjuggler_layout(config: Path) -> None:
    root = ElementTree.parse(config / "plotjuggler_layout.xml").getroot()
    curves = [
        path
        for curve in root.iter("curve")
        for path in (curve.get("curve_x"), curve.get("curve_y"), curve.get("name"))
        if path and path.startswith("/")
    ]
    assert len(curves) > 6
    for path in curves:
        topic, _, field = path.rpartition("/")
        check(topic, field)
