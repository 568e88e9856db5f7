"""Each package has what a release by bloom and an installation by pip ask."""

from __future__ import annotations

import ast
import configparser
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from finger_bringup import nodes

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(p.parent.name for p in ROOT.glob("src/*/package.xml"))
PYTHON = sorted(p.parent.name for p in ROOT.glob("src/*/setup.py"))

LIBRARIES = {
    "aiohttp": ("aiohttp", "python3-aiohttp"),
    "argcomplete": ("argcomplete", "python3-argcomplete"),
    "can": ("python-can[multicast]", "python3-can"),
    "cantools": ("cantools", "python3-cantools-pip"),
    "cma": ("cma", "python3-cma-pip"),
    "cv2": ("opencv-python-headless", "python3-opencv"),
    "distributed": ("distributed", "python3-distributed-pip"),
    "lz4": ("lz4", "python3-lz4-pip"),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "mcap": ("mcap", "python3-mcap-pip"),
    "meshio": ("meshio", "python3-meshio"),
    "numba": ("numba", "python3-numba"),
    "numpy": ("numpy", "python3-numpy"),
    "openpyxl": ("openpyxl", "python3-openpyxl"),
    "pymoo": ("pymoo", "python3-pymoo-pip"),
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "scipy": ("scipy", "python3-scipy"),
    "serial": ("pyserial", "python3-serial"),
    "threadpoolctl": ("threadpoolctl", "python3-threadpoolctl-pip"),
    "yaml": ("PyYAML", "python3-yaml"),
    "zstandard": ("zstandard", "python3-zstandard-pip"),
}
"""Module -> name at PyPI, key of rosdep."""

OPTIONAL = {"foxglove", "h5py", "pyarrow", "pylsl", "pyueye", "pyxdf"}
"""Modules whose absence is told in a sentence; extras for pip, no keys of rosdep."""

COMES_WITH = {"apsw": "rosbags"}
"""Modules that another library brings."""


@pytest.fixture(scope="module")
def release_files() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "release_files", ROOT / "scripts" / "release_files.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ROS = re.compile(r"^(rclpy|launch|launch_ros|ament_\w+|\w+_msgs|\w+_interfaces|std_srvs)$")


