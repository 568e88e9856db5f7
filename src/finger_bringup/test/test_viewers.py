"""Viewer layouts name topics and fields that exist."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from finger_bag.schema import TOPICS


def fields_of(root: Path, type_name: str) -> set[str] | None:
    """Field names of a message of this suite; None for messages of other packages."""
    package, _, name = type_name.split("/")
    if package != "finger_msgs":
        return None
    text = (root / "src" / "finger_msgs" / "msg" / f"{name}.msg").read_text()
    return set(re.findall(r"^[\w/\[\]]+ (\w+)(?: |$)", text, re.M))


def check(root: Path, topic: str, field: str | None) -> None:
    short = topic.removeprefix("/finger/")
    assert short in TOPICS, topic
    fields = fields_of(root, TOPICS[short].type)
    if field and fields is not None:
        assert field in fields, f"{topic} has no field {field}"


@pytest.fixture
def config(project_root: Path) -> Path:
    return project_root / "src" / "finger_bringup" / "config"


def test_foxglove_layout(config: Path, project_root: Path) -> None:
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
    for topic, field in paths:
        check(project_root, topic, field)


def test_plotjuggler_layout(config: Path, project_root: Path) -> None:
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
        check(project_root, topic, field)
