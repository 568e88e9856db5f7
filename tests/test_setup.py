"""Setting up says in one sentence what a machine lacks."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def setup_env(project_root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "setup_env", project_root / "scripts" / "setup_env.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_this_machine_has_what_is_needed(setup_env: ModuleType) -> None:
    setup_env.check_machine()


def test_an_unsupported_python_is_named_with_the_remedy(
    setup_env: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup_env.sys, "version_info", (3, 9, 18))
    with pytest.raises(setup_env.SetupError, match=r"Python 3\.9 is not supported.*PYTHON="):
        setup_env.check_machine()


def test_a_missing_compiler_ends_set_up_with_one_line(project_root: Path, tmp_path: Path) -> None:
    for tool in ("cc", "gcc", "clang"):
        (tmp_path / tool).write_text("#!/bin/sh\n")
        (tmp_path / tool).chmod(0o755)
    done = subprocess.run(
        [sys.executable, str(project_root / "scripts" / "setup_env.py"), "--env", tmp_path / "env"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr == "setup: No compiler found (c++ or g++ or clang++): install g++.\n"
    assert not (tmp_path / "env").exists()


def test_a_missing_python_is_named_by_make(project_root: Path) -> None:
    done = subprocess.run(
        ["make", "setup", "PYTHON=python3.0"], cwd=project_root, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[0].startswith("setup: python3.0 not found: install Python")


def test_a_failed_step_names_its_log_and_is_tried_again(
    setup_env: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = setup_env.Environment(tmp_path)
    with pytest.raises(setup_env.SetupError, match=r"setup\.log"):
        env.step("a", "1", "trying", lambda: env.run(sys.executable, "-c", "raise SystemExit(3)"))
    ran: list[int] = []
    for _ in range(2):
        setup_env.Environment(tmp_path).step("a", "1", "trying", lambda: ran.append(1))
    assert len(ran) == 1, "once done, a step is not repeated"
    setup_env.Environment(tmp_path).step("a", "2", "trying", lambda: ran.append(1))
    assert len(ran) == 2, "changed inputs run it again"


def test_a_folder_that_is_no_environment_is_left_as_it_is(
    project_root: Path, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    done = subprocess.run(
        [sys.executable, str(project_root / "scripts" / "setup_env.py"), "--env", tmp_path],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "is no Python environment" in done.stderr and "--env" in done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_folder_whose_name_the_build_cannot_use_is_refused_by_make_at_once(
    project_root: Path, tmp_path: Path
) -> None:
    """CMake's macros of ROS messages fail there, minutes later; a blank is fine."""
    folder = tmp_path / "Müller"
    done = subprocess.run(
        ["make", "setup", f"ENV={folder}"], cwd=project_root, capture_output=True, text=True
    )
    said = done.stderr.splitlines()[0]
    assert done.returncode == 2 and not folder.exists()
    assert said.startswith("setup: CMake cannot build") and "make setup ENV=/" in said


def test_the_image_has_the_versions_that_apt_s_ros_needs(project_root: Path) -> None:
    """As the README names them."""
    pins = re.compile(r'"[a-z-]+<[0-9.]+"')
    readme = (project_root / "README.md").read_text()
    (line,) = [line for line in readme.splitlines() if line.startswith("pip install -r")]
    wanted = pins.findall(line)
    assert wanted and set(wanted) <= set(pins.findall((project_root / "Dockerfile").read_text()))
