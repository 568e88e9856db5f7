"""The table of nodes agrees with the packages; `finger-rig` refuses wrong options."""

import importlib.util
import os
import re
from pathlib import Path

import pytest
import yaml

from finger_bringup import nodes
from finger_bringup.bring_up import ALL_ACTIVE
from finger_bringup.cli import ReadyLine, entries, main, parser
from finger_bringup.restarts import RestartDelay
from finger_common.errors import InputError
from finger_common.folder_lock import lock_folder
from finger_sim.rig_settings import RigAddresses


@pytest.mark.parametrize("entry", nodes.NODES.values(), ids=lambda e: e.name)
def test_every_entry_is_an_executable_of_its_package(
    entry: nodes.NodeEntry, project_root: Path
) -> None:
    assert importlib.util.find_spec(entry.module) is not None
    setup = (project_root / "src" / entry.package / "setup.cfg").read_text()
    assert f"    {entry.executable} = {entry.module}:main\n" in setup


def test_devices_come_up_before_the_nodes_that_need_them() -> None:
    wanted = ["recorder", "model", "vision", "force", "simulated_rig", "page"]
    entries = {entry.name: entry for entry in nodes.select(wanted)}
    groups = entries["bring_up"].parameters["order"]
    assert groups == ["simulated_rig", "force", "model vision", "recorder"]
    assert list(entries)[-1] == "bring_up"
    # The page shows at once which nodes are missing.
    assert entries["page"].parameters["autostart"] is True
    assert entries["force"].parameters["autostart"] is False


def test_parameters_reach_the_file_under_the_full_node_name(tmp_path: Path) -> None:
    addresses = RigAddresses(tmp_path / "rig", can_port=4711)
    entries = nodes.select(["force", "camera"], nodes.simulated_devices(addresses))
    specs = nodes.process_specs(entries, tmp_path, "left_hand")
    data = yaml.safe_load((tmp_path / "parameters.yaml").read_text())
    force = data["/left_hand/force"]["ros__parameters"]
    assert force["can_options"] == "port=4711" and force["can_interface"] == "udp_multicast"
    assert data["/left_hand/camera"]["ros__parameters"]["path"].endswith("spool")
    assert data["/left_hand/bring_up"]["ros__parameters"]["order"] == ["force camera"]
    for spec in specs:
        assert "__ns:=/left_hand" in spec.command
        assert spec.command[-1] == str(tmp_path / "parameters.yaml")


def test_what_the_suite_sets_overrides_the_users_parameter_file(tmp_path: Path) -> None:
    own = tmp_path / "rig.yaml"
    own.write_text("/**/force:\n  ros__parameters: {can_channel: can7}\n")
    specs = nodes.process_specs(nodes.select(["force"]), tmp_path, parameter_file=own)
    files = [
        w for w, before in zip(specs[0].command[1:], specs[0].command) if before == "--params-file"
    ]
    assert files == [str(own), str(tmp_path / "parameters.yaml")]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("force: {rate: 500.0}\n", "'force' has no 'ros__parameters'"),
        ("/**/force:\n  ros__parameters: 5\n", "has no 'ros__parameters'"),
        ("a: [1\n", "not valid YAML"),
    ],
)
def test_a_file_that_is_no_parameter_file_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(str(path))) as error:
        nodes.check_parameter_file(path)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ["up", "--nodes", "forse"],
            "node 'forse' does not exist; did you mean 'force'? Known",
        ),
        (["up", "--without", "cam"], "node 'cam' does not exist; did you mean 'camera'? Known are"),
        (["up", "--without", "simulated_rig"], "'simulated_rig' would not run anyway"),
        (["up", "--parameters", "missing.yaml"], "missing.yaml: no such parameter file"),
    ],
)
def test_bad_arguments_end_with_code_2_and_one_sentence(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = ["--folder", str(tmp_path)]
    assert main([*arguments, *folder]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1 and "Traceback" not in error


def test_a_second_rig_on_a_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with lock_folder(tmp_path, "a rig"):
        assert main(["up", "--nodes", "page", "--folder", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert f"{tmp_path}: in use by a rig (process {os.getpid()}); end it, or choose" in error


def test_the_ready_line_comes_once_all_are_active_and_the_page_is_served() -> None:
    active = f"[bring_up] {ALL_ACTIVE}: force, camera"
    page = "[page] operator's page: http://127.0.0.1:8080/"
    news = "all ready: page at http://127.0.0.1:8080/"
    for lines, says in (
        ([page, "x", active, page, active], ["", "", news, "", news]),
        ([active, page], ["", news]),
    ):
        ready = ReadyLine(page=True)
        assert [ready.take(line) for line in lines] == says
    assert ReadyLine(page=False).take(active) == "all ready"


def names(*arguments: str) -> list[str]:
    return [entry.name for entry in entries(parser().parse_args(["up", *arguments]))]


def test_the_whole_rig_runs_by_default_and_nodes_can_be_left_out(tmp_path: Path) -> None:
    folder = ["--folder", str(tmp_path)]
    everything = ["simulated_rig", *nodes.RIG, "bring_up"]
    assert names("--simulated", *folder) == everything
    everything.remove("page")
    assert names("--simulated", "--without", "page", *folder) == everything
    assert names("--nodes", "force", "model", *folder) == [*nodes.GRASP, "bring_up"]
    assert names("--nodes", "page", *folder) == ["page"]


def test_a_rig_without_recorder_does_not_wait_for_one(tmp_path: Path) -> None:
    chosen = {entry.name: entry for entry in nodes.rig(tmp_path, without=["recorder"])}
    assert chosen["protocol"].parameters["need_recorder"] is False
    assert "need_recorder" not in {e.name: e for e in nodes.rig(tmp_path)}["protocol"].parameters


def test_restarts_slow_down_and_are_quick_again_after_a_stable_minute() -> None:
    delay = RestartDelay()
    assert [delay.after_running(0.1) for _ in range(6)] == [1.0, 2.0, 4.0, 8.0, 15.0, 15.0]
    assert delay.after_running(61.0) == 1.0
