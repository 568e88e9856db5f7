# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The general law: branches and stiffening in material.yaml, its limits, and bad input."""

from dataclasses import dataclass

import numpy as np
import pytest

from finger_common.cli import run
from finger_common.errors import InputError
from finger_model.cli import _main
from finger_model.fem.full_order import FullOrderModel
from finger_model.finger import load_areas
from finger_model.laws import (
    GeneralizedMaxwell2,
    MaxwellLaw,
    StandardLinearSolid,
    load_material,
    parameter,
)
from finger_model.laws.generalized_maxwell import LAWS_BY_BRANCHES, from_branches
from finger_model.laws.law import IN_KPA
from finger_model.laws.maxwell import Branch
from finger_model.reduced import ReducedModel
from finger_model.verification.cases import ramp

BRANCH = "E0: 8e4\nbranches:\n  - {fraction: %s, tau: %s}\n"


@pytest.fixture(scope="module")
def model():
    return FullOrderModel(refinement=0.5)


@pytest.fixture
def simulate(tmp_path):
    """Run the command with a material file and a force; gives exit code and output table."""

    def call(material, force="0,0\n0.5,0.5\n1,1\n", solver=("--solver", "full")):
        (tmp_path / "m.yaml").write_text(material)
        (tmp_path / "f.csv").write_text("time_s,force_n\n" + force)
        out = tmp_path / "o.csv"
        arguments = ["simulate", "--force", str(tmp_path / "f.csv"), "-o", str(out), *solver]
        arguments += ["--material", str(tmp_path / "m.yaml"), "--refinement", "0.5"]
        code = run(_main, arguments)
        return code, np.genfromtxt(out, delimiter=",", names=True) if out.exists() else None

    return call


