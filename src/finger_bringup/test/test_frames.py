# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The URDF fragment: its frames are those that the nodes name, in one tree, where they belong."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from finger_bringup import nodes

XACRO = "{http://www.ros.org/wiki/xacro}"


@pytest.fixture
def urdf(project_root: Path) -> Path:
    return project_root / "src" / "finger_bringup" / "urdf"


def expanded(folder: Path, **values: str) -> ElementTree.Element:
    """The macro with its parameters put in; it holds nothing but plain substitutions."""
    tree = ElementTree.parse(folder / "finger.urdf.xacro").getroot()
    macro = tree.find(f"{XACRO}macro")
    assert macro is not None
    declared = re.findall(r"(\w+)(?::=('[^']*'|\S+))?", macro.attrib["params"])
    known = {name: default.strip("'") for name, default in declared} | values
    for element in macro.iter():
        for key, text in element.attrib.items():
            if key != "params":
                element.set(key, re.sub(r"\$\{(\w+)\}", lambda m: known[m[1]], text))
    return macro


def poses(robot: ElementTree.Element) -> dict[str, tuple[str, np.ndarray]]:
    """Parent and position in it of each child link."""
    found = {}
    for joint in robot.iter("joint"):
        assert joint.get("type") == "fixed"
        parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
        assert parent is not None and child is not None and origin is not None
        found[child.attrib["link"]] = (
            parent.attrib["link"],
            np.array([float(v) for v in origin.attrib["xyz"].split()]),
        )
    return found


def check(found: dict[str, tuple[str, np.ndarray]], prefix: str, root: str) -> None:
    height = {root: 0.0}
    for link in ("force_sensor", "plate", "camera_optical", "finger"):
        parent, position = found[prefix + link]
        assert position[:2].tolist() == [0.0, 0.0]
        height[prefix + link] = height[parent] + position[2]
    assert height[f"{prefix}plate"] == pytest.approx(0.03)
    assert height[f"{prefix}camera_optical"] == pytest.approx(0.03 - 0.2)
    assert height[f"{prefix}finger"] == height[f"{prefix}plate"]


def test_the_fragment_places_the_frames_that_the_nodes_name(urdf: Path, project_root: Path) -> None:
    values = {"parent": "thumb_link", "prefix": "thumb/"}
    robot = expanded(urdf, **values, plate_height="0.03", camera_distance="0.2")
    check(poses(robot), "thumb/", "thumb_link")
    links = {link.attrib["name"].removeprefix("thumb/") for link in robot.iter("link")}
    reference = project_root / "src" / "finger_bringup" / "config" / "rig.yaml"
    sections = yaml.safe_load(reference.read_text())
    frames = {s["ros__parameters"].get("frame_id") for s in sections.values()} - {None}
    assert links == frames
    framed = {k for k, s in sections.items() if "frame_prefix" in s["ros__parameters"]}
    assert framed == {f"/**/{name}" for name in nodes.FRAMED}


@pytest.mark.skipif(
    find_spec("xacro") is None, reason="xacro is not on PyPI; it comes with apt ROS"
)
def test_xacro_expands_the_rig(urdf: Path) -> None:
    arguments = ["prefix:=thumb/", "plate_height:=0.03", "camera_distance:=0.2"]
    program = "import sys, xacro; sys.exit(xacro.main())"
    command = [sys.executable, "-c", program, str(urdf / "finger_rig.urdf.xacro"), *arguments]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    check(poses(ElementTree.fromstring(text)), "thumb/", "thumb/table")
