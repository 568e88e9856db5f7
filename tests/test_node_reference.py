"""The node reference and the rig's parameter file agree with the nodes."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")


def test_reference_and_rig_file_are_current(project_root: Path) -> None:
    script = project_root / "scripts" / "node_reference.py"
    result = subprocess.run(
        [sys.executable, str(script), "--check"], capture_output=True, text=True, cwd=project_root
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_every_key_of_the_rig_file_is_a_checked_parameter_with_its_comment(
    project_root: Path,
) -> None:
    from finger_bringup import nodes
    from finger_common.node import ManagedNode

    file = project_root / "src" / "finger_bringup" / "config" / "rig.yaml"
    text = file.read_text()
    for node, section in yaml.safe_load(text).items():
        entry = nodes.NODES[node.removeprefix("/**/")]
        module = importlib.import_module(entry.module)
        cls = next(
            c
            for c in vars(module).values()
            if isinstance(c, type) and issubclass(c, ManagedNode) and c.NAME == entry.name
        )
        cls.parameter_table().check(section["ros__parameters"])
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if re.match(r"    \w", line):
            assert lines[number - 1].lstrip().startswith("#"), f"line {number + 1}: {line}"


def test_parameters_of_one_name_agree_in_their_defaults(project_root: Path) -> None:
    """An axis or a target force set in one place only would tear nodes apart."""
    file = project_root / "src" / "finger_bringup" / "config" / "rig.yaml"
    values: dict[str, dict[str, object]] = {}
    for node, section in yaml.safe_load(file.read_text()).items():
        for key, value in section["ros__parameters"].items():
            values.setdefault(key, {})[node] = value
    for key in ("normal_axis", "onset_force", "liftoff_force"):
        assert len(values[key]) > 1 and len(set(values[key].values())) == 1, (key, values[key])


def attributes_of(file: Path) -> dict[str, int]:
    """Attribute of self that a module's classes assign -> line."""
    found = {}
    for node in ast.walk(ast.parse(file.read_text())):
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets += [node.target] if isinstance(node, (ast.AnnAssign, ast.AugAssign)) else []
        for target in targets:
            for part in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(part, ast.Attribute) and getattr(part.value, "id", "") == "self":
                    if part.attr.startswith("_") and not part.attr.startswith("__"):
                        found[part.attr] = part.lineno
    return found


def test_no_node_overwrites_an_attribute_of_rclpy(project_root: Path) -> None:
    """`self._services`, `self._clock`, … belong to rclpy's Node; overwriting breaks it."""
    import rclpy.lifecycle.node
    import rclpy.node

    taken = {
        name
        for module in (rclpy.node, rclpy.lifecycle.node)
        for name in attributes_of(Path(str(module.__file__)))
    }
    assert "_services" in taken and "_clock" in taken
    wrong = []
    files = [
        *project_root.glob("src/*/finger_*/*_node.py"),
        *project_root.glob("src/finger_common/finger_common/node/*.py"),
    ]
    for file in files:
        for name, line in attributes_of(file).items():
            if name in taken:
                wrong.append(f"{file.relative_to(project_root)}:{line} self.{name}")
    assert not wrong, "\n".join(wrong)


def test_help_of_a_node_names_its_parameters_and_starts_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    from finger_driver.force_node import main

    main(["--help"])
    text = capsys.readouterr().out
    assert "usage: --ros-args" in text and "connect_timeout (10.0 s)" in text
    assert "can_channel" in text, "parameters of its devices, too"
    assert not rclpy.ok()
