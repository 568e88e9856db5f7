# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The table of nodes agrees with the packages; `finger-rig` refuses wrong options."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from finger_bag.writer import BagWriter
from finger_bringup import cli, nodes
from finger_bringup.bring_up import ALL_ACTIVE
from finger_bringup.cli import ReadyLine, entries, folder_of, main, namespace_of, parser
from finger_bringup.parameter_files import NO_PARAMETER_FILE, ParameterFile, matches
from finger_bringup.replay import replay_of
from finger_bringup.restarts import RestartDelay
from finger_common.errors import InputError
from finger_common.folder_lock import lock_folder
from finger_common.namespaces import default_folder
from finger_common.parameters import NOT_HERE
from finger_sim.addresses import RigAddresses


@pytest.mark.parametrize("entry", nodes.NODES.values(), ids=lambda e: e.name)
def test_every_entry_is_an_executable_of_its_package(
    entry: nodes.NodeEntry, project_root: Path
) -> None:
    assert importlib.util.find_spec(entry.module) is not None
    setup = (project_root / "src" / entry.package / "setup.cfg").read_text()
    assert f"    {entry.executable} = finger_common.entry:{entry.module}.main\n" in setup


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
    data = yaml.safe_load((tmp_path / nodes.OWN_PARAMETERS).read_text())
    force = data["/left_hand/force"]["ros__parameters"]
    assert force["can_options"] == "port=4711" and force["can_interface"] == "udp_multicast"
    assert data["/left_hand/camera"]["ros__parameters"]["path"].endswith("spool")
    assert data["/left_hand/bring_up"]["ros__parameters"]["order"] == ["force camera"]
    for spec in specs:
        assert "__ns:=/left_hand" in spec.command
        assert spec.command[-1] == str(tmp_path / nodes.OWN_PARAMETERS)


def test_what_the_suite_sets_overrides_the_users_parameter_file(tmp_path: Path) -> None:
    own = tmp_path / "rig.yaml"
    own.write_text("/**/force:\n  ros__parameters: {can_channel: can7}\n")
    file = ParameterFile(own)
    specs = nodes.process_specs(nodes.select(["force"]), tmp_path, parameter_file=file)
    files = [
        w for w, before in zip(specs[0].command[1:], specs[0].command) if before == "--params-file"
    ]
    assert files == [str(own), str(tmp_path / nodes.OWN_PARAMETERS)]


def test_a_parameters_file_of_the_user_in_the_rig_s_folder_stays_as_it_is(tmp_path: Path) -> None:
    own = tmp_path / "parameters.yaml"
    own.write_text("/**/force:\n  ros__parameters: {can_channel: can7}\n")
    before = own.read_bytes()
    nodes.process_specs(nodes.rig(tmp_path), tmp_path, parameter_file=ParameterFile(own))
    assert own.read_bytes() == before


def written(folder: Path) -> dict[str, dict[str, object]]:
    """What the suite sets, by node name."""
    data = yaml.safe_load((folder / nodes.OWN_PARAMETERS).read_text())
    return {name.rsplit("/", 1)[-1]: section["ros__parameters"] for name, section in data.items()}


@pytest.mark.parametrize("pattern", ["/**/protocol", "/**", "/finger/protocol", "/*/protocol"])
def test_what_the_user_s_file_sets_is_no_default_of_the_suite(tmp_path: Path, pattern: str) -> None:
    own = tmp_path / "rig.yaml"
    text = "  ros__parameters: {output: /data/study, need_recorder: true, autostart: true}\n"
    own.write_text(f"{pattern}:\n{text}")
    entries = nodes.rig(tmp_path, without=["recorder"])
    nodes.process_specs(entries, tmp_path)
    assert written(tmp_path)["protocol"] == {
        "autostart": False,
        "output": str(tmp_path / "sessions"),
        "need_recorder": False,
    }
    nodes.process_specs(entries, tmp_path, parameter_file=ParameterFile(own))
    # The order of coming up is the suite's, whatever a copy of the reference file says.
    assert written(tmp_path)["protocol"] == {"autostart": False}


