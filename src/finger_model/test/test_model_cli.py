# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command line: CSV and YAML contract, figures, files, errors in one sentence."""

import csv
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import yaml

from finger_common.cli import run
from finger_common.errors import ModelError
from finger_model.cli import _main
from finger_model.geometry import Geometry
from finger_model.history import CSV_HEADER
from finger_model.laws import StandardLinearSolid
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.reduced import ReducedModel


@pytest.fixture
def force_file(tmp_path):
    path = tmp_path / "force.csv"
    rows = [(0.05 * k, min(0.135 * k, 1.35 - 0.135 * max(k - 12, 0))) for k in range(0, 20)]
    path.write_text("time_s,force_n\n" + "".join(f"{t:.2f},{f:.4f}\n" for t, f in rows))
    return path


def read(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_full_order_csv_figure_and_vtu(tmp_path, force_file):
    out, png, vtu = tmp_path / "o.csv", tmp_path / "s.png", tmp_path / "s.vtu"
    code = run(
        _main,
        [
            "simulate",
            "--force",
            str(force_file),
            "--solver",
            "full",
            "-o",
            str(out),
            "--plot",
            str(png),
            "--vtu",
            str(vtu),
            "--at",
            "0.5",
        ],
    )
    assert code == 0
    assert out.read_text().splitlines()[0] == CSV_HEADER
    rows = read(out)
    assert len(rows) == 20
    assert [float(r["force_n"]) for r in rows] == [float(r["force_n"]) for r in read(force_file)]
    peak = max(rows, key=lambda r: float(r["area_mm2"]))
    assert 50 < float(peak["area_mm2"]) < 75
    assert float(peak["area_mm2"]) == pytest.approx(np.pi * float(peak["radius_mm"]) ** 2, rel=1e-4)
    assert png.read_bytes().startswith(b"\x89PNG")
    mesh = meshio.read(vtu)
    assert mesh.point_data["displacement"][:, 2].max() > 0.5e-3
    assert mesh.cell_data["von_mises"][0].max() > 10e3


def test_geometry_and_material_files_are_used(tmp_path, force_file):
    (tmp_path / "g.yaml").write_text("pad_semi_axis_radial: 7.5e-3\nnail_radius: 6.0e-3\n")
    (tmp_path / "m.yaml").write_text("E0: 160e3\nE1: 15e3\ntau1: 0.01\nE2: 700e3\n")
    out = tmp_path / "o.csv"
    arguments = ["simulate", "--force", str(force_file), "-o", str(out), "--refinement", "0.7"]
    arguments += ["--geometry", str(tmp_path / "g.yaml"), "--material", str(tmp_path / "m.yaml")]
    assert run(_main, arguments) == 0
    assert max(float(r["area_mm2"]) for r in read(out)) > 60


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,force_n\n0,0\n0,1\n", "does not increase"),
        ("time_s,load\n0,0\n", "force_n"),
        ("time_s,force_n\n0,abc\n", "line 2"),
        ("", "empty"),
    ],
)
def test_bad_force_files_end_with_one_sentence(tmp_path, capsys, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert run(_main, ["simulate", "--force", str(path), "--solver", "full"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and words in error and "bad.csv" in error


def test_a_fit_is_simulated_without_retyping(tmp_path, force_file, capsys):
    """A set of parameters.yaml, by condition or moisture, with its law and its lengths."""
    geometry = Geometry(pad_semi_axis_radial=9e-3)
    material = StandardLinearSolid(E0=90e3, E1=30e3)
    other = StandardLinearSolid(E0=140e3)
    sets = [
        ParameterSet("dry", 40.0, 1.0, tuple(other.vector())),
        ParameterSet("natural", 70.0, 1.0, tuple(material.vector())),
    ]
    whole, hashed, one = (tmp_path / name for name in ("whole.yaml", "hashed.yaml", "one.yaml"))
    ParameterSets(sets, geometry=geometry).save(whole)
    ParameterSets(sets, geometry.hash()).save(hashed)
    ParameterSets(sets[1:], geometry.hash()).save(one)
    (tmp_path / "g.yaml").write_text("pad_semi_axis_radial: 0.009\n")
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(material.to_dict()))
    simulate = ["simulate", "--force", str(force_file)]
    lengths = ["--geometry", str(tmp_path / "g.yaml")]

    def output(*arguments):
        assert run(_main, [*simulate, *map(str, arguments)]) == 0
        return capsys.readouterr()

    wanted = output(*lengths, "--material", tmp_path / "m.yaml").out
    assert output("--parameters", whole, "--condition", "natural").out == wanted
    assert output("--parameters", hashed, "--moisture", 70, *lengths).out == wanted
    assert output("--parameters", one, *lengths).out == wanted
    beyond = output("--parameters", whole, "--moisture", 90)
    assert beyond.out == wanted and "lies outside the sets" in beyond.err
    for arguments, words in (
        (["--condition", "dry"], "choose a set of --parameters"),
        (["--parameters", whole], "holds 2 sets; choose one by its condition (dry, natural)"),
        (["--parameters", whole, "--condition", "natral"], "did you mean 'natural'?"),
        (["--parameters", whole, "--condition", "dry", "--moisture", "1"], "one of the two"),
        (["--parameters", whole, "--material", "m.yaml"], "one of the two"),
        (["--material", whole], "give it with --parameters instead"),
        (["--parameters", hashed, "--condition", "dry"], "fitted with another finger"),
    ):
        assert run(_main, [*simulate, *map(str, arguments)]) == 2
        assert words in capsys.readouterr().err


def test_where_the_reduced_model_cannot_the_full_order_goes_on(tmp_path, capsys, monkeypatch):
    """It says why, without the remedy that it is itself."""
    force, material, out = (tmp_path / name for name in ("f.csv", "m.yaml", "o.csv"))
    force.write_text("time_s,force_n\n0,0\n1,0.2\n")
    material.write_text("E0: 80e3\nE1: 1e15\ntau1: 1.0\nE2: 1e6\n")
    arguments = ["simulate", "--force", str(force), "-o", str(out), "--material", str(material)]
    assert run(_main, arguments) == 0
    error = capsys.readouterr().err
    assert "using the full-order model: material: 'E1' is 1e+15" in error
    assert "--solver" not in error

    def refuses(*_):
        raise ModelError("the reduced model cannot follow the force of 0.2 N; use --solver full")

    monkeypatch.setattr("finger_model.finger.simulate_reduced", refuses)
    first = out.read_bytes()
    assert run(_main, arguments) == 0
    error = capsys.readouterr().err
    assert "using the full-order model: the reduced model cannot follow the force of 0.2 N" in error
    assert out.read_bytes() == first


def test_a_reduced_model_brings_its_own_lengths(tmp_path, force_file, capsys):
    """As with --geometry of the finger that it was made for; another finger is refused."""
    shipped = ReducedModel.load()
    own = Geometry(epidermis_thickness=0.2e-3)  # outside the population box
    meta = {**shipped.meta, "geometry": own.to_dict(), "geometry_hash": own.hash()}
    ReducedModel(shipped.arrays, meta).save(tmp_path / "own.npz")
    (tmp_path / "own.yaml").write_text("epidermis_thickness: 0.0002\n")
    (tmp_path / "other.yaml").write_text("epidermis_thickness: 0.0003\n")
    sets = [ParameterSet("dry", 40.0, 1.0, tuple(StandardLinearSolid().vector()))]
    ParameterSets(sets, own.hash()).save(tmp_path / "fit.yaml")
    simulate = [
        "simulate",
        "--force",
        str(force_file),
        "--reduced-model",
        str(tmp_path / "own.npz"),
    ]
    assert run(_main, [*simulate, "--geometry", str(tmp_path / "own.yaml")]) == 0
    wanted = capsys.readouterr().out
    for arguments in ([], ["--parameters", str(tmp_path / "fit.yaml")]):
        assert run(_main, [*simulate, *arguments]) == 0
        assert capsys.readouterr().out == wanted
    assert run(_main, [*simulate, "--geometry", str(tmp_path / "other.yaml")]) == 2
    assert "was made for another geometry" in capsys.readouterr().err


def test_contradictory_options_are_refused(tmp_path, force_file, capsys):
    arguments = ["simulate", "--force", str(force_file), "--reduced-model", "none.npz"]
    for other in (["--solver", "full"], ["--refinement", "2"], ["--plot", "a.png"]):
        assert run(_main, [*arguments, *other]) == 2
        assert "--reduced-model does not go with" in capsys.readouterr().err
    arguments = ["simulate", "--force", str(force_file), "--solver", "reduced"]
    assert run(_main, [*arguments, "--plot", str(tmp_path / "x.png")]) == 2
    assert "--solver full" in capsys.readouterr().err


def test_a_force_file_is_not_replaced_by_the_result(force_file, capsys):
    before = force_file.read_bytes()
    assert run(_main, ["simulate", "--force", str(force_file), "-o", str(force_file)]) == 2
    assert "is an input too" in capsys.readouterr().err and force_file.read_bytes() == before


@pytest.mark.parametrize("solver", ["full", "reduced"])
def test_a_folder_as_output_is_one_sentence(tmp_path, force_file, capsys, solver):
    arguments = ["simulate", "--force", str(force_file), "--solver", solver, "-o", str(tmp_path)]
    assert run(_main, arguments) == 2
    assert "is a folder" in capsys.readouterr().err


def test_moduli_in_kilopascals_and_a_crushed_finger_are_refused(tmp_path, force_file, capsys):
    (tmp_path / "m.yaml").write_text("E0: 140\nE1: 22\nE2: 1795\n")
    arguments = ["simulate", "--force", str(force_file), "--solver", "full"]
    assert run(_main, [*arguments, "--material", str(tmp_path / "m.yaml")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "give moduli in Pa" in error and "m.yaml" in error
    (tmp_path / "high.csv").write_text("time_s,force_n\n0,0\n1,300\n")
    assert run(_main, ["simulate", "--force", str(tmp_path / "high.csv"), "--solver", "full"]) == 2
    # A busy machine takes so long that lines of progress come before.
    *_, error = capsys.readouterr().err.splitlines()
    assert "s, " in error and "N: tissue is squeezed" in error


def test_help_shows_an_example():
    for command in ([], ["simulate"], ["verify"]):
        done = subprocess.run(
            [sys.executable, "-m", "finger_model.cli", *command, "--help"],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0 and "example:" in done.stdout


def test_verify_prints_numbers_and_refuses_unknown_checks(capsys):
    assert run(_main, ["verify", "disc"]) == 0
    assert "error of the rim's displacement" in capsys.readouterr().out
    assert run(_main, ["verify", "nothing"]) == 2
    assert "check 'nothing' does not exist" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--population"], "--population is for --reduced: give that too, or leave it out"),
        (["disc", "--error-plot", "e.png"], "--error-plot is for --reduced"),
        (["--reduced", "disc"], "--reduced does not go with named checks"),
        (["--reduced", "--published"], "give one of the two"),
    ],
)
def test_options_of_another_verification_are_refused(options, words, capsys):
    assert run(_main, ["verify", *options]) == 2
    assert words in capsys.readouterr().err


def test_a_figure_gets_no_name_of_another_kind(force_file, tmp_path, capsys):
    plot = tmp_path / "stress.pdf"
    assert run(_main, ["simulate", "--force", str(force_file), "--plot", str(plot)]) == 2
    assert "is drawn as PNG; give a name that ends in .png" in capsys.readouterr().err
    assert not plot.exists()


def test_forces_of_the_wrong_sign_are_pointed_out(tmp_path, capsys):
    path = tmp_path / "force.csv"
    path.write_text("time_s,force_n\n0,0\n1,-1\n")
    assert run(_main, ["simulate", "--force", str(path), "-o", str(tmp_path / "o.csv")]) == 0
    assert "no force above zero" in capsys.readouterr().err


@pytest.mark.parametrize("solver", ["reduced", "full"])
def test_a_release_in_one_row_is_that_in_many_rows(tmp_path: Path, solver: str) -> None:
    """A finger that creeps is elsewhere on the way back: a falling load is divided."""
    last = []
    for rows in (60, 1):
        time = np.concatenate([np.linspace(0.0, 1.0, 41), np.linspace(1.0, 2.0, rows + 1)[1:]])
        force = 1.35 * np.minimum(time, 1.0) - 1.15 * np.maximum(time - 1.0, 0.0)
        path, out = tmp_path / f"{rows}.csv", tmp_path / f"out_{rows}.csv"
        np.savetxt(path, np.column_stack([time, force]), delimiter=",", header="time_s,force_n",
                   comments="")  # fmt: skip
        call = ["simulate", "--force", str(path), "--solver", solver, "-o", str(out)]
        call += ["--refinement", "0.5"] if solver == "full" else []
        assert run(_main, call) == 0
        table = np.genfromtxt(out, delimiter=",", names=True)
        assert len(table) == len(time)
        last.append(table["area_mm2"][-1])
    assert last[1] == pytest.approx(last[0], rel=0.01)


@pytest.mark.parametrize(
    ("rows", "says"),
    [("1e308,1", "row 2 is 1e+308 s; give times in seconds"), ("1700000000000000000,1", "row 2")],
)
def test_a_time_of_another_unit_is_refused(tmp_path, capsys, rows, says) -> None:
    (tmp_path / "force.csv").write_text(f"time_s,force_n\n0,0\n{rows}\n")
    assert run(_main, ["simulate", "--force", str(tmp_path / "force.csv")]) == 2
    assert says in capsys.readouterr().err


def test_a_force_that_is_rounding_is_no_contact(tmp_path) -> None:
    (tmp_path / "force.csv").write_text("time_s,force_n\n0,0\n1,5e-324\n2,1\n")
    out = tmp_path / "out.csv"
    assert run(_main, ["simulate", "--force", str(tmp_path / "force.csv"), "-o", str(out)]) == 0
    assert float(read(out)[1]["area_mm2"]) == 0.0 < float(read(out)[2]["area_mm2"])


@pytest.mark.parametrize("moisture", ["690", "-5", "1e308"])
def test_a_moisture_off_the_scale_is_refused(tmp_path, force_file, capsys, moisture) -> None:
    ParameterSets.default().save(tmp_path / "p.yaml")
    words = ["--parameters", str(tmp_path / "p.yaml"), "--moisture", moisture]
    assert run(_main, ["simulate", "--force", str(force_file), *words]) == 2
    assert "a number in 0 … 130 a.u. is needed" in capsys.readouterr().err


def test_a_condition_of_two_sets_is_said_to_be_so(tmp_path, force_file, capsys) -> None:
    sets = ParameterSets.default()
    twice = [replace(s, condition="natural") for s in sets.sets[:2]]
    ParameterSets(twice).save(tmp_path / "p.yaml")
    words = ["--parameters", str(tmp_path / "p.yaml"), "--condition", "natural"]
    assert run(_main, ["simulate", "--force", str(force_file), *words]) == 2
    says = capsys.readouterr().err
    assert "2 sets are of the condition 'natural'; choose one by its moisture" in says
    assert "did you mean" not in says


def test_a_picture_does_not_replace_the_table(tmp_path, force_file, capsys) -> None:
    out = str(tmp_path / "p.csv")
    assert run(_main, ["simulate", "--force", str(force_file), "-o", out, "--plot", out]) == 2
    assert "is named for two outputs" in capsys.readouterr().err
