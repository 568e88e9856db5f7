# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Sensors of other packages: the one of docs/add_a_sensor.md in the node, and what goes wrong."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device_process import Observer, device

from finger_common.diagnostics import ERROR, HealthReport
from finger_common.errors import InputError
from finger_common.plugins import PluginKind
from finger_common.settings import Settings, parameters_of
from finger_common.stamps import header_stamp
from finger_driver import camera, force, moisture
from finger_driver.simulators.cli import installed


@pytest.fixture
def load_cell(
    tmp_path: Path, project_root: Path, monkeypatch: pytest.MonkeyPatch, install_package: Callable
) -> Path:
    """Folder on PYTHONPATH in which the package of docs/add_a_sensor.md is installed."""
    tomllib = pytest.importorskip("tomllib", reason="reading pyproject.toml needs Python 3.11")
    page = (project_root / "docs" / "add_a_sensor.md").read_text()
    driver, simulator = re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S)
    project = tomllib.loads(re.search(r"^```toml\n(.*?)^```$", page, re.M | re.S)[1])["project"]
    folder = tmp_path / "outside"
    folder.mkdir()
    modules = {"load_cell": driver, "load_cell_simulator": simulator}
    install_package(folder, modules, project["entry-points"])
    path = [str(folder), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, path)))
    return folder