def test_keys_of_a_parameter_file_mean_nodes_as_in_ros() -> None:
    for pattern in ("/**", "/**/force", "/hand/thumb/force", "/hand/*/force", "/hand/**", "/*/*/*"):
        assert matches(pattern, "/hand/thumb/force"), pattern
    for pattern in ("/**/forc", "/*", "/thumb/force", "/hand/thumb", "force", "/*/force"):
        assert not matches(pattern, "/hand/thumb/force"), pattern


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        (["/**", "/**/force", "/hand/*/model", "/hand/thumb/model", "/**/lsl"], ""),
        (
            ["/hand/tumb/model"],
            "section '/hand/tumb/model' (did you mean '/hand/thumb/model'?) is of no node that "
            "runs here, and without effect",
        ),
        (
            ["/**/modle", "/hand/pinky/force", "/hand/thumb/force"],
            "sections '/**/modle', '/hand/pinky/force'",
        ),
        (["force"], "section 'force'"),
    ],
)
def test_sections_of_no_node_are_named(sections: list[str], says: str, tmp_path: Path) -> None:
    own = tmp_path / "hand.yaml"
    own.write_text("".join(f"{name}:\n  ros__parameters: {{}}\n" for name in sections))
    fingers = nodes.hand(["thumb", "index"])
    told = nodes.without_effect(fingers, "hand", ParameterFile(own))
    assert says in told and bool(told) == bool(says)
    assert told == "" or told.startswith(f"{own}: section")


def test_the_rigs_own_file_has_no_section_without_effect() -> None:
    file = ParameterFile(Path(nodes.__file__).parents[1] / "config" / "rig.yaml")
    assert nodes.without_effect(nodes.hand(["thumb"]), "hand", file) == ""


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"thumb/model": "{wrench_topic: /robot/ft}", "index/model": "{wrench_topic: /r/ft}"}, ""),
        (
            {"*/model": "{wrench_topic: /robot/ft}"},
            "'/hand/thumb/model', '/hand/index/model' read the same wrench_topic /robot/ft; give",
        ),
        (
            {"thumb/model": "{wrench_topic: /hand/index/wrench}"},
            "read the same wrench_topic /hand/index/wrench; give each finger its own",
        ),
        (
            {"*/force": "{can_channel: can0, base_identifier: 32}"},
            "'/hand/thumb/force', '/hand/index/force' read the same sensor (socketcan can0, "
            "base_identifier 32); give each finger its own",
        ),
        # One relies on the usual identifier, the other on the usual channel.
        (
            {"thumb/force": "{base_identifier: 32}", "index/force": "{can_channel: can0}"},
            "read the same sensor (socketcan can0, base_identifier 32)",
        ),
        (
            {"*/force": "{device: dbc, can_channel: can1}"},
            "read the same sensor (socketcan can1, dbc_mapping of the Robotous RFT)",
        ),
        (
            {"*/force": "{device: dbc}", "thumb/force": "{can_channel: can1}"},
            "",
        ),
        (
            {"*/force": "{device: dbc}", "thumb/force": "{dbc_mapping: other.yaml}"},
            "",
        ),
        (
            {"*/force": "{can_channel: can0}", "thumb/force": "{base_identifier: 33}"},
            "",
        ),
        (
            {"*/force": "{device: netft, netft_host: ft1}"},
            "read the same sensor (netft_host ft1)",
        ),
        (
            {"*/camera": "{device: folder, path: /frames}"},
            "'/hand/thumb/camera', '/hand/index/camera' read the same camera (path /frames); give",
        ),
        ({"*/camera": "{path: '0'}", "index/camera": "{path: '2'}"}, ""),
        ({"*/camera": "{device: ueye}"}, "read the same camera (camera_id 0)"),
        ({"*/camera": "{device: ueye}", "index/camera": "{camera_id: 2}"}, ""),
        ({"*/force": "{base_identifier: many}"}, ""),  # the node itself says what is wrong
        ({"*/force": "{device: of_somebody, netft_host: ft1}"}, ""),
    ],
)
def test_two_fingers_on_one_sensor_are_named(
    sections: dict[str, str], says: str, tmp_path: Path
) -> None:
    own = tmp_path / "hand.yaml"
    apart = {"index/force": "{base_identifier: 34}"}
    if any(name.endswith("/force") for name in sections):
        apart = {}
    lines = {**sections, **apart}.items()
    own.write_text("".join(f"/hand/{k}:\n  ros__parameters: {v}\n" for k, v in lines))
    file = ParameterFile(own)
    kinds = ["force", "camera", "model"]
    told = nodes.shared_sensors(nodes.hand(["thumb", "index"], kinds), "hand", file)
    assert says in told and bool(told) == bool(says)
    assert nodes.shared_sensors(nodes.hand(["thumb"]), "hand", file) == ""
    _, devices = nodes.simulated_boards(["thumb", "index"])
    simulated = nodes.hand(["thumb", "index"], parameters=devices)
    assert nodes.shared_sensors(simulated, "hand", NO_PARAMETER_FILE) == ""


