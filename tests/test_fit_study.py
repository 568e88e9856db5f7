"""From bags on disk to fit.json: the fit against known truth, through bytes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_common.cli import run
from finger_fit import cli
from finger_model.reduced import ReducedModel
from finger_sim.conditions import STUDY
from finger_sim.press import plan_press
from finger_sim.study import simulate_study
from finger_sim.study_bag import START_NS, write_bag
from finger_sim.study_trial import FRAME_RATE, Misfit, StudyTrial, plan_study_trial, stream

QUICK = "--no-full-order --no-profiles --bootstrap 0 --bias-pairs 0 --grid 3 --quiet".split()


def reduced_trial(name: str, index: int, model: ReducedModel) -> StudyTrial:
    """A press of the study, its areas by the reduced model: fast, and exact to fit."""
    press = plan_press(stream(1, name, index, "press"))
    frames = np.arange(0.03, press.duration, 1.0 / FRAME_RATE)
    knots = np.union1d(press.time[::2], frames)
    force = np.interp(knots, press.time, press.force)
    area = np.interp(frames, knots, model.simulate(STUDY[name].material, knots, force).area)
    moisture = STUDY[name].draw_moisture(stream(1, name, index, "moisture"))
    return StudyTrial(name, index, press, frames, area, moisture, Misfit())


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five presses of the natural finger without area noise, one bag each."""
    folder = tmp_path_factory.mktemp("study")
    model = ReducedModel.load()
    for index in range(5):
        start = START_NS + index * 60_000_000_000
        trial = reduced_trial("natural", index, model)
        write_bag(folder / f"natural_{index:02d}", trial, 1, False, start, noise=1e-12)
    return folder


def finger_fit(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "finger_fit.cli", *map(str, arguments)],
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip


def in_process(*arguments: object) -> int:
    """The command's exit code, without a process of its own."""
    return run(cli.command, list(map(str, arguments)))


def test_bags_in_parameters_and_report_out(bags: Path, tmp_path: Path) -> None:
    done = finger_fit(bags, "-o", tmp_path, *QUICK)
    assert done.returncode == 0, done.stderr
    entry = json.loads((tmp_path / "fit.json").read_text())["conditions"]["natural"]
    truth = STUDY["natural"].material
    # Of a finger whose lengths are known; allowing for them, the interval holds it.
    plain = entry["nuisance"]["without_nuisances"]
    for name, true, close in (
        ("composite_E", truth.composite_modulus, 0.02),
        ("E2", truth.E2, 0.05),
    ):
        assert plain[name] == pytest.approx(true, rel=close)
        assert abs(np.log(entry[name] / true)) < 2.0 * entry["sd_log"][name]
    assert entry["J"] < 0.05 * entry["J_power_law"]
    assert entry["trials"] == 5
    for name in ("parameters.yaml", "report.html", "figures/area_over_force.png"):
        assert (tmp_path / name).is_file()
    assert "natural" in done.stdout and "report.html" in done.stdout
    if entry["active_bounds"]:
        assert "natural: on a bound of the search box: " in done.stdout
    assert done.stdout.count("the data say little about") == 1


