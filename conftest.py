"""Fixtures for all tests: isolated ROS domains and child processes that end with the test."""

from __future__ import annotations

import importlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from finger_common.domains import DOMAINS, free_domain
from finger_common.processes import bound_to_parent

ROOT = Path(__file__).resolve().parent

# Compiled kernels and BLAS share two cores with the nodes under test.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts background processes with Ctrl-C ignored, and children inherit it; tests end
    # them by it.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def signals_stay_handled() -> Iterator[None]:
    """No test leaves other handlers of Ctrl-C and SIGTERM: later processes would inherit them."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    yield
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.fixture(scope="session")
def project_root() -> Path:
    """Folder of the checkout."""
    return ROOT


@pytest.fixture(scope="module")
def module_of(project_root: Path) -> Iterator[Callable[[str], Any]]:
    """Function that gives a file of the project, such as "scripts/recovery.py", as a module.

    Its folder is importable meanwhile, also for the worker processes that it starts.
    """
    with pytest.MonkeyPatch.context() as patch:

        def load(name: str) -> Any:
            path = project_root / name
            patch.syspath_prepend(str(path.parent))
            module = importlib.import_module(path.stem)
            assert Path(str(module.__file__)) == path, f"another module is named {path.stem}"
            return module

        yield load


@pytest.fixture(scope="session")
def install_package() -> Callable[..., None]:
    """Function that puts a package into a folder as pip leaves it.

    Its arguments: the folder, the text of each module by name, the entry points by group and name.
    """

    def install(folder: Path, modules: dict[str, str], entries: dict[str, dict[str, str]]) -> None:
        for name, text in modules.items():
            (folder / f"{name}.py").write_text(text)
        metadata = folder / "outside-1.0.dist-info"
        metadata.mkdir(exist_ok=True)
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
        lines = [
            line
            for group, members in entries.items()
            for line in (f"[{group}]", *(f"{name} = {value}" for name, value in members.items()))
        ]
        (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")

    return install


@pytest.fixture
def session(tmp_path: Path) -> Callable[..., Path]:
    """Function that writes a session bag into the test's folder, with the options of
    `session_bags.write_session`."""
    from session_bags import write_session

    def write(name: str = "session", **options: Any) -> Path:
        return write_session(tmp_path / name, **options)

    return write


@pytest.fixture(scope="session")
def fingerprints(project_root: Path) -> Path:
    """Folder of the real fingerprint images; skips where they are absent."""
    folder = project_root.parent / "shared" / "data" / "fingerprints"
    if not (folder / "areas.csv").is_file():
        pytest.skip(
            "areas of real prints not tested: the images (FVC 2002 and 2004) and areas.csv are not "
            "in ../shared/data/fingerprints"
        )
    return folder


@pytest.fixture(scope="session")
def free_ros_domain() -> Callable[[], int]:
    """Function that gives a ROS domain of this worker's share that no process uses.

    Parallel workers draw from separate domains, so that none takes what another has just found.
    """
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return lambda: free_domain(d for d in DOMAINS if d % workers == worker)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch, free_ros_domain: Callable[[], int]) -> int:
    """A ROS_DOMAIN_ID of its own, set in the environment, discovery kept on this host."""
    domain = free_ros_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return domain


@pytest.fixture
def free_port() -> Callable[[], int]:
    """Function that gives an unused UDP and TCP port."""

    def port() -> int:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.bind(("127.0.0.1", 0))
            return int(probe.getsockname()[1])

    return port


@pytest.fixture
def process(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Function that starts a child process (its own group), ended in any case with the test.

    `process("-m", "finger_model.model_node", "--ros-args", …)` runs this Python; output goes to a
    file whose path is `child.output`. A killed pytest takes its children with it.
    """
    children: list[subprocess.Popen[str]] = []

    def start(*arguments: str | Path, env: dict[str, str] | None = None, **options: Any) -> Any:
        output = tmp_path / f"process_{len(children)}.log"
        with output.open("w") as log:
            child = subprocess.Popen(
                bound_to_parent([sys.executable, *map(str, arguments)]),
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
                env={**os.environ, **(env or {})},
                **options,
            )
        child.output = output  # type: ignore[attr-defined]
        children.append(child)
        return child

    yield start
    for child in children:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGINT)
    for child in children:
        try:
            child.wait(5)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        # pytest shows this for tests that fail.
        said = child.output.read_text(errors="replace")[-3000:]  # type: ignore[attr-defined]
        print(f"--- {' '.join(child.args[1:])}\n{said}")  # type: ignore[index]