def test_branches_and_stiffening_of_a_material_file_are_used(simulate, model):
    text = (
        "E0: 8.0e4\nE2: 1.2e6\nstiffening: 2\nfriction: 0.4\nbranches:\n"
        "  - {fraction: 0.3, tau: 0.004}\n  - {fraction: 0.2, tau: 0.07}\n"
        "  - {fraction: 0.3, tau: 1.4}\n"
    )
    code, table = simulate(text)
    assert code == 0
    law = from_branches(
        {
            "E0": 8e4,
            "E2": 1.2e6,
            "stiffening": 2,
            "friction": 0.4,
            "branches": [
                {"fraction": 0.3, "tau": 0.004},
                {"fraction": 0.2, "tau": 0.07},
                {"fraction": 0.3, "tau": 1.4},
            ],
        },
        "test",
    )
    assert law.long_term_fraction == pytest.approx(0.2)
    exact = model.simulate(law, np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(table["area_mm2"], exact.area * 1e6, rtol=1e-4)
    # Stiffening, and each branch, make the contact smaller.
    for weaker in (
        text.replace("stiffening: 2\n", ""),
        text.replace("fraction: 0.3", "fraction: 0.2"),
    ):
        changed = simulate(weaker)[1]["area_mm2"][-1] / table["area_mm2"][-1]
        assert abs(changed - 1.0) > 0.02


@pytest.mark.parametrize(
    ("material", "words"),
    [
        (BRANCH % (0.3, 0), "m.yaml: branch 1: 'tau' is 0; give its relaxation time, 0.001 … 10 s"),
        (BRANCH % (0.3, -1), "branch 1: 'tau' is -1; give its relaxation time"),
        (BRANCH % (-0.3, 1), "branch 1: 'fraction' is -0.3; give its modulus over E0"),
        (BRANCH % (0, 1), "branch 1: 'fraction' is 0; give its modulus over E0, or remove"),
        (BRANCH % (0.3, "soon"), "branch 1: 'tau' is 'soon', a finite number is needed"),
        (BRANCH % (".nan", 1), "branch 1: 'fraction' is nan, a finite number is needed"),
        (BRANCH % (1.0, 1), "the fractions of the branches add up to 1; together they must stay"),
        (
            BRANCH % (0.6, 1) + "  - {fraction: 0.5, tau: 0.1}\n",
            "add up to 1.1; together they must stay below 0.999 of E0; lower them",
        ),
        ("E1: 2e4\n" + BRANCH % (0.5, 1), "'E1' does not go with 'branches'"),
        ("tau1: 2\n" + BRANCH % (0.5, 1), "'tau1' does not go with 'branches'"),
        ("branches: []\n", "'branches' needs a list of 1 to 4 entries"),
        (BRANCH % (0.1, 1) + 4 * "  - {fraction: 0.1, tau: 0.1}\n", "a list of 1 to 4 entries"),
        ("branches: {fraction: 0.5, tau: 1}\n", "'branches' needs a list of 1 to 4 entries"),
        ("branches:\n  - {fraction: 0.5}\n", "branch 1: the keys 'fraction' and 'tau' are needed"),
        ("law: generalized_maxwell\n", "which needs the key 'branches'; add it"),
        ("law: standard_linear_solid\n" + BRANCH % (0.5, 1), "remove 'law' or 'branches'"),
        ("stiffening: -1\n", "'stiffening' is -1, outside 0 … 50; 0 is tissue that does not"),
        ("stiffening: -1\n" + BRANCH % (0.5, 1), "'stiffening' is -1, zero or more is needed"),
        ("stiffening: 51\n" + BRANCH % (0.5, 1), "'stiffening' is 51, outside 0 … 50"),
    ],
)
def test_a_bad_law_ends_with_one_sentence(simulate, capsys, material, words):
    code, table = simulate(material)
    error = capsys.readouterr().err
    assert code == 2 and table is None
    assert words in error and error.count("\n") == 1


@pytest.mark.parametrize("material", ["stiffening: 0\n", "stiffening: 8\n", BRANCH % (0.5, 0.2)])
def test_1000_newtons_end_with_one_sentence(simulate, capsys, material):
    code, table = simulate(material, force="0,0\n1,1000\n")
    error = capsys.readouterr().err
    assert code == 2 and table is None and error.count("\n") == 1
    assert "the load is beyond what this finger carries: lower it or use stiffer moduli" in error


def test_no_stiffening_is_neo_hooke_exactly_and_a_small_one_tends_to_it(model):
    time, force = ramp(1.0, 0.5, 6)
    plain = model.simulate(StandardLinearSolid(), time, force)
    zero = model.simulate(StandardLinearSolid(stiffening=0.0), time, force)
    assert np.array_equal(plain.area, zero.area)
    small = model.simulate(StandardLinearSolid(stiffening=1e-6), time, force)
    np.testing.assert_allclose(small.area, plain.area, rtol=1e-5)
    stiff = model.simulate(StandardLinearSolid(stiffening=3.0), time, force)
    assert np.all(stiff.area[1:] < plain.area[1:])


def test_one_branch_is_the_default_law_to_rounding(model):
    default = StandardLinearSolid(stiffening=1.5)
    (branch,) = default.branches
    law = from_branches(
        {
            "E0": default.E0,
            "E2": default.E2,
            "stiffening": 1.5,
            "branches": [{"fraction": branch.fraction, "tau": branch.relaxation_time}],
        },
        "test",
    )
    time, force = ramp(1.0, 0.5, 6)
    one, other = (model.simulate(m, time, force) for m in (default, law))
    np.testing.assert_allclose(one.area, other.area, rtol=1e-10)
    np.testing.assert_allclose(one.indentation, other.indentation, rtol=1e-10)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_longest_creep_time_is_that_of_the_strain(count: int) -> None:
    """At constant stress 1, ε = 1 + Σ g_k γ_k and τ_k dγ_k/dt = ε − γ_k, which comes to rest with
    the longest creep time; no other tissue of the box takes longer."""
    law = LAWS_BY_BRANCHES[count]
    space, box = law.PARAMETERS, np.array(law.PARAMETERS.box)
    longest = law().longest_creep_time(box)
    rng = np.random.default_rng(0)
    times = []
    for share in [np.ones(len(box)), *rng.random((20, len(box)))]:
        tissue = law(**space.mapping(box[:, 0] + share * (box[:, 1] - box[:, 0])))
        g, tau = (np.array(values) for values in zip(*tissue.branches))
        follow = (np.eye(count) - g) / tau[:, None]
        step = 0.5 * longest
        move = np.linalg.inv(np.eye(count) + 1e-3 * step * follow)
        apart = np.full(count, 1.0)
        strains = []
        for _ in range(2):
            apart = np.linalg.matrix_power(move, 1000) @ apart
            strains.append(float(g @ apart))
        times.append(step / np.log(strains[0] / strains[1]))
    assert times[0] == pytest.approx(longest, rel=0.03)
    assert max(times[1:]) <= times[0]
    assert longest > 9.0 * box[space.index(f"tau_{count}"), 1] / count
    narrow = np.array([[100e3, 110e3], *[[0.5, 1.0], [0.1, 1.0]] * count, *box[-2:]])
    assert law().longest_creep_time(narrow) > 100.0, "fractions up to the whole"


def test_fractions_above_the_whole_go_to_the_slowest_branch() -> None:
    """0.9 of 1 s and what is left, 0.099, of 0.05 s."""
    law = LAWS_BY_BRANCHES[2]
    box = np.array(law.PARAMETERS.box)
    box[1:5] = [[0.05, 0.9], [0.01, 0.05], [0.05, 0.9], [0.2, 1.0]]
    slowest = law(fraction_1=0.099, tau_1=0.05, fraction_2=0.9, tau_2=1.0)
    at_once = np.column_stack([slowest.vector(), slowest.vector()])
    assert law().longest_creep_time(box) == pytest.approx(906.0, rel=1e-3)
    assert law().longest_creep_time(at_once) == pytest.approx(906.0, rel=1e-3)


@dataclass(frozen=True, kw_only=True)
class TwoTimes(MaxwellLaw):
    """A law of a user: a fast branch and a slow one of the same modulus."""

    name = "two_times"
    INTERNAL_TENSORS = 2
    E0: float = parameter(
        80e3, "Modulus.", **IN_KPA, symbol="E", bounds=(20e3, 200e3), range=(20e3, 400e3)
    )
    share: float = parameter(
        0.3,
        "Modulus of each branch over E0.",
        unit="",
        symbol="g",
        display_unit="",
        display_factor=1.0,
        bounds=(0.05, 0.4),
        range=(1e-4, 0.5),
    )

    @property
    def branches(self) -> tuple[Branch, ...]:
        return Branch(self.share, 0.01), Branch(self.share, 2.0)

    @property
    def epidermis_modulus(self) -> float:
        return 1e6

    @property
    def instantaneous_shear_modulus(self) -> float:
        return self.E0 / 2.96


def test_a_users_law_of_branches_has_the_time_of_its_slow_creep() -> None:
    """Slow strain sees the fast branch relaxed: τ (1 − g)/(1 − 2g), but for the fast branch."""
    law, box = TwoTimes(), np.array(TwoTimes.PARAMETERS.box)
    assert law.longest_creep_time(box) == pytest.approx(2.0 * 0.6 / 0.2, rel=0.01)
    box[1] = 0.05, 0.5  # no spring is left
    assert law.longest_creep_time(box) == pytest.approx(2.0 * 0.95 / 0.9, rel=0.01)
    with pytest.raises(InputError, match="long-term shear modulus is 0 Pa, it must be above zero"):
        TwoTimes(share=0.5)


def test_laws_without_branches_state_their_creep_time() -> None:
    solid = StandardLinearSolid()
    assert solid.longest_creep_time(np.array(solid.PARAMETERS.box)) == pytest.approx(0.8)


def test_branches_of_one_time_are_one_branch(model):
    time, force = ramp(1.0, 0.5, 5)
    parts = [[0.7], [0.1, 0.2, 0.4]]
    one, three = (
        model.simulate(
            from_branches({"branches": [{"fraction": g, "tau": 0.2} for g in p]}, "test"),
            time,
            force,
        ).area
        for p in parts
    )
    np.testing.assert_allclose(one, three, rtol=1e-9)


def test_moduli_of_a_law_of_branches(tmp_path):
    path = tmp_path / "m.yaml"
    path.write_text(BRANCH % (0.25, 0.5) + "  - {fraction: 0.5, tau: 0.01}\n")
    law = load_material(path)
    assert law.name == "generalized_maxwell_2" and law.INTERNAL_TENSORS == 2
    assert law.long_term_shear_modulus == pytest.approx(0.25 * 8e4 / 2.96)
    assert law.PARAMETERS.quantity("long_term_E", law.vector()) == pytest.approx(2e4)
    assert law.creep_time == pytest.approx(0.01 * 3)
    assert type(law).from_dict(law.to_dict()) == law


def test_a_fit_of_the_default_finger_may_vary_a_general_law() -> None:
    """Its stiffening is varied too, which the shipped model of that finger does not know."""
    model = load_areas(law="generalized_maxwell_2")
    assert isinstance(model, ReducedModel) and model.serves_population
    space = model.space
    vector = space.from_log(space.to_log(model.material.vector()))
    assert vector[space.index("stiffening")] == 0.0
    time = np.linspace(0.0, 1.0, 21)
    for stiffening in (0.0, 2.0):
        vector[space.index("stiffening")] = stiffening
        assert model.simulate(vector, time, 1.35 * time).area[-1] > 2e-5
    # Without stiffening the default finger keeps the model that is more exact there.
    assert not ReducedModel.load().for_material(GeneralizedMaxwell2()).serves_population
