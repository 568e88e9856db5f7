"""The same sources build with colcon, over the project's environment in place of an apt ROS."""

from __future__ import annotations

import configparser
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("colcon_core", reason="colcon is not installed")

# It compiles finger_msgs: minutes on a busy machine.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """Workspace built with colcon from the sources of this checkout."""
    folder = tmp_path_factory.mktemp("colcon")
    prefix = Path(sys.prefix)
    env = {
        **os.environ,
        "PATH": f"{prefix / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(prefix),
        "CMAKE_PREFIX_PATH": str(prefix),
        "COLCON_DEFAULTS_FILE": os.devnull,
        "COLCON_HOME": str(folder / "home"),
        # Of its own accord colcon lets ninja start no job while the load is above the cores.
        "MAKEFLAGS": "-j2",
    }
    command = [sys.executable, "-m", "colcon", "--log-base", str(folder / "log"), "build"]
    command += ["--base-paths", str(project_root / "src"), "--build-base", str(folder / "build")]
    command += ["--install-base", str(folder / "install"), "--executor", "sequential"]
    command += ["--cmake-args", "-G", "Ninja", f"-DPython3_EXECUTABLE={sys.executable}"]
    command += [f"-DPYTHON_EXECUTABLE={sys.executable}", "-DBUILD_TESTING=OFF"]
    result = subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    return folder / "install"


def packages(project_root: Path) -> list[str]:
    return sorted(p.name for p in (project_root / "src").iterdir() if (p / "package.xml").exists())


def test_every_package_is_in_the_ament_index_with_its_package_xml(
    workspace: Path, project_root: Path
) -> None:
    for name in packages(project_root):
        share = workspace / name / "share"
        assert (share / "ament_index" / "resource_index" / "packages" / name).exists(), name
        assert (share / name / "package.xml").exists(), name


def test_executables_are_where_ros2_run_looks(workspace: Path, project_root: Path) -> None:
    for name in packages(project_root):
        setup = configparser.ConfigParser()
        setup.read(project_root / "src" / name / "setup.cfg")
        commands = setup.get("options.entry_points", "console_scripts", fallback="")
        for command in commands.strip().splitlines():
            path = workspace / name / "lib" / name / command.split("=")[0].strip()
            assert path.exists() and os.access(path, os.X_OK), path


def test_messages_import_from_the_workspace_and_carry_their_constants(workspace: Path) -> None:
    site = next((workspace / "finger_msgs").glob("lib/python*/site-packages"))
    code = (
        "from finger_msgs.msg import ContactArea; import finger_msgs; "
        "print(finger_msgs.__file__, ContactArea.FLAG_CLIPPED)"
    )
    library = workspace / "finger_msgs" / "lib"
    search = os.pathsep.join([str(library), os.environ.get("LD_LIBRARY_PATH", "")])
    env = {**os.environ, "PYTHONPATH": str(site), "LD_LIBRARY_PATH": search}
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=env, check=True
    ).stdout.split()
    assert out[0].startswith(str(workspace)) and out[1] == "4"


def test_the_images_links_put_the_commands_on_the_path(
    workspace: Path, project_root: Path, tmp_path: Path
) -> None:
    """The step of the Dockerfile, into an empty folder; the workspace's Python path as it sets."""
    script = project_root / "scripts" / "link_commands.sh"
    subprocess.run([script, workspace, tmp_path / "bin"], check=True)
    found = sorted(file.name for file in (tmp_path / "bin").iterdir())
    assert {"finger-bag", "finger-fit", "finger-model", "finger-rig", "finger-vision"} <= set(found)
    sites = sorted(workspace.glob("*/lib/python*/site-packages"))
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sites))}
    for command in ("finger-rig", "finger-model"):
        said = subprocess.run(
            [tmp_path / "bin" / command, "--help"], capture_output=True, text=True, env=env
        )
        assert said.returncode == 0 and command in said.stdout, said.stderr


def test_the_images_entry_finds_commands_and_messages(
    workspace: Path, project_root: Path, tmp_path: Path
) -> None:
    """The script that the Dockerfile writes, with the folders of this machine in its lines."""
    dockerfile = (project_root / "Dockerfile").read_text()
    written = re.search(r"printf '%s\\n' (.*?) > /entry.sh", dockerfile, re.DOTALL)
    assert written is not None
    lines = re.findall(r"'([^']*)'", written[1])
    folders = {
        "/opt/ros/jazzy/setup.sh": os.devnull,  # this environment's wheels are in its place
        "/finger/venv": sys.prefix,
        "/finger/install": str(workspace),
    }
    for theirs, ours in folders.items():
        assert sum(theirs in line for line in lines) == 1
        lines = [line.replace(theirs, ours) for line in lines]
    entry = tmp_path / "entry.sh"
    entry.write_text("\n".join(lines) + "\n")
    entry.chmod(0o755)
    script = project_root / "scripts" / "link_commands.sh"
    subprocess.run([script, workspace, tmp_path / "bin"], check=True)
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "AMENT_PREFIX_PATH")}
    env["PATH"] = f"{tmp_path / 'bin'}{os.pathsep}/usr/bin{os.pathsep}/bin"

    def run(*command: str) -> str:
        done = subprocess.run(
            [entry, *command], env=env, cwd=tmp_path, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    default = re.search(r"^CMD \[(.*)\]$", dockerfile, re.MULTILINE)
    assert default is not None
    command = re.findall(r'"([^"]*)"', default[1])
    assert f"usage: {command[0]} {command[1]}" in run(*command[:2], "--help")
    code = "import finger_msgs.msg, finger_bringup; print(finger_msgs.__file__); "
    files = run("python", "-c", code + "print(finger_bringup.__file__)").split()
    assert all(file.startswith(str(workspace)) for file in files), files