def test_ctrl_c_leaves_the_best_so_far_and_resume_continues(bags: Path, tmp_path: Path) -> None:
    arguments = [str(bags), "-o", str(tmp_path), *QUICK, "--rounds", "4000"]
    child = subprocess.Popen(
        [sys.executable, "-m", "finger_fit.cli", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    checkpoint = tmp_path / "checkpoint_natural_pso.json"
    try:
        for _ in range(2400):
            if checkpoint.exists() or child.poll() is not None:
                break
            time.sleep(0.05)
        os.kill(child.pid, signal.SIGINT)
        _, errors = child.communicate(timeout=120)
    finally:
        if child.poll() is None:
            child.kill()
    assert child.returncode == 130, errors
    assert "Traceback" not in errors
    entry = json.loads((tmp_path / "fit.json").read_text())["conditions"]["natural"]
    assert entry["status"] == "interrupted" and entry["J"] > 0
    done = len(json.loads(checkpoint.read_text())["costs"])
    again = finger_fit(*arguments[:-1], done + 2, "--resume")
    assert again.returncode == 0, again.stderr
    resumed = json.loads((tmp_path / "fit.json").read_text())["conditions"]["natural"]
    assert resumed["pso"]["rounds"] == done + 2 and resumed["J"] <= entry["J"]


def test_a_mapping_file_names_the_topic_of_the_force_and_its_unit(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mapping = tmp_path / "map.yaml"
    mapping.write_text("topics: {wrench: {topic: /finger/wrench, unit: N}}\n")
    quick = [*QUICK, "--rounds", 2, "--mapping", mapping]
    assert in_process(bags, "-o", tmp_path / "a", *quick) == 0
    mapping.write_text("topics: {wrench: {topic: /finger/wrench, unit: mN}}\n")
    assert in_process(bags, "-o", tmp_path / "b", *quick) == 2
    assert "no trial can be fitted" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.mcap"], ["missing.mcap", "no such bag"]),
        (["{bags}", "--condition", "wet"], ["'wet'", "natural"]),
        (["{bags}", "--bounds", "E0=9:1"], ["E0=9:1", "LOW < HIGH"]),
        (["{bags}", "--target-force", "9"], ["no trial can be fitted", "below the target"]),
        (["{bags}", "--bootstrap", "3", "--dask", "tcp://127.0.0.1:9"], ["tcp://127.0.0.1:9"]),
    ],
)
def test_bad_input_ends_with_one_sentence(
    bags: Path, tmp_path: Path, arguments, words, capsys: pytest.CaptureFixture[str]
) -> None:
    filled = [a.replace("{bags}", str(bags)) for a in arguments]
    assert in_process(*filled, "-o", tmp_path, "--quiet") == 2
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1
    for word in words:
        assert word in error


def test_a_folder_with_a_fit_of_another_subject_is_refused(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the fit, and nothing in it is changed."""
    earlier = json.dumps({"subjects": {"P02": {"subject": "P02", "conditions": {}}}})
    (tmp_path / "fit.json").write_text(earlier)
    assert in_process(bags, "-o", tmp_path, "--quiet") == 2
    assert "holds an earlier fit of P02, who are not among these trials" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]
    assert (tmp_path / "fit.json").read_text() == earlier


@pytest.mark.parametrize("blocked", ["report.html", "fit.json"])
def test_a_fit_whose_files_cannot_be_written_is_shown(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], blocked: str
) -> None:
    (tmp_path / "fit" / blocked).mkdir(parents=True)
    assert in_process(bags, "-o", tmp_path / "fit", "--rounds", "2", *QUICK) == 2
    shown, error = capsys.readouterr()
    assert re.search(r"natural +│ 5", shown) and "kPa (95 %)" in shown
    assert f"{blocked}: is a folder" in error and "report:" not in shown
    whole = blocked == "report.html"
    assert (("results and parameters are written, the report is not") in error) == whole
    assert (tmp_path / "fit" / "parameters.yaml").is_file() == whole


def test_two_fits_do_not_write_into_one_folder_at_once(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lock of a process that was killed does not stay."""
    out = tmp_path / "fit"
    holds = (
        "import sys, time; from pathlib import Path; from finger_fit.results import alone_in\n"
        "with alone_in(Path(sys.argv[1])): print('held', flush=True); time.sleep(600)"
    )
    command = [sys.executable, "-c", holds, str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        assert in_process(bags, "-o", out, "--rounds", "2", *QUICK) == 2
        assert "another fit is writing there; wait" in capsys.readouterr().err
        assert not list(out.iterdir())
        other.kill()
    assert in_process(bags / "natural_00", "-o", out, "--rounds", "2", *QUICK) == 2
    assert "no condition can be fitted" in capsys.readouterr().err
    assert in_process(bags / "natural_00", "-o", tmp_path / "new", "--rounds", "2", *QUICK) == 2
    assert not (tmp_path / "new").exists()


def test_a_finger_outside_the_population_box_is_told_what_a_fit_can_do(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "g.yaml").write_text("pad_semi_axis_radial: 0.013\n")
    arguments = ("--geometry", tmp_path / "g.yaml", "-o", tmp_path / "fit")
    assert in_process(bags, *arguments) == 2
    error = capsys.readouterr().err
    assert "'finger-model reduce' and give its file with --model" in error


def test_study_writes_bags_that_agree_with_their_metadata(tmp_path: Path) -> None:
    from finger_bag.reader import open_bag
    from finger_fit.options import FitOptions
    from finger_fit.study import load, reading

    folders = []
    for images in (False, True):
        folder = tmp_path / ("images" if images else "areas")
        simulate_study(
            3,
            folder,
            images,
            trials=1,
            conditions=["natural"],
            processes=1,
            refinement=0.6,
            report=None,
        )
        folders.append(folder)
    with open_bag(folders[0] / "natural_00") as reader:
        topics = {t.rsplit("/", 1)[-1] for t in reader.info.topics}
        assert "contact_area" in topics and "image_raw" not in topics
        assert "noise" in reader.info.metadata.extra["area_source"]
    with open_bag(folders[1] / "natural_00") as reader:
        topics = {t.rsplit("/", 1)[-1] for t in reader.info.topics}
        assert "contact_area" not in topics and "image_raw" in topics
    noisy, seen = (load([f], reading(FitOptions())) for f in folders)
    truth = plan_study_trial(3, "natural", 0, refinement=0.6)
    assert noisy.sources[0]["areas"] == ["topic"] and seen.sources[0]["areas"] == ["images"]
    times = (noisy.records[0].area_stamp_ns - START_NS) * 1e-9
    true = np.interp(times, truth.frame_time, truth.area)
    error = noisy.records[0].area - true
    assert 0.5e-6 < error.std() < 3e-6
    times = (seen.records[0].area_stamp_ns - START_NS) * 1e-9
    true = np.interp(times, truth.frame_time, truth.area)
    large = true > 20e-6
    assert np.abs(seen.records[0].area[large] / true[large] - 1).max() < 0.08
    assert len(noisy.records[0].moisture_before) == len(noisy.records[0].moisture_after) == 3


def test_study_is_repeatable_and_misfit_changes_it() -> None:
    plain = plan_study_trial(5, "dry", 2, refinement=0.5)
    again = plan_study_trial(5, "dry", 2, refinement=0.5)
    other = plan_study_trial(5, "dry", 2, misfit=True, refinement=0.5)
    np.testing.assert_array_equal(plain.area, again.area)
    np.testing.assert_array_equal(plain.press.force, other.press.force)
    assert abs(other.area.max() / plain.area.max() - 1) > 0.005
    assert other.misfit.aspect == 1.3 and other.misfit.epidermis_factor in (0.75, 1.25)


@pytest.fixture(scope="module")
def recovery(module_of: Callable[[str], Any]) -> Any:
    return module_of("scripts/recovery.py")


@pytest.mark.slow
def test_without_noise_the_corrected_fit_finds_the_finger(recovery: Any) -> None:
    """Three presses of a finger on a finer mesh than the fit's, the reduced model corrected to full
    order.
    """
    presses = [plan_study_trial(1, "natural", i, refinement=1.2) for i in range(3)]
    found = recovery.fit_one(presses, 0, "contact", False, ReducedModel.load(), None, search=False)
    assert abs(found["error_log"]["composite_E"]) < 0.01
    assert abs(found["error_log"]["E2"]) < 0.03
    assert abs(found["error_log"]["tau1"]) < 0.05
    assert found["J"] < 0.05, "mm⁴: what is left is the difference of two meshes"


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_recovery_over_twenty_seeds(recovery: Any, tmp_path: Path) -> None:
    """The targets; half a deviation of bias is that of the bias-corrected values."""
    result = recovery.run(tmp_path, 20)
    for row in result["clean"]:
        for kind in ("error_log", "corrected_error_log"):
            assert abs(row[kind]["composite_E"]) < 0.01, row
            assert abs(row[kind]["E2"]) < 0.03, row
    for r in result["rows"]:
        assert r["J"] <= 1.05 * r["J_truth"]
        gap, true = r["J_power_law"] - r["J"], r["J_power_law"] - r["J_truth"]
        assert abs(gap - true) <= max(0.1 * abs(true), 5.0), r
        assert r.get("start_from_truth", 1.0) > 0.999, "the search missed a valley"
    for kind in ("", "corrected_"):
        covered = []
        for window in recovery.WINDOWS:
            for name in STUDY:
                for quantity in ("composite_E", "E2", "tau1"):
                    if quantity == "tau1" and name != "natural":
                        continue
                    s = recovery.statistics(result["rows"], name, window, quantity, kind)
                    covered.append(s["coverage"])
                    if s["free"] >= recovery.FEWEST_FREE:
                        assert s["free_spread"] <= 1.2 * s["bound"], (window, name, quantity, s)
                    if kind:
                        assert abs(s["bias"]) < 0.5 * s["spread"], (window, name, quantity, s)
        assert 0.90 <= np.mean(covered) <= 0.99, kind
