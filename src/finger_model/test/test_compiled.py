# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Kernels that numba keeps, beside their sources or elsewhere."""

from __future__ import annotations

import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import pytest
from numba import config

from finger_model.compiled import keep_kernels, writable

INNER = "from numba import njit\n\n\n@njit(cache=True)\ndef inner():\n    return {}\n"
OUTER = """
from numba import njit

from package.laws.inner import inner
from values import VALUE


@njit(cache=True)
def outer():
    return inner() + VALUE
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package that computes inner() + VALUE: 1.5."""
    folder = tmp_path / "package"
    for name in ("laws", "slip"):
        (folder / name).mkdir(parents=True)
    (folder / "slip" / "outer.py").write_text(OUTER)
    (folder / "laws" / "inner.py").write_text(INNER.format("1.0"))
    (tmp_path / "values.py").write_text("VALUE = 0.5\n")
    return folder


def make_read_only(package: Path) -> None:
    """As for users without the right to write: nothing can be put into these folders."""
    for folder in ("laws", "slip"):
        (package / folder / "__pycache__").write_text("a file")


@pytest.mark.parametrize("place", ["beside the sources", "the user's cache", "NUMBA_CACHE_DIR"])
def test_a_kernel_is_compiled_anew_when_one_that_it_calls_has_changed(
    place: str, package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = tmp_path / "values.py"
    inner = package / "laws" / "inner.py"
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    chosen = str(tmp_path / "cache" / "chosen") if place == "NUMBA_CACHE_DIR" else ""
    if place == "the user's cache":
        make_read_only(package)
    home = package if place == "beside the sources" else tmp_path / "cache"

    def computed() -> float:
        """As a program that starts now would compute."""
        for name in [n for n in sys.modules if n.split(".")[0] in ("package", "values")]:
            del sys.modules[name]
        importlib.invalidate_caches()
        monkeypatch.setattr(config, "CACHE_DIR", chosen)
        keep_kernels(package, str(values))
        return float(importlib.import_module("package.slip.outer").outer())

    assert computed() == 1.5
    kept = {f: f.stat().st_mtime_ns for f in tmp_path.rglob("*.nbc")}
    assert len(kept) == 2 and all(home in f.parents for f in kept)
    assert computed() == 1.5
    assert kept == {f: f.stat().st_mtime_ns for f in kept}, "nothing changed: nothing is compiled"
    inner.write_text(INNER.format("20.0"))
    assert computed() == 20.5
    values.write_text("VALUE = 0.25\n")
    assert computed() == 20.25
    if place == "beside the sources":
        (package / "__pycache__" / "sources_of_kernels.txt").unlink()
        assert computed() == 20.25


def test_a_change_of_a_module_beside_the_folders_counts(package: Path) -> None:
    """As finger_model/force_noise.py, whose kernels are in those of the estimator."""
    keep_kernels(package)
    kernel = package / "slip" / "__pycache__" / "outer.nbc"
    kernel.touch()
    (package / "force_noise.py").write_text(INNER.format("3.0"))
    keep_kernels(package)
    assert not kernel.exists()


NOWHERE = """
import os, subprocess, sys
from pathlib import Path
from numba import config
from finger_model.compiled import keep_kernels

config.CACHE_DIR = os.environ.get("NUMBA_CACHE_DIR", "")
keep_kernels(Path("package"), "values.py")
from package.slip.outer import outer

print(outer(), config.CACHE_DIR, outer.stats.cache_hits or "compiled", flush=True)
if len(sys.argv) == 1:
    subprocess.run([sys.executable, __file__, "child"], check=True)
"""


def test_where_nothing_can_be_written_kernels_are_kept_for_the_process_and_its_children(
    package: Path, tmp_path: Path
) -> None:
    make_read_only(package)
    (tmp_path / "script.py").write_text(NOWHERE)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"],
        cwd=tmp_path,
        env=os.environ | {"HOME": "/proc/none", "XDG_CACHE_HOME": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    (own, folder, how), child = (line.split() for line in done.stdout.splitlines())
    assert (own, how) == ("1.5", "compiled") and child[:2] == [own, folder]
    assert child[2] != "compiled" and not Path(folder).parent.exists()
    assert done.stderr.count("\n") == 1 and "can be written" in done.stderr


NO_FOLDER = """
import sys, tempfile


def refused(*arguments, **options):
    raise PermissionError(13, "Permission denied")


tempfile.TemporaryFile = tempfile.mkdtemp = refused
from finger_model.compiled import njit


@njit(cache=True)
def double(x):
    return 2 * x


print(double(21), double.stats.cache_path)
"""


def test_where_not_even_a_temporary_folder_can_be_written_kernels_run_all_the_same(
    tmp_path: Path,
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", NO_FOLDER],
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["42", "None"]
    assert done.stderr.count("\n") == 1 and "no folder can be written" in done.stderr


def test_a_disk_that_is_full_is_no_folder_for_kernels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files can be made there, but nothing can be written into them."""
    assert writable(tmp_path)
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda dir: open("/dev/full", "wb", 0))
    assert not writable(tmp_path)


def use_after(days: float, package: Path, monkeypatch: pytest.MonkeyPatch, value: float) -> Path:
    """The folder of kernels of a package that is changed to return a value and used after days."""
    (package / "laws" / "inner.py").write_text(INNER.format(value))
    cache = package.parent / "cache"
    for folder in cache.iterdir() if cache.is_dir() else ():
        last = folder.stat().st_mtime - 86400.0 * days
        os.utime(folder, (last, last))
    monkeypatch.setattr(config, "CACHE_DIR", str(cache))
    assert keep_kernels(package)
    return Path(config.CACHE_DIR)


def test_of_older_sources_only_the_folders_used_last_are_kept(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = package.parent / "cache" / "of_another_program"
    own.mkdir(parents=True)
    found = [use_after(2.0, package, monkeypatch, value) for value in range(4)]
    assert [f.is_dir() for f in found] == [False, True, True, True] and own.is_dir()
    assert use_after(2.0, package, monkeypatch, 1) == found[1], "which is used again"
    found.append(use_after(2.0, package, monkeypatch, 4))
    assert [f.is_dir() for f in found] == [False, True, False, True, True]
    soon = [use_after(0.0, package, monkeypatch, value) for value in range(5, 8)]
    assert all(f.is_dir() for f in soon), "programs of today may still add to them"


@pytest.mark.parametrize("suffix", [".nbi", ".nbc", ""])
def test_a_process_whose_kernels_are_removed_goes_on(
    suffix: str, package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the files, or all."""
    folder = use_after(0.0, package, monkeypatch, 1.0)
    (tmp_path / "kernel.py").write_text(
        "from numba import njit\n\n\n@njit(cache=True)\ndef kernel(x):\n    return x + x\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "kernel", raising=False)
    kernel = importlib.import_module("kernel").kernel
    assert kernel(1) == 2
    assert list(folder.rglob("*.nbc"))
    for file in folder.rglob("*" + suffix) if suffix else ():
        file.unlink()
    if not suffix:
        shutil.rmtree(folder)
    assert kernel(1.5) == 3.0 and kernel(1j) == 2j
    assert list(folder.rglob("*.nbc"))


CHANGES = """
import gc
import numpy as np
from numba.core.registry import CPUDispatcher

from finger_model.calibration import CalibrationPress, calibrate
from finger_model.estimator import ContactEstimator, EstimatorSettings
from finger_model.slip_and_shape import SlipAndShape, prepare
from finger_model.geometry import Geometry
from finger_model.parameter_sets import ParameterSets
from finger_model.shape.estimate import MeasuredOutline
from finger_model.shape.settings import PoseSettings
from finger_model.reduced.model import ReducedModel, load_population
from finger_model.slip import SlipSettings
from finger_model.warm_up import warm_up_all


def compiled():
    kernels = [k for k in gc.get_objects() if isinstance(k, CPUDispatcher)]
    own = [k for k in kernels if k.py_func.__module__.startswith("finger_")]
    return {f"{k.py_func.__module__}.{k.py_func.__name__}": len(k.signatures) for k in own}


def use(model):
    estimator = ContactEstimator(model)
    slip_and_shape = SlipAndShape(estimator, SlipSettings(), PoseSettings())
    sets = ParameterSets.default()
    outline = MeasuredOutline((0.0, 0.0), 9e-3, 8e-3, 0.0, 1e-4, 1e-4, 1e-4)
    prepare(model, sets)
    now = 1_700_000_000_000_000_000

    def press(normal):
        nonlocal now
        for number in range(60):
            now += 2_000_000
            force = 0.1, 0.0, -normal
            for estimate in estimator.add_wrench(now, force):
                slip_and_shape.process(estimate, force, (0.0, 0.0, 1e-3))
            if number % 20 == 0:
                estimator.add_area(now - 10_000_000, 60e-6, 3e-6)
                slip_and_shape.see_area(now - 10_000_000, (0.8, 0.1), outline)
        estimator.predict(np.array([0.1, 0.2]), np.array([0.5, 0.6]))
        estimator.force_for_area(20e-6, 0.5)
        estimator.mismatch()

    fewer = ParameterSets(sets.sets[:2], prior=sets.prior)
    for change in (
        lambda: press(0.0),
        lambda: estimator.change_surface(),
        lambda: estimator.change_settings(EstimatorSettings(pad_aspect=1.2)),
        lambda: estimator.add_moisture(now, 80.0),
        lambda: estimator.prepare_moisture(90.0),
        lambda: estimator.change_parameters(fewer),
        lambda: estimator.reset(),
        lambda: press(np.nan),
        lambda: estimator.reset("another subject: S02"),
        lambda: estimator.clock_jump_event(now + 1),
    ):
        change()
        slip_and_shape.keep_up()
        press(1.0)
    time = np.arange(0.0, 2.0, 0.02)
    force = np.clip(2.0 * np.sin(2.0 * time), 0.0, 1.0)
    seen = model.simulate(sets.interpolate(69.0).parameters, time, force).area
    for number in range(6):
        part = slice(20, 60)
        taken = time[part] + 3.0 * number, seen[part], 0.02 * seen[part]
        presses.append(CalibrationPress(time + 3.0 * number, force, *taken))
    calibrate(model, sets, presses)


warm_up_all()
for model in (ReducedModel.load(), load_population(Geometry(pad_semi_axis_radial=8e-3))):
    presses = []
    before = compiled()
    use(model)
    after = compiled()
    print(*(name for name in after if after[name] != before.get(name)))
"""


def test_nothing_is_compiled_after_the_warm_up() -> None:
    """Samples of all fingers of a process would wait for it."""
    done = subprocess.run(
        [sys.executable, "-c", CHANGES], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_no_function_is_compiled_with_two_sets_of_options() -> None:
    """numba's cache gave the serial kernel of a batch where the parallel one was asked for."""
    import finger_model

    names = [m.name for m in pkgutil.walk_packages(finger_model.__path__, "finger_model.")]
    kernels = {
        id(value): value.py_func
        for name in names
        if "verification" not in name and not name.endswith("_node")
        for value in vars(importlib.import_module(name)).values()
        if hasattr(value, "py_func")
    }
    assert len(kernels) > 50
    counts = Counter(kernels.values())
    assert not [function.__qualname__ for function, count in counts.items() if count > 1]
