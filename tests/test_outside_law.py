"""An outside package adds a material law; simulate, fit and report use it.

No file of the suite is edited: the law is one module, named by an entry point.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_fit import cli
from finger_fit.options import FitOptions
from finger_fit.study import fit_bags
from finger_model.cli import main as finger_model
from finger_model.fem.area_model import FullOrderAreas
from finger_model.laws import law_of
from finger_model.parameter_sets import ParameterSets

LAW = '''
from dataclasses import dataclass

import numpy as np

from finger_model.laws import UNIT, ConstitutiveLaw, DerivedQuantity, StepEnergy, parameter, trace


@dataclass(frozen=True, kw_only=True)
class TwoSprings(ConstitutiveLaw):
    """Elastic, neo-Hookean soft tissue under an elastic skin."""

    name = "two_springs"
    DERIVED = (
        DerivedQuantity(
            "contrast", "", "Skin modulus over soft tissue modulus.", "C", "", 1.0, 1,
            value=lambda vectors: vectors[..., 1] / vectors[..., 0],
            solve=lambda vectors, values: np.stack(
                [vectors[..., 0], vectors[..., 0] * values], axis=-1
            ),
            solves_for="skin",
            of=("soft", "skin"),
        ),
    )

    soft: float = parameter(
        20e3, "Modulus of the soft tissue.", unit="Pa", symbol="Y", display_unit="kPa",
        display_factor=1e-3, bounds=(10e3, 60e3), range=(5e3, 100e3),
    )
    skin: float = parameter(
        1500e3, "Modulus of the skin.", unit="Pa", symbol="S", display_unit="kPa",
        display_factor=1e-3, decimals=0, bounds=(500e3, 3000e3), range=(300e3, 5000e3),
    )

    @property
    def epidermis_modulus(self):
        return self.skin

    @property
    def instantaneous_shear_modulus(self):
        return self.soft / (2.0 * (1.0 + self.poisson_ratio_bulk))

    def step_energy(self, duration, before):
        return StepEnergy(self.instantaneous_shear_modulus * np.broadcast_to(
            UNIT, before.c_bar.shape))

    def energies(self, weight, before, after):
        strain = float(np.sum(weight * (trace(after.c_bar) - 3.0)))
        return 0.5 * self.instantaneous_shear_modulus * strain, 0.0
'''

TRUTH = np.array([25e3, 1200e3])
START = 1_767_600_000_000_000_000


@pytest.fixture(scope="module")
def law(tmp_path_factory: pytest.TempPathFactory, install_package: Any) -> Any:
    """The law of an outside package, found by its name."""
    site = tmp_path_factory.mktemp("site")
    entries = {"finger_model.law": {"two_springs": "two_springs_law:TwoSprings"}}
    install_package(site, {"two_springs_law": LAW}, entries)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        yield law_of("two_springs")
    sys.modules.pop("two_springs_law", None)


def write_bag(path: Path, index: int, model: FullOrderAreas) -> None:
    """One short press with the model's areas at the truth."""
    time = np.arange(0.0, 0.8, 0.004)
    force = np.clip((time - 0.1) / (0.4 + 0.05 * index), 0.0, 1.0) * 0.8
    rows = np.arange(30, len(time), 20)
    areas = model.areas(TRUTH, time, force, rows)
    stamps = START + np.round(time * 1e9).astype(np.int64)
    with BagWriter(path, {"condition": "dry", "trial_index": index}) as bag:
        reading = {"header": {"stamp": int(stamps[0])}, "value": 40.0, "phase": 1}
        bag.write("moisture", reading)
        for stamp, newton in zip(stamps, force):
            wrench = {"force": {"z": -float(newton)}}
            bag.write("wrench", {"header": {"stamp": int(stamp)}, "wrench": wrench})
        for row, area in zip(rows, areas):
            header = {"stamp": int(stamps[row])}
            bag.write(
                "contact_area",
                {"header": header, "gross_area": float(area), "area_stddev": 1e-6, "flags": 0},
            )


def test_simulate_takes_the_law_by_name(law: Any, tmp_path: Path) -> None:
    (tmp_path / "material.yaml").write_text("law: two_springs\nsoft: 2.5e+4\nskin: 1.2e+6\n")
    (tmp_path / "force.csv").write_text("time_s,force_n\n0,0\n0.2,0.5\n0.4,1.0\n")
    arguments = ["simulate", "--force", tmp_path / "force.csv", "--solver", "full", "-o"]
    arguments += [tmp_path / "out.csv", "--material", tmp_path / "material.yaml"]
    with pytest.raises(SystemExit) as ended:
        finger_model([str(a) for a in arguments])
    assert not ended.value.code
    area = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)["area_mm2"]
    assert area[0] == 0 and 10 < area[1] < area[2] < 400


def test_fit_and_report_go_by_the_law(law: Any, tmp_path: Path) -> None:
    model = FullOrderAreas(law(), refinement=0.4, time_step=0.1, force_step=0.2)
    for index in range(3):
        write_bag(tmp_path / "bags" / f"press_{index}", index, model)
    options = FitOptions(
        target_force=0.75,
        grid=2,
        particles=2,
        rounds=1,
        bias_pairs=0,
        bootstrap=0,
        profiles=False,
        nuisances=False,
    )
    result = fit_bags([tmp_path / "bags"], options, tmp_path / "fit", model=model)
    fit = result.fits["dry"]
    np.testing.assert_allclose(fit.parameters, TRUTH, rtol=0.02)
    assert fit.status == "final", "the fit's own model is the full-order model"

    entry = json.loads((tmp_path / "fit" / "fit.json").read_text())["conditions"]["dry"]
    assert set(entry) >= {"soft", "skin", "contrast", "correlation_soft_skin"}
    assert not {"E0", "E1", "tau1", "E2", "composite_E"} & set(entry)
    sets = ParameterSets.load(tmp_path / "fit" / "parameters.yaml")
    assert sets.law is law
    np.testing.assert_allclose(sets.interpolate(40.0).parameters, fit.parameters)

    page = (tmp_path / "fit" / "report.html").read_text()
    assert "two_springs" in page and "<i>Y</i> (kPa)" in page and "<i>S</i>" in page
    assert "Skin modulus over soft tissue modulus." in page and "τ" not in page
    table = cli.summary(result)
    assert [str(column.header) for column in table.columns][2:5] == ["Y kPa", "S kPa", "C"]


def test_unknown_law_ends_with_one_sentence(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "bag.mcap").write_bytes(b"")
    assert run(cli.command, [str(tmp_path / "bag.mcap"), "--law", "jelly"]) == 2
    assert "material law 'jelly' is not installed" in capsys.readouterr().err
