# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A law in one file of an outside package: the example of docs/add_a_law.md, installed and run."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

from finger_common.cli import run
from finger_common.errors import InputError, ModelError
from finger_model.cli import _main
from finger_model.fem.area_model import FullOrderAreas
from finger_model.fem.full_order import FullOrderModel
from finger_model.laws import LAWS, StandardLinearSolid, StepEnergy, law_of, load_material
from finger_model.solid3d.full_order import SolidModel
from finger_model.solid3d.mesh import MeshSize
from finger_model.verification.cases import elastic, ramp

WRONG = """
from dataclasses import dataclass

from finger_model.laws import ConstitutiveLaw, StandardLinearSolid, parameter

LOOK = {"unit": "", "symbol": "k", "display_unit": "", "display_factor": 1.0}


@dataclass(frozen=True, kw_only=True)
class Bare(ConstitutiveLaw):
    name = "bare"
    k: float = parameter(1.0, "k.", bounds=(0.5, 2.0), **LOOK)


@dataclass(frozen=True, kw_only=True)
class Fixed(ConstitutiveLaw):
    name = "fixed"
    epidermis_modulus = instantaneous_shear_modulus = 6e3
    step_energy = energies = None


class Undecorated(StandardLinearSolid):
    name = "undecorated"
    CORRECTION = ()
    k: float = parameter(1.0, "k.", bounds=(0.5, 2.0), **LOOK)


class Renamed(StandardLinearSolid):
    name = "another"


@dataclass(frozen=True, kw_only=True)
class Reversed(StandardLinearSolid):
    name = "reversed"
    CORRECTION = ()
    k: float = parameter(1.0, "k.", bounds=(2.0, 0.5), **LOOK)


@dataclass(frozen=True, kw_only=True)
class Negative(StandardLinearSolid):
    name = "negative"
    CORRECTION = ()
    k: float = parameter(-1.0, "k.", bounds=(0.5, 2.0), **LOOK)


class Good(StandardLinearSolid):
    name = "good"
"""
"""Laws that cannot be used, and one that can, in one module."""

COARSE = MeshSize(center=0.2, across=4, growth=1.3, bulk=3, bulk_growth=1.5, skin=1)

PAGE = Path(__file__).resolve().parents[3] / "docs" / "add_a_law.md"


def block(language: str) -> str:
    """The first code block of the page in a language."""
    return re.search(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory, install_package):
    """The example as an installed package; gives its law class."""
    tomllib = pytest.importorskip("tomllib", reason="reading pyproject.toml needs Python 3.11")
    site = tmp_path_factory.mktemp("site")
    metadata = tomllib.loads(block("toml"))
    project, (module,) = metadata["project"], metadata["tool"]["setuptools"]["py-modules"]
    # pip installs nothing without them.
    assert project["name"] and project["version"] and "finger_model" in project["dependencies"]
    install_package(site, {module: block("python")}, project["entry-points"])
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        yield law_of("yeoh")


@pytest.fixture(scope="module")
def model():
    return FullOrderModel(refinement=0.5)


def test_the_law_is_found_by_its_name_and_declares_its_parameters(installed, tmp_path):
    assert "yeoh" in LAWS.names() and "standard_linear_solid" in LAWS.names()
    assert installed.PARAMETERS.names == ("G", "c", "Es")
    path = tmp_path / "material.yaml"
    path.write_text(block("yaml"))
    material = load_material(path)
    assert isinstance(material, installed)
    assert (material.G, material.c, material.friction) == (8e3, 0.25, 0.25)
    path.write_text("law: yeoh\nE0: 1e5\n")
    with pytest.raises(
        InputError, match=r"material\.yaml: unknown key 'E0'; the keys are G, c, Es"
    ):
        load_material(path)
    path.write_text("law: unheard_of\n")
    with pytest.raises(InputError, match=r"law 'unheard_of' is not installed; known are .*yeoh"):
        load_material(path)


def test_simulate_runs_with_the_law_of_the_material_file(installed, tmp_path, capsys):
    (tmp_path / "material.yaml").write_text(block("yaml"))
    time, force = ramp(1.0, 1.0, 5)
    table = np.column_stack([time, force])
    np.savetxt(tmp_path / "f.csv", table, "%g", ",", header="time_s,force_n", comments="")
    arguments = ["simulate", "--force", str(tmp_path / "f.csv"), "-o", str(tmp_path / "o.csv")]
    arguments += ["--material", str(tmp_path / "material.yaml"), "--refinement", "0.5"]
    assert run(_main, [*arguments, "--solver", "full"]) == 0
    found = np.genfromtxt(tmp_path / "o.csv", delimiter=",", names=True)
    assert np.all(np.diff(found["area_mm2"]) > 0) and 30 < found["area_mm2"][-1] < 80
    assert run(_main, [*arguments[:-2], "--solver", "reduced"]) == 2
    assert "law 'yeoh' has no reduced model; use --solver full" in capsys.readouterr().err