def test_fingers_have_folders_and_frames_of_their_own(tmp_path: Path) -> None:
    assert folder_of(parser().parse_args(["up"])) == Path("out/rig").absolute()
    assert namespace_of(parser().parse_args(["up", "--namespace", ""])) == ""  # the global one
    assert default_folder("/finger/") == Path("out/rig")
    assert default_folder("hand/thumb") == Path("out/rig_hand_thumb")
    entries = nodes.rig(tmp_path)
    nodes.process_specs(entries, tmp_path)
    assert "frame_prefix" not in written(tmp_path)["force"]
    nodes.process_specs(entries, tmp_path, "hand/thumb")
    for name in nodes.FRAMED:
        assert written(tmp_path)[name]["frame_prefix"] == "hand/thumb/"
    assert "frame_prefix" not in written(tmp_path).get("model", {})
    # Two cameras of one name would read, and overwrite, one calibration.
    assert written(tmp_path)["camera"]["camera_name"] == "hand_thumb_camera"
    nodes.process_specs(nodes.rig(tmp_path, simulated=True), tmp_path, "hand/thumb")
    assert "camera_name" not in written(tmp_path)["camera"]  # its calibration is named by its path


def test_an_option_of_the_command_is_the_last_word(tmp_path: Path) -> None:
    own = tmp_path / "rig.yaml"
    own.write_text("/**/page:\n  ros__parameters: {port: 9000}\n")
    file = ParameterFile(own)
    arguments = ["up", "--simulated", "--folder", str(tmp_path), "--port", "9001", "--seed", "7"]
    nodes.process_specs(entries(parser().parse_args(arguments)), tmp_path, parameter_file=file)
    assert written(tmp_path)["page"]["port"] == 9001
    assert written(tmp_path)["simulated_rig"]["seed"] == 7
    nodes.process_specs(entries(parser().parse_args(arguments[:4])), tmp_path)
    assert "port" not in written(tmp_path)["page"]
    assert "seed" not in written(tmp_path)["simulated_rig"]
    arguments = ["up", "--fingers", "thumb", "--nodes", "force", "page", "--port", "9001"]
    nodes.process_specs(entries(parser().parse_args(arguments)), tmp_path, parameter_file=file)
    assert written(tmp_path)["page"]["port"] == 9001


