"""The rules of docs/architecture.md, held against the sources."""

from __future__ import annotations

import ast
import configparser
import re
import subprocess
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
import yaml

LAYERS = {
    "finger_common": set(),
    "finger_driver": {"finger_common"},
    "finger_vision": {"finger_common"},
    "finger_model": {"finger_common"},
    "finger_bag": {"finger_common"},
    "finger_offline": {"finger_common", "finger_bag", "finger_vision", "finger_model"},
    "finger_fit": {
        "finger_common",
        "finger_bag",
        "finger_offline",
        "finger_vision",
        "finger_model",
    },
    "finger_operator": {"finger_common", "finger_bag"},
    "finger_bridge": {"finger_common"},
    "finger_sim": {
        "finger_common",
        "finger_driver",
        "finger_vision",
        "finger_model",
        "finger_bag",
    },
    "finger_bringup": {
        "finger_common",
        "finger_bag",
        "finger_driver",
        "finger_model",
        "finger_sim",
        "finger_bridge",
    },
}
"""Package -> packages it may import (finger_msgs only in nodes)."""

ROS = re.compile(r"^(rclpy|launch|launch_ros|finger_msgs|\w+_msgs|rosgraph_msgs|std_srvs|rcl_\w+)$")

ROSDEP = {
    "python3-aiohttp",
    "python3-can",
    "python3-cantools-pip",
    "python3-matplotlib",
    "python3-meshio",
    "python3-numba",
    "python3-numpy",
    "python3-opencv",
    "python3-openpyxl",
    "python3-pytest",
    "python3-argcomplete",
    "python3-rich",
    "python3-rosbags-pip",
    "python3-scipy",
    "python3-serial",
    "python3-yaml",
}
"""Keys of rosdep's public list (python.yaml of ros/rosdistro) that the suite uses."""

JAZZY = {
    "action_msgs",
    "ament_cmake",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "launch",
    "launch_ros",
    "lifecycle_msgs",
    "rcl_interfaces",
    "rclpy",
    "ros2cli",
    "rosgraph_msgs",
    "rosidl_default_generators",
    "rosidl_default_runtime",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_ros",
}
"""Packages of ROS 2 Jazzy that the suite names."""


def modules(root: Path) -> Iterator[tuple[str, Path, ast.Module]]:
    """(package, file, syntax tree) of every module of the suite."""
    for package in LAYERS:
        for file in sorted((root / "src" / package / package).rglob("*.py")):
            yield package, file, ast.parse(file.read_text(), str(file))


def imports(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, absolute module name) of every import, those inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield from ((node.lineno, f"{node.module}.{a.name}") for a in node.names)