def test_force_node_runs_with_a_sensor_of_another_package(
    observer: Observer, process: Any, load_cell: Path, free_port: Any
) -> None:
    """The page's sensor and its simulator, each in a process; the suite itself unedited."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped

    port = free_port()
    wrenches = observer.listen(WrenchStamped, "wrench")
    diagnostics = observer.listen(DiagnosticArray, "/diagnostics", 10, True)
    with device("load_cell", "--port", port, "--wrench=0.5,0,-1.5,0,0,0.02") as simulator:
        child = process(
            "-m", "finger_driver.force_node", "--ros-args",
            "-p", "device:=load_cell", "-p", f"load_cell_port:={port}",
        )  # fmt: skip
        observer.until(lambda: len(wrenches) > 200, what="wrench")
        force_n = wrenches[-1].wrench.force
        assert (force_n.x, force_n.y, force_n.z) == pytest.approx((0.5, 0.0, -1.5))
        assert wrenches[-1].wrench.torque.z == pytest.approx(0.02)
        stamps = np.array([header_stamp(m) for m in wrenches])
        assert np.all(np.diff(stamps) > 0)

        def messages() -> list[str]:
            return [s.message for a in diagnostics for s in a.status if "force" in s.name]

        simulator.say("short -1")
        observer.until(lambda: any("14 bytes" in m for m in messages()), what="the fault")
        simulator.say("clear")
        count = len(wrenches)
        observer.until(lambda: len(wrenches) > count + 100, what="wrench after the fault")
    assert child.poll() is None, child.output.read_text()


CAMERA_AND_PROBE = '''
from dataclasses import dataclass
import numpy as np
from finger_common.settings import setting
from finger_driver.camera import CameraSettings, CameraSource, Frame
from finger_driver.moisture import MoistureSettings, MoistureSource

@dataclass(frozen=True)
class PatternSettings(CameraSettings):
    pattern_grey: int = setting(7, "pattern: grey level.", minimum=0, maximum=255)

class Pattern(CameraSource):
    """Test pattern. Nothing else."""
    SETTINGS = PatternSettings
    def connect(self): self.count = 0
    def close(self): pass
    def read(self, timeout):
        self.count += 1
        image = np.full((4, 6), self.settings.pattern_grey, np.uint8)
        return Frame(self.clock.now(), image, self.count)

class Probe(MoistureSource):
    """Probe that always reads 150."""
    NAME = "probe"
    def connect(self): pass
    def close(self): pass
    def read(self, timeout): return self.reading(self.clock.now(), 150.0)
'''


def test_a_camera_and_a_probe_of_another_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, install_package: Callable
) -> None:
    entries = {
        "finger_driver.camera": {"pattern": "camera_and_probe:Pattern"},
        "finger_driver.moisture": {"probe": "camera_and_probe:Probe"},
    }
    install_package(tmp_path, {"camera_and_probe": CAMERA_AND_PROBE}, entries)
    monkeypatch.syspath_prepend(tmp_path)
    table = parameters_of(*camera.SOURCES.settings())
    assert table["device"].choices == ("folder", "opencv", "pattern", "ueye")
    assert "pattern (Test pattern)" in table["device"].meaning
    assert table["pattern_grey"].default == 7
    source = camera.open_source({"device": "pattern", "pattern_grey": 9, "frame_id": "ignored"})
    source.connect()
    assert source.read(0.1).image.tolist() == [[9] * 6] * 4
    probe = moisture.open_source({"device": "probe"})
    readings = [probe.read(0.1) for _ in range(2)]
    assert [(r.value, r.flags, r.source) for r in readings] == 2 * [(150.0, 1, "probe")]


UNUSABLE = '''
from dataclasses import dataclass
from finger_common.settings import Settings, setting
from finger_driver.force import ForceSettings, ForceSource

@dataclass(frozen=True)
class OtherRate(ForceSettings):
    rate: float = setting(20.0, "Another rate.")

class Contradicting(ForceSource):
    SETTINGS = OtherRate

class WithoutSettings(ForceSource):
    SETTINGS = Settings

class BadSimulator(ForceSource):
    """Sensor whose simulator is missing."""
    SIMULATOR = "unusable:Missing"

def function(): pass
'''


def test_sensors_that_cannot_be_used_are_named_in_one_sentence_and_stop_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, install_package: Callable
) -> None:
    names = {
        "absent_module": "no_such_module_:Sensor",
        "contradicting": "unusable:Contradicting",
        "function": "unusable:function",
        "without_settings": "unusable:WithoutSettings",
        "bad_simulator": "unusable:BadSimulator",
    }
    install_package(tmp_path, {"unusable": UNUSABLE}, {"finger_driver.force": names})
    monkeypatch.syspath_prepend(tmp_path)
    sources = PluginKind(
        "finger_driver.force", "force sensor", force.ForceSource, "device", "netft"
    )
    table = parameters_of(*sources.settings())
    assert table["rate"].default == 500.0 and "netft_host" in table
    expected = {
        "absent_module": "No module named 'no_such_module_'",
        "contradicting": "'rate' is declared twice",
        "function": "is not a subclass of ForceSource",
        "without_settings": "SETTINGS is not a subclass of ForceSettings",
    }
    assert set(sources.problems) == set(expected)
    for name, text in expected.items():
        problem = sources.problems[name]
        assert name in problem and text in problem and "\n" not in problem
        with pytest.raises(InputError, match=re.escape(text)):
            sources.open({"device": name})
    with pytest.raises(InputError, match="'nonsense' is not installed; known are absent_module"):
        sources.open({"device": "nonsense"})
    simulators, problems = installed()
    assert "netcanoem" in simulators and any("unusable:Missing" in p for p in problems)


def refused_by_a_node(device: str, domain: int) -> HealthReport:
    """What a force node shows of a sensor with which it cannot be brought up."""
    rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from rclpy.parameter import Parameter

    from finger_driver.force_node import ForceNode

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        overrides = [Parameter("device", value=device)]
        node = ForceNode(context=context, parameter_overrides=overrides)
        assert not node.bring_up()
        shown = node.healths[0].report()
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    return shown


def test_a_node_names_the_sensor_that_cannot_be_used(
    ros_domain: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: Any,
    install_package: Callable,
) -> None:
    install_package(tmp_path, {}, {"finger_driver.force": {"absent": "no_such_module_:Sensor"}})
    monkeypatch.syspath_prepend(tmp_path)
    refused_by_a_node("absent", ros_domain)
    lines = [line for line in capfd.readouterr().err.splitlines() if "'absent'" in line]
    assert len(lines) == 2 and all("No module named" in line for line in lines), lines
    assert "configure failed" in lines[1]


DEFECT = '''
from finger_driver.force import ForceSource

class Defect(ForceSource):
    """Sensor whose driver has a defect."""
    def connect(self): raise ValueError("no such port")
    def close(self): pass
'''


def test_a_defect_of_a_driver_is_told_in_one_sentence_and_in_diagnostics(
    ros_domain: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: Any,
    install_package: Callable,
) -> None:
    install_package(
        tmp_path, {"defect": DEFECT}, {"finger_driver.force": {"defect": "defect:Defect"}}
    )
    monkeypatch.syspath_prepend(tmp_path)
    shown = refused_by_a_node("defect", ros_domain)
    said = capfd.readouterr().err
    sentence = "Defect.connect failed (ValueError: no such port); correct this driver"
    assert f"configure failed: {sentence}" in said and "Traceback" not in said
    assert shown.level == ERROR and sentence in shown.message


def test_without_any_installed_source_the_sentence_names_the_remedy() -> None:
    nothing = PluginKind("finger_driver.none", "force sensor", force.ForceSource, "device", "netft")
    with pytest.raises(InputError, match="no force sensor is installed"):
        nothing.settings(Settings)
