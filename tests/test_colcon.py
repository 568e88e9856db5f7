"""The same sources build with colcon, over the project's environment in place of an apt ROS."""

from __future__ import annotations

import configparser
import os
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