def imported_folders(root: Path, file: Path, tree: ast.Module) -> Iterator[str]:
    """Folders of the package `root` that a module of it imports relatively, but for its own."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            module = file.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for alias in node.names:
                folder = (module / alias.name).relative_to(root).parts[0]
                if (root / folder).is_dir() and folder != file.relative_to(root).parts[0]:
                    yield folder


def is_ros_module(file: Path) -> bool:
    """Whether a module may import ROS: a node, the base of nodes or a launch file."""
    return file.stem.endswith("_node") or "node" in file.parts or "launch" in file.parts


def test_imports_point_one_way(project_root: Path) -> None:
    wrong = []
    for package, file, tree in modules(project_root):
        for line, name in imports(tree):
            top = name.split(".")[0]
            if top in LAYERS and top != package and top not in LAYERS[package]:
                wrong.append(f"{file.relative_to(project_root)}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_folders_of_a_package_import_one_way(project_root: Path) -> None:
    graphs: dict[Path, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for package, file, tree in modules(project_root):
        root = project_root / "src" / package / package
        if file.parent != root:
            folder = file.relative_to(root).parts[0]
            graphs[root][folder].update(imported_folders(root, file, tree))
    assert graphs
    for root, graph in graphs.items():
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            pytest.fail(f"{root.name}: folders import one another: {' → '.join(error.args[1])}")


def test_cores_import_no_ros(project_root: Path) -> None:
    wrong = []
    for _, file, tree in modules(project_root):
        if is_ros_module(file):
            continue
        for line, name in imports(tree):
            if ROS.match(name.split(".")[0]):
                wrong.append(f"{file.relative_to(project_root)}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_no_package_reaches_into_the_private_parts_of_another(project_root: Path) -> None:
    wrong = []
    for package, file, tree in modules(project_root):
        for line, name in imports(tree):
            parts = name.split(".")
            if parts[0] in LAYERS and parts[0] != package and any(p[:1] == "_" for p in parts[1:]):
                wrong.append(f"{file.relative_to(project_root)}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)


def interface_lines(root: Path) -> Iterator[tuple[Path, int, str, str]]:
    """(file, line number, code, comment) of every line with code of the interface files."""
    for file in sorted((root / "src" / "finger_msgs").glob("*/*.*")):
        for number, line in enumerate(file.read_text().splitlines(), 1):
            code, _, comment = line.partition("#")
            if code.strip() and code.strip() != "---":
                yield file, number, code.strip(), comment.strip()


def test_every_field_has_a_meaning(project_root: Path) -> None:
    plain = re.compile(r"(^bool success$)|(^string message$)")
    bare = [
        f"{file.name}:{number} {code}"
        for file, number, code, comment in interface_lines(project_root)
        if not comment and "=" not in code and not plain.search(code)
    ]
    assert not bare, "\n".join(bare)


def test_every_physical_number_carries_its_unit(project_root: Path) -> None:
    unit = re.compile(r"(m\^2|m\^4|\bm\b|\bN\b|\bPa\b|\bs\b|\brad\b|a\.u\.|0\.\.1|dimensionless)")
    bare = [
        f"{file.name}:{number} {code}"
        for file, number, code, comment in interface_lines(project_root)
        if code.startswith("float") and not unit.search(comment)
    ]
    assert not bare, "\n".join(bare)


def test_flags_are_distinct_bits(project_root: Path) -> None:
    for file in sorted((project_root / "src" / "finger_msgs" / "msg").glob("*.msg")):
        flags = [int(v) for v in re.findall(r"FLAG_\w+ = (\d+)", file.read_text())]
        assert len(set(flags)) == len(flags)
        assert all(flag & (flag - 1) == 0 and flag for flag in flags), file.name


@pytest.mark.parametrize("package", sorted([*LAYERS, "finger_msgs"]))
def test_package_xml_names_what_rosdep_and_the_workspace_know(
    project_root: Path, package: str
) -> None:
    tree = ElementTree.parse(project_root / "src" / package / "package.xml")
    assert tree.findtext("name") == package
    assert tree.findtext("license") == "Apache-2.0"
    named = {e.text for e in tree.getroot() if e.tag.endswith("depend")}
    own = set(yaml.safe_load((project_root / "rosdep.yaml").read_text()))
    assert not own & ROSDEP, "the public list has them"
    unknown = named - own - ROSDEP - JAZZY - set(LAYERS) - {"finger_msgs"}
    assert not unknown, f"{package}: neither rosdep keys nor packages: {sorted(map(str, unknown))}"


def test_package_xml_names_every_ros_package_imported(project_root: Path) -> None:
    wrong = []
    for package, file, tree in modules(project_root):
        xml = ElementTree.parse(project_root / "src" / package / "package.xml")
        named = {e.text for e in xml.getroot() if e.tag.endswith("depend")}
        for line, name in imports(tree):
            top = name.split(".")[0]
            if top != package and (ROS.match(top) or top in LAYERS) and top not in named:
                wrong.append(f"{package}: {file.name}:{line} imports {top}, not in package.xml")
    assert not wrong, "\n".join(sorted(set(wrong)))


@pytest.mark.parametrize("package", sorted(LAYERS))
def test_pip_installs_the_same_packages_of_the_suite_as_rosdep(
    project_root: Path, package: str
) -> None:
    """finger_msgs, which CMake builds, is no package of pip's."""
    folder = project_root / "src" / package
    xml = ElementTree.parse(folder / "package.xml")
    named = {e.text for e in xml.getroot() if e.tag in ("depend", "exec_depend")}
    setup = configparser.ConfigParser()
    setup.read(folder / "setup.cfg")
    required = set(setup["options"]["install_requires"].split())
    assert required & set(LAYERS) == named & set(LAYERS)


def test_every_executable_starts_under_guard_of_ctrl_c(project_root: Path) -> None:
    found = 0
    for package in LAYERS:
        setup = configparser.ConfigParser()
        setup.read(project_root / "src" / package / "setup.cfg")
        commands = setup.get("options.entry_points", "console_scripts", fallback="")
        for command in commands.split("\n")[1:]:
            name, _, target = command.partition(" = ")
            assert target.startswith(f"finger_common.entry:{package}."), name
            found += 1
    assert found > 15


def test_versions_agree(project_root: Path) -> None:
    versions = set()
    for package in [*LAYERS, "finger_msgs"]:
        folder = project_root / "src" / package
        versions.add(ElementTree.parse(folder / "package.xml").findtext("version"))
    assert len(versions) == 1, versions


def test_setup_files_are_alike_and_take_all_facts_from_package_xml(project_root: Path) -> None:
    texts = {file.read_text() for file in project_root.glob("src/*/setup.py")}
    assert len(texts) == 1
    assert 'ElementTree.parse("package.xml")' in texts.pop()


WIDTH = 100
"""Columns of a line of text, in characters."""

NOT_WRAPPED = {".json", ".ipynb", ".csv", ".svg", ".py", ".rst"}
"""Files of programs and of numbers; ruff checks Python, the change logs are written by a script."""

EXCEPTIONS = (
    "src/finger_bringup/config/plotjuggler_layout.xml",
    "src/finger_operator/finger_operator/page/static/uplot.",
)
"""Beginnings of the names of further files that are not checked."""


def long_lines(file: Path) -> list[int]:
    """Numbers of the lines that are too long; tables, links and files of programs may have any."""
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return []
    return [
        number
        for number, line in enumerate(text.splitlines(), 1)
        if len(line) > WIDTH and not line.lstrip().startswith("|") and "://" not in line
    ]


def test_lines_of_text_files_are_at_most_100_characters(project_root: Path) -> None:
    listed = subprocess.run(
        ["git", "-C", str(project_root), "ls-files"], capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("the files are not in a git checkout")
    found = [
        f"{name}:{number}"
        for name in listed.stdout.splitlines()
        if Path(name).suffix not in NOT_WRAPPED and (project_root / name).is_file()
        if not name.startswith(EXCEPTIONS)
        for number in long_lines(project_root / name)
    ]
    assert not found, found