def test_the_commands_of_the_page_run_as_they_stand(installed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("material.yaml").write_text(block("yaml"))
    printed, simulated = re.findall(r"^    ((?:printf|finger-model) .*)$", PAGE.read_text(), re.M)
    subprocess.run(["sh", "-c", printed], check=True)
    assert run(_main, [*shlex.split(simulated)[1:], "--refinement", "0.5"]) == 0
    found = np.genfromtxt("contact.csv", delimiter=",", names=True)
    assert found["area_mm2"][-1] == found["area_mm2"].max() > 30


def test_without_stiffening_it_is_the_neo_hookean_finger(installed, model):
    time, force = ramp(1.0, 1.0, 6)
    ratio = 0.48
    G = 30e3 / (2 * (1 + ratio))
    soft = model.simulate(installed(G=G, c=1e-6, Es=1652e3), time, force)
    plain = model.simulate(elastic(30e3, E2=1652e3), time, force)
    assert soft.area == pytest.approx(plain.area, rel=1e-4)
    stiff = model.simulate(installed(G=G, c=1.0, Es=1652e3), time, force)
    assert np.all(stiff.area[2:] < soft.area[2:])
    assert stiff.area[1] / soft.area[1] > stiff.area[-1] / soft.area[-1]


def test_energy_balances_and_newton_converges_quadratically(installed, model):
    stepper = model.start(installed(G=8e3, c=0.75, friction=0.0))
    for k in range(1, 81):
        stepper.step(0.01 * k, 1.2 * k / 80)
    state = stepper.state
    assert state.dissipation == 0.0
    assert state.stored == pytest.approx(state.work, rel=2e-3)
    stepper._before = None
    stepper.step(1.0, 1.4)
    last, end = model.equilibrium.residuals[-2:]
    assert end < max(last**1.7, 1e-10)


def test_areas_for_a_fit_come_from_the_full_order_model(installed, model):
    time, force = ramp(1.0, 1.0, 50)
    areas = FullOrderAreas(installed(), refinement=0.5)
    rows = np.array([10, 30, 50])
    vectors = np.array([[6e3, 0.5, 1.5e6], [12e3, 0.5, 1.5e6]])
    (found,) = areas.batch(vectors, [(time, force, rows)])
    exact = model.simulate(installed(G=6e3, c=0.5, Es=1.5e6), time, force).area[rows]
    assert found.shape == (2, 3)
    assert found[0] == pytest.approx(exact, rel=5e-3)
    assert np.all(found[1] < found[0])
    (crushed,) = areas.batch(vectors[:1], [(time, 50.0 * force, rows)])
    assert np.all(np.isnan(crushed))


@pytest.mark.parametrize(
    "rows", [[-1], [50, 10], [10, 10], [51], np.arange(51) > 40, [[1, 2]], [9.5]]
)
def test_rows_that_are_none_are_refused_by_the_full_order_model(rows):
    areas = FullOrderAreas(StandardLinearSolid(), refinement=0.5)
    vector, press = areas.space.default, ramp(1.0, 1.0, 50)
    for found in (
        lambda: areas.areas(vector, *press, rows),
        lambda: areas.batch(vector, [(*press, rows)]),
    ):
        with pytest.raises(InputError, match="the wanted rows"):
            found()
    assert areas.areas(vector, *press, []).shape == (0,)


def test_a_class_that_is_no_complete_law_is_named(tmp_path, install_package, monkeypatch):
    sentences = {
        "bare": "has no energies, epidermis_modulus, .*step_energy; add them",
        "fixed": r"has no parameters; make a field of it with parameter\(…\)",
        "undecorated": r"is no dataclass; put @dataclass\(frozen=True, kw_only=True\) before it",
        "renamed": "has the name 'another'; give it that of its entry point",
        "reversed": "the bounds of 'k' are 2 … 0.5; give the lower one",
        "negative": "default: 'k' is -1, a positive value is needed",
    }
    entries = {name: f"wrong_laws:{name.title()}" for name in (*sentences, "good")}
    install_package(tmp_path, {"wrong_laws": WRONG}, {"finger_model.law": entries})
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, sentence in sentences.items():
        where = rf"material law '{name}' \(wrong_laws:{name.title()}\)"
        with pytest.raises(InputError, match=f"{where}:? {sentence}"):
            law_of(name)
    assert law_of("good").name == "good"


def law_with(**members):
    """A material of a class of its own, with other members than the default law."""
    return type("Other", (StandardLinearSolid,), {"name": "other", **members})()


@pytest.mark.parametrize(
    "make", [lambda: FullOrderModel(refinement=0.5), lambda: SolidModel(size=COARSE)]
)
def test_energies_that_are_none_are_named(make):
    model, (time, force) = make(), ramp(0.3, 1.0, 3)

    def with_energy(energy):
        return law_with(step_energy=lambda self, duration, before: energy(before))

    for law, sentence in (
        (with_energy(lambda b: StepEnergy(np.nan * b.unit)), "a metric that is not finite"),
        (
            with_energy(lambda b: StepEnergy(np.ones((3, 4, 4)))),
            r"a metric of shape \(3, 4, 4\), \(\d+, \d, \d\) is needed",
        ),
        (
            with_energy(lambda b: StepEnergy(0.0 * b.unit, lambda i: (np.ones(3), 0.0))),
            "something else than h and dh/dĪ₁ of shape",
        ),
        (
            with_energy(lambda b: StepEnergy(0.0 * b.unit, lambda i: 6e3 + i)),
            "something else than h and dh/dĪ₁ of shape",
        ),
        (
            law_with(update=lambda self, duration, before, strain, inverse: strain),
            r"update gave shape \((\d+), (\d), (\d)\), \(1, \1, \2, \3\) is needed",
        ),
    ):
        with pytest.raises(InputError, match=f"law 'other': .*{sentence}"):
            model.simulate(law, time, force)

    # Numbers stand for arrays of them.
    plain = with_energy(lambda b: StepEnergy(6e3 * b.unit))
    spring = with_energy(lambda b: StepEnergy(0.0, lambda i: (6e3, 0.0)))
    both = [model.simulate(law, time, force).area for law in (plain, spring)]
    assert both[1] == pytest.approx(both[0], rel=1e-6)

    def torn(invariant):
        return np.where(invariant < 3.001, 6e3, np.nan), np.zeros_like(invariant)

    with pytest.raises(ModelError, match="law 'other' gives no finite stress at this strain"):
        model.simulate(with_energy(lambda b: StepEnergy(0.0 * b.unit, torn)), time, force)