def test_namespaces_of_a_parameter_file_may_be_nested(tmp_path: Path) -> None:
    """As ROS takes them: outer keys are namespaces."""
    path = tmp_path / "nested.yaml"
    path.write_text(
        "hand:\n"
        "  thumb:\n"
        "    model: {ros__parameters: {default_moisture: 100.0}}\n"
        "    force: {ros__parameters: {can_channel: can7}}\n"
        "/hand/thumb/model: {ros__parameters: {normal_axis: +x}}\n"
        "/**:\n"
        "  force: {ros__parameters: {rate: 250.0}}\n"
        "/hand/index:\n"
        "  model: {ros__parameters: {default_moisture: 90.0}}\n"
    )
    file = ParameterFile(path)
    thumb = {"default_moisture": 100.0, "normal_axis": "+x"}
    assert file.values_of("/hand/thumb/model") == thumb
    assert file.values_of("/hand/thumb/force") == {"can_channel": "can7", "rate": 250.0}
    assert file.values_of("/hand/index/model") == {"default_moisture": 90.0}
    assert file.values_of("/model") == {}
    entries = nodes.hand(["thumb", "index"])
    assert nodes.without_effect(entries, "hand", file) == ""
    told = nodes.without_effect(nodes.hand(["index"]), "hand", file)
    assert "'hand/thumb/model'" in told and "'/hand/index/model'" not in told.replace(
        "(did you mean '/hand/index/model'?)", ""
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("force: {rate: 500.0}\n", "'force' has no 'ros__parameters'"),
        ("/**/force:\n  ros__parameters: 5\n", "has no 'ros__parameters'"),
        (
            "/**:\n  ros__parameters: {a: true}\n  force: {ros__parameters: {rate: 2.0}}\n",
            "'/**' has 'force' beside 'ros__parameters'",
        ),
        ("hand:\n  force: {rate: 500.0}\n", "'hand/force' has no 'ros__parameters'"),
        ("a: [1\n", "not valid YAML"),
        ("/**/force:\n  ros__parameters: {rate: 1,35}\n", "'/**/force': '35' has no value; give"),
        ("/**/force:\n  ros__parameters: {qos: {depth: }}\n", "'qos': 'depth' has no value; give"),
        ("/**/page:\n  ros__parameters: {hosts: [a, 1]}\n", "'hosts' holds values of several"),
        ("/**/page:\n  ros__parameters: {hosts: [[a], [b]]}\n", "'hosts' is a list of lists"),
    ],
)
def test_a_file_that_is_no_parameter_file_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(str(path))) as error:
        _ = ParameterFile(path).sections
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
        (["up", "--nodes", "force", "--without", "force"], "no node is left to run; leave out"),
        (
            ["up", "--fingers", "thumb", "--without", "force", "model"],
            "no node is left to run; leave out",
        ),
        (["up", "--parameters", "missing.yaml"], "missing.yaml: no such parameter file"),
        (["up", "--namespace", "2nd"], "namespace '2nd' is not one of ROS; use letters"),
        (["up", "--namespace", "hand//thumb"], "namespace 'hand//thumb' is not one of ROS"),
        (["up", "--namespace", "my rig"], "namespace 'my rig' is not one of ROS"),
        (["up", "--namespace", "my__rig"], "namespace 'my__rig' is not one of ROS"),
        (["up", "--seed", "2"], "--seed is for the node 'simulated_rig', which would not run"),
        (["up", "--port", "9001", "--without", "page"], "--port is for the node 'page', which"),
        (["calibrate", "--subject", "S01"], "--folder is for a simulated rig; give --simulated"),
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