def imports(package: str, *folders: str) -> set[str]:
    """Modules that the sources in these folders of a package import, by their first name."""
    found: set[str] = set()
    for file in (path for f in folders for path in (ROOT / "src" / package / f).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - {"_typeshed"}


def libraries(package: str) -> set[str]:
    """Modules that a package imports, without the standard library, ROS and the suite."""
    return {
        name
        for name in imports(package, package)
        if not ROS.match(name) and not name.startswith("finger_")
    }


def suite(package: str) -> set[str]:
    """Python packages of the suite that a package imports, or whose nodes it starts."""
    files = (ROOT / "src" / package / package).rglob("*.py")
    found = set(
        re.findall(
            r"^\s*(?:from|import) (finger_\w+)",
            "\n".join(file.read_text() for file in files),
            re.MULTILINE,
        )
    )
    if package == "finger_bringup":
        found |= {entry.package for entry in nodes.NODES.values()}
    return found & set(PYTHON) - {package}


def requirements(package: str) -> tuple[set[str], set[str]]:
    """What pip installs with a package, and with its extras."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "src" / package / "setup.cfg")
    extras = (
        dict(setup.items("options.extras_require"))
        if setup.has_section("options.extras_require")
        else {}
    )
    needed = setup.get("options", "install_requires", fallback="").split()
    return set(needed), set(" ".join(extras.values()).split())


@pytest.mark.parametrize("package", PACKAGES)
def test_catkin_pkg_accepts_a_package_and_its_change_log(
    package: str, release_files: ModuleType, tmp_path: Path
) -> None:
    catkin = pytest.importorskip("catkin_pkg.package", reason="catkin_pkg is not installed")
    changelog = pytest.importorskip("catkin_pkg.changelog", reason="docutils is not installed")
    folder = ROOT / "src" / package
    warnings: list[str] = []
    found = catkin.parse_package(str(folder), warnings=warnings)
    found.validate(warnings=warnings)
    assert not warnings
    assert [a.name for a in found.authors] == ["Finger contact maintainers"]
    assert [m.name for m in found.maintainers] == ["Finger contact maintainers"]
    assert [u.type for u in found.urls] == ["website"]
    assert found.licenses[0].file == "LICENSE"
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert "\nForthcoming\n" in (folder / "CHANGELOG.rst").read_text()
    # catkin_pkg reads released versions only.
    released = (ROOT / "CHANGELOG.md").read_text().replace("(unreleased)", "(2026-12-01)")
    (tmp_path / "CHANGELOG.rst").write_text(release_files.changelog(released, package))
    log = changelog.get_changelog_from_path(str(tmp_path))
    versions = {version: content for version, _, content in log.foreach_version()}
    assert found.version in versions and len(str(versions[found.version][1])) > 1000


def test_every_source_file_has_the_copyright_lines(release_files: ModuleType) -> None:
    bare = [
        str(file.relative_to(ROOT))
        for file, text in release_files.wanted().items()
        if file.suffix == ".py" and file.read_text() != text
    ]
    assert not bare, f"run python scripts/release_files.py: {bare}"


def test_the_change_log_keeps_versions_and_every_entry(release_files: ModuleType) -> None:
    markdown = (
        "# Changelog\n\n## 0.2.0 (unreleased)\n\nText.\n\n- One `--option`,\n  and [more](x.md).\n"
        "\n### Changed\n\n- Two.\n\n## 0.1.0 (2026-12-01)\n\n- Three.\n"
    )
    text = release_files.changelog(markdown, "finger_x")
    assert "Forthcoming\n-----------\n" in text and "0.1.0 (2026-12-01)\n" in text
    assert "* One ``--option``,\n  and more.\n" in text
    assert "* Changed:\n\n  * Two.\n" in text


@pytest.mark.parametrize("package", PYTHON)
def test_every_import_has_a_key_of_rosdep_and_a_requirement_of_pip(package: str) -> None:
    imported = libraries(package)
    assert imported <= LIBRARIES.keys() | OPTIONAL | COMES_WITH.keys()
    needed, extras = requirements(package)
    listed = {
        line.split()[0]
        for line in (ROOT / "requirements.txt").read_text().splitlines()
        if line and not line.startswith("#")
    }
    bounds = {re.split(r"[<>=]", line)[0]: line for line in listed}
    assert needed == suite(package) | {bounds[LIBRARIES[m][0]] for m in imported & LIBRARIES.keys()}
    assert len(extras) == len(imported & (OPTIONAL - {"pyueye"}))
    xml = (ROOT / "src" / package / "package.xml").read_text()
    keys = set(re.findall(r"<exec_depend>(python3-[^<]+)<", xml))
    assert keys == {LIBRARIES[module][1] for module in imported & LIBRARIES.keys()}


@pytest.mark.parametrize("package", PYTHON)
def test_every_ros_package_that_is_imported_is_a_dependency(package: str) -> None:
    def of_ros(*folders: str) -> set[str]:
        found = imports(package, *folders)
        return {n for n in found if ROS.match(n) or n.startswith("finger_")} - {package}

    suite_messages = {"finger_msgs"}
    xml = (ROOT / "src" / package / "package.xml").read_text()
    run = set(re.findall(r"<(?:exec_)?depend>([^<]+)<", xml))
    test = set(re.findall(r"<test_depend>([^<]+)<", xml))
    assert not of_ros(package, "launch") - run
    # A package of the suite that a test needs may need this one: to state it would be a circle.
    assert not {name for name in of_ros("test") if ROS.match(name)} - suite_messages - run - test
    assert not run & test, "stated twice"


def test_keys_without_a_debian_package_are_in_our_list_or_the_public_one() -> None:
    """README's rosdep line leaves out keys by pip: those end in -pip, as rosdep's rules ask."""
    own = set(re.findall(r"^(\S+):$", (ROOT / "rosdep.yaml").read_text(), re.MULTILINE))
    by_pip = {key for _, key in LIBRARIES.values() if key.endswith("-pip")}
    assert own <= by_pip and by_pip - own == {"python3-cantools-pip", "python3-rosbags-pip"}
    readme = (ROOT / "README.md").read_text()
    find = re.search(r"--skip-keys \"\$\((.*)\)\"", readme)
    assert find is not None
    said = subprocess.run(["sh", "-c", find[1]], cwd=ROOT, capture_output=True, text=True)
    assert set(said.stdout.split()) == by_pip


@pytest.mark.slow
def test_flake8_with_the_settings_for_ament_reports_nothing() -> None:
    pytest.importorskip("flake8", reason="flake8 is not installed; ruff is what make test runs")
    command = [sys.executable, "-m", "flake8", "--config", ".flake8", "src"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stdout, done.stdout[-2000:]


@pytest.mark.slow
def test_the_core_installs_alone_with_pip_and_runs_without_ros(tmp_path: Path) -> None:
    """Without ROS, build isolation and network; the libraries are those of this environment."""
    packages = [str(ROOT / "src" / name) for name in ("finger_common", "finger_model")]
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(tmp_path / "site"), *packages], check=True)
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['rclpy', 'finger_msgs'])); "
        f"sys.path.insert(0, {str(tmp_path / 'site')!r}); "
        "import finger_model; assert 'site' in finger_model.__file__, finger_model.__file__; "
        "from finger_model.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    force = str(ROOT / "tests" / "data" / "press.csv")
    arguments = ["simulate", "--force", force, "-o", str(tmp_path / "contact.csv")]
    subprocess.run([sys.executable, "-c", code, *arguments], check=True, cwd=tmp_path)
    assert len((tmp_path / "contact.csv").read_text().splitlines()) == 4