@pytest.mark.parametrize(
    ("discovery", "localhost_only", "wide"),
    [
        ("", "", True),
        ("SUBNET", "0", True),
        ("SYSTEM_DEFAULT", "", True),
        ("LOCALHOST", "", False),
        ("OFF", "", False),
        ("SUBNET", "1", False),
    ],
)
def test_a_rig_whose_topics_reach_other_computers_says_so_at_its_start(
    discovery: str,
    localhost_only: str,
    wide: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery)
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", localhost_only)
    monkeypatch.setattr(cli, "run_until_interrupted", lambda supervisor: True)
    assert main(["up", "--nodes", "page", "--folder", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert said.count("reach the local network") == wide
    assert said.count("ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST") == said.count("\n") == wide


def test_the_ready_line_comes_once_all_are_active_and_the_page_is_served() -> None:
    active = f"[bring_up] {ALL_ACTIVE}: force, camera"
    page = "[page] operator's page: http://127.0.0.1:8080/"
    news = "all ready: page at http://127.0.0.1:8080/"
    for lines, says in (
        ([page, "x", active, page, active], ["", "", news, "", news]),
        ([active, page], ["", news]),
    ):
        ready = ReadyLine(pages=1)
        assert [ready.take(line) for line in lines] == says
    assert ReadyLine(pages=0).take(active) == "all ready"


def test_a_rig_whose_page_is_refused_is_not_called_ready() -> None:
    active = f"[INFO] [1.0] [finger.bring_up]: {ALL_ACTIVE}: force, camera"
    why = "parameter 'port' is 808080, outside 0 … 65535; correct it"
    refused = f"[ERROR] [1.0] [finger.page]: configure failed: {why}"
    served = "[INFO] [2.0] [finger.page]: operator's page: http://127.0.0.1:8080/"
    told = f"ready but for the page, which is not served: {why}"
    for lines in ([refused, active], [active, refused]):
        ready = ReadyLine(pages=1)
        assert [ready.take(line) for line in lines] == ["", told]
        assert ready.take(served) == "all ready: page at http://127.0.0.1:8080/"


def test_parameters_that_no_node_has_are_named_when_the_rig_is_ready(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(
        "/**/protocol:\n  ros__parameters: {trails: 5, trials: 5}\n"
        "/**:\n  ros__parameters: {normal_axis: +z, qos: {dept: 3}}\n"
        "/thumb/protocol:\n  ros__parameters: {trail: 5}\n"
    )
    ready = ReadyLine(pages=1)
    for node, name, known in (
        ("protocol", "trails", "did you mean 'trials'? Known are trials, subject"),
        ("protocol", "qos.dept", "known are trials, subject"),
        ("camera", "normal_axis", "known are path"),
        ("camera", "qos.dept", "did you mean 'qos_depth'? Known are path"),
    ):
        said = f"[WARN] [1.0] [finger.{node}]: {NOT_HERE.format(name)}; {known}"
        assert ready.take(said) == ""
    file = ParameterFile(path)
    assert file.unknown_parameters(["/finger/protocol", "/finger/camera"], ready.unknown) == [
        "'trails' of '/**/protocol' (did you mean 'trials'?)",
        "'qos.dept' of '/**'",
    ]
    assert file.unknown_parameters(["/finger/protocol"], {}) == []


def test_the_ready_line_names_the_pages_of_all_fingers() -> None:
    ready = ReadyLine(pages=2)
    pages = [
        f"[INFO] [1.5] [hand.{finger}.page]: operator's page: http://127.0.0.1:{port}/"
        for finger, port in (("thumb", 8080), ("index", 40001))
    ]
    says = [ready.take(line) for line in (pages[0], ALL_ACTIVE, pages[0], pages[1])]
    news = "all ready: pages at thumb http://127.0.0.1:8080/, index http://127.0.0.1:40001/"
    assert says == ["", "", "", news]


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
    # Devices are simulated by a node, which comes with them.
    simulated = names("--simulated", "--nodes", "force", "model", *folder)
    assert simulated == ["simulated_rig", *nodes.GRASP, "bring_up"]


def test_foxglove_runs_beside_the_rig_on_this_machine_unless_told_otherwise() -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")

    def entry(*options: str) -> nodes.NodeEntry:
        found = entries(parser().parse_args(["up", *options]))
        return next(e for e in found if e.name == "foxglove")

    # Without an address the parameter file decides, and the node's default is this machine.
    assert not {"host", "port"} & entry("--foxglove").parameters.keys()
    assert entry("--nodes", "force", "--foxglove", "9000").parameters["host"] == "127.0.0.1"
    chosen = entry("--foxglove", "[::]:0").parameters
    assert (chosen["host"], chosen["port"]) == ("::", 0)


def test_a_rig_without_recorder_does_not_wait_for_one(tmp_path: Path) -> None:
    chosen = {entry.name: entry for entry in nodes.rig(tmp_path, without=["recorder"])}
    assert chosen["protocol"].defaults["need_recorder"] is False
    assert "need_recorder" not in {e.name: e for e in nodes.rig(tmp_path)}["protocol"].defaults


def test_restarts_slow_down_and_are_quick_again_after_a_stable_minute() -> None:
    delay = RestartDelay()
    assert [delay.after_running(0.1) for _ in range(6)] == [1.0, 2.0, 4.0, 8.0, 15.0, 15.0]
    assert delay.after_running(61.0) == 1.0
    assert RestartDelay().note_end(2, 1.0)
    assert not RestartDelay().note_end(1, 1.0) and not RestartDelay().note_end(2, 3600.0)
    assert not delay.note_end(1, 1.0) and not delay.note_end(2, 1.0)


def test_a_replay_has_areas_whatever_the_images_of_the_bag(
    tmp_path: Path, project_root: Path
) -> None:
    natural = project_root / "bags" / "natural"
    shown = replay_of(natural)
    # Its images are compressed ones of some trials: its areas are replayed, unless asked for.
    assert shown.nodes == ("model",) and "/finger/contact_area" in shown.topics
    assert not {"/finger/contact_state", "/diagnostics"} & set(shown.topics)
    again = replay_of(natural, vision=True)
    assert (again.nodes, again.image_transport) == (("vision", "model"), "compressed")
    assert "/finger/contact_area" not in again.topics and again.calibration
    with BagWriter(tmp_path / "none") as bag:
        bag.write("contact_area", {"header": {"stamp": 10**18}})
    with pytest.raises(InputError, match="holds no images"):
        replay_of(tmp_path / "none", vision=True)
    with BagWriter(tmp_path / "raw") as bag:
        bag.attach("plate_calibration.yaml", b"a: 1")
        for topic in ("image_raw", "contact_area", "wrench"):
            bag.write(topic, {"header": {"stamp": 10**18}})
    measured = replay_of(tmp_path / "raw")
    assert measured.nodes == ("vision", "model")
    assert measured.topics == ("/finger/image_raw", "/finger/wrench")
    assert set(measured.heard) == set(measured.topics)
    assert measured.calibration == b"a: 1" and measured.image_transport == "raw"
    assert replay_of(tmp_path / "raw", vision=False).nodes == ("model",)


def test_a_replay_runs_in_the_namespace_of_the_bag_and_is_refused_where_nothing_is_heard(
    tmp_path: Path,
) -> None:
    def bag_of(name: str, *topics: str) -> Path:
        with BagWriter(tmp_path / name) as bag:
            for topic in topics:
                bag.write(topic, {"header": {"stamp": 10**18}})
        return tmp_path / name

    thumb = bag_of("thumb", "/thumb/wrench", "/thumb/contact_area")
    assert replay_of(thumb).namespace == "/thumb" == replay_of(thumb, namespace="thumb").namespace
    assert replay_of(bag_of("global", "/wrench")).namespace == "/"
    with pytest.raises(InputError, match=r"no 'wrench' in namespace '/finger'.* /thumb/wrench"):
        replay_of(thumb, namespace="finger")
    hand = bag_of("hand", "/hand/index/wrench", "/hand/thumb/wrench", "/hand/thumb/image_raw")
    with pytest.raises(InputError, match="several fingers, /hand/index, /hand/thumb"):
        replay_of(hand)
    assert replay_of(hand, namespace="hand/index").nodes == ("model",)
    assert replay_of(hand, namespace="hand/thumb").nodes == ("vision", "model")
    pictures = bag_of("pictures", "/thumb/image_raw/compressed")
    with pytest.raises(InputError, match=r"no 'wrench'.*vision:=true measures its images"):
        replay_of(pictures)
    measured = replay_of(pictures, vision=True)
    assert (measured.namespace, measured.heard) == ("/thumb", ("/thumb/image_raw/compressed",))
    with pytest.raises(InputError, match="no 'wrench'"):
        replay_of(bag_of("empty"))
    # A parameter file may name another vendor's topic.
    robot = bag_of("robot", "/wrist/wrench")
    assert replay_of(robot, namespace="robot", wrench="/wrist/wrench").namespace == "/robot"


def test_fingers_run_side_by_side_each_in_its_namespace(tmp_path: Path) -> None:
    boards, devices = nodes.simulated_boards(["thumb", "index"])
    entries = nodes.hand(["thumb", "index"], parameters=devices)
    paths = ["thumb/force", "index/force", "thumb/model", "index/model", "bring_up"]
    assert [entry.path for entry in entries] == paths
    assert entries[-1].parameters["order"] == [" ".join(paths[:2]), " ".join(paths[2:4])]
    specs = nodes.process_specs(entries, tmp_path, nodes.HAND_NAMESPACE)
    assert [spec.name for spec in specs] == paths
    assert "__ns:=/hand/index" in specs[1].command and "__ns:=/hand" in specs[-1].command
    data = yaml.safe_load((tmp_path / nodes.OWN_PARAMETERS).read_text())
    assert [board.name for board in boards] == ["thumb/board", "index/board"]
    force = [data[f"/hand/{name}/force"]["ros__parameters"] for name in ("thumb", "index")]
    # No finger hears another one's board.
    assert force[0]["can_channel"] != force[1]["can_channel"]


def test_composed_nodes_are_one_process_and_the_others_stay_their_own(tmp_path: Path) -> None:
    entries = nodes.rig(tmp_path, simulated=True)
    specs = nodes.process_specs(entries, tmp_path, "finger", compose=True)
    assert [spec.name for spec in specs] == ["simulated_rig", "nodes"]
    together = [part for part in specs[1].command if "=" in part]
    assert together[0] == "/finger=finger_driver.force_node"
    # The last one is ended first: the node that would bring the others up again.
    assert together[-1] == "/finger=finger_bringup.bring_up_node"
    assert len(together) == len(entries) - 1
    assert "--realtime" not in specs[1].command
    specs = nodes.process_specs(entries, tmp_path, "finger", compose=True, realtime=True)
    assert ["--realtime" in spec.command for spec in specs] == [False, True]
    assert "-r" not in specs[1].command  # a remapping would be that of every node in the process


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--fingers", "thumb", "2nd"], "finger '2nd' is no ROS name"),
        (["--fingers", "thumb__2"], "finger 'thumb__2' is no ROS name; use letters, digits and"),
        (["--fingers", "thumb", "thumb"], "finger 'thumb' is named twice"),
        (["--fingers", "--without", "page"], "node 'page' would not run anyway"),
        (["--fingers", "--port", "9001"], "--port is for the node 'page', which would not run"),
        (
            ["--fingers", "thumb", "index", "--nodes", "page", "--port", "9001"],
            "--port: the pages of several fingers cannot share a port",
        ),
        (["--fingers", "--simulated", "--seed", "2"], "--seed is for the node 'simulated_rig'"),
        (["--fingers", "--lsl"], "--lsl exchanges the streams of one finger"),
        (["--fingers", "--realtime"], "--realtime is for the process of --compose; give both"),
    ],
)
def test_fingers_that_cannot_be_are_refused(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["up", *arguments, "--folder", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_the_command_starts_nodes_before_it_could_import_a_finger() -> None:
    script = (
        "import sys; import finger_bringup.cli; "
        "assert not {'numba', 'scipy', 'cv2', 'meshio'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
