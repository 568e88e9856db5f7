# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Building a reduced model: coordinates, gradient of the training, a small build, resuming."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from finger_common.cli import EXIT_BAD_INPUT, EXIT_INTERRUPTED
from finger_model.cli import main
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.laws.standard_linear_solid import PARAMETERS
from finger_model.reduced import ReducedModel
from finger_model.reduced import build as one
from finger_model.reduced import population_build as all_fingers
from finger_model.reduced.build import build, parts_folder
from finger_model.reduced.build_settings import BuildSettings
from finger_model.reduced.force_histories import KINDS, random_history
from finger_model.reduced.maps import sigmoid
from finger_model.reduced.training import (
    Network,
    drive_samples,
    features,
    fit,
    stack,
    strain_scales,
)
from finger_model.reduced.training_runs import principal_modes, run_case, training_case, weight_of

LENGTH = 8.5e-3
SMALL = BuildSettings(
    histories=12,
    held_out=6,
    pilots=3,
    latents=2,
    drive_width=8,
    contact_width=8,
    iterations=6,
    refinement=0.5,
)


@pytest.fixture(scope="module")
def runs() -> list:
    full = FullOrderModel(refinement=0.5)
    fields = [run_case(full, training_case(1, i), None, 0.25)[1] for i in (1, 3)]
    modes = principal_modes(np.concatenate(fields), weight_of(full), 3)
    found = []
    for i in range(4):
        case = training_case(2, i)
        # So many rows that the full order has to divide few of them.
        time = np.interp(np.arange(4 * len(case.time) - 3) / 4, range(len(case.time)), case.time)
        force = np.interp(time, case.time, case.force)
        found.append(run_case(full, replace(case, time=time, force=force), modes, 0.25)[0])
    return found


def test_histories_are_in_order_and_within_the_range() -> None:
    for i in range(60):
        case = training_case(0, i)
        limits = PARAMETERS.range
        assert np.all((case.parameters >= limits[:, 0]) & (case.parameters <= limits[:, 1]))
        assert np.all(np.diff(case.time) > 0)
        assert case.force.min() >= 0
        assert case.force.max() <= 3.5
    rng = np.random.default_rng(0)
    for kind in KINDS:
        time, force = random_history(rng, kind)
        assert np.all(np.diff(time) > 0)
        assert force.max() >= 0.6
    assert np.all(PARAMETERS.box[:, 0] >= limits[:, 0])


def test_the_internal_strain_follows_its_equation_in_the_coordinates(runs: list) -> None:
    """τ da/dt = (1 − r) b − a with τ = τ1 r, r = E1/(E0 + E1), exact for b linear within a row."""
    for run in runs:
        E0, E1, tau1, _ = run.parameters
        r = E1 / (E0 + E1)
        a, b = run.internal, (1 - r) * run.total
        h = (np.diff(run.time) / (tau1 * r))[:, None]
        mean = -np.expm1(-h) / h
        expected = np.exp(-h) * a[:-1] + (mean - np.exp(-h)) * b[:-1] + (1 - mean) * b[1:]
        error = np.abs(a[1:] - expected).max(axis=1) / np.abs(a).max()
        # A row that the full order had to cut has b in pieces.
        assert np.median(error) < 1e-9
        assert np.quantile(error, 0.9) < 1e-3


def test_the_jacobian_of_a_network_is_that_of_its_outputs(runs: list) -> None:
    samples = stack([drive_samples(r, LENGTH, 2) for r in runs])
    network = Network(samples, 8)
    x = ((samples.inputs - network.input_mean) / network.input_scale)[::7]
    outputs, jacobians = network.jacobians(network.values, x)
    assert np.array_equal(outputs, network.outputs(network.values, x))
    rng = np.random.default_rng(0)
    for _ in range(3):
        step = 1e-5 * rng.normal(size=len(network.values))
        ahead = network.outputs(network.values + step, x)
        behind = network.outputs(network.values - step, x)
        for j, matrix in enumerate(jacobians):
            assert np.allclose((ahead - behind)[:, j], 2 * matrix @ step, rtol=1e-4, atol=1e-9)


def test_training_brings_the_drive_to_two_percent_of_its_largest_spread(runs: list) -> None:
    samples = stack([drive_samples(r, LENGTH, 2) for r in runs])
    network = Network(samples, 12)
    shares: list[float] = []
    fit(network, samples, 40, shares.append)
    x = (samples.inputs - network.input_mean) / network.input_scale
    found = network.outputs(network.values, x) * network.output_scale + network.output_mean
    # In their own units: a target counts as much as the strain that it is a share of.
    error = np.sqrt(np.mean((samples.weights * (found - samples.targets)) ** 2, axis=0))
    spread = (samples.weights * samples.targets).std(0)
    assert np.all(error < 0.02 * spread.max())
    assert shares[-1] == 1.0


def test_the_kernels_evaluate_the_networks_of_the_file() -> None:
    """Along a history the compiled model has what the networks give at the states it visits."""
    model = ReducedModel.load()
    k, m = model.arrays["drive_weights_3"].shape[1] - 1, len(model.arrays["betas"])
    vector = np.array([90e3, 30e3, 0.1, 1500e3])
    time, force = random_history(np.random.default_rng(3), "reload")
    states = model.visited(vector, time, force)
    found = model.simulate(vector, time, force)
    assert states.shape == (len(time), k + m)

    def evaluate(name: str, inputs: np.ndarray) -> np.ndarray:
        a = {key.removeprefix(name + "_"): value for key, value in model.arrays.items()}
        z = (inputs - a["input_mean"]) / a["input_scale"]
        for layer in ("1", "2"):
            z = sigmoid(z @ a["weights_" + layer] + a["bias_" + layer])[0]
        return (z @ a["weights_3"] + a["bias_3"]) * a["output_scale"] + a["output_mean"]

    x = np.cbrt(force / (vector[0] * LENGTH**2))
    stiffness = np.full(len(x), np.log(vector[3] / vector[0]))
    nothing = np.zeros_like(states[:, :k])
    drive = evaluate("drive", features(x, states[:, :k], None, stiffness))
    rest = evaluate("drive", features(0 * x, nothing, None, stiffness))
    depth = strain_scales(x, states[:, :k]) ** (2 / 3) * drive[:, 0]
    depth -= strain_scales(0 * x, nothing) ** (2 / 3) * rest[:, 0]
    assert np.allclose(found.indentation, LENGTH * depth, rtol=1e-9, atol=1e-12)
    contact = evaluate("contact", features(x, states[:, :k], states[:, k:], stiffness))
    on = force > 0
    area = (LENGTH * x[on]) ** 2 * np.exp(contact[on, 0])
    assert np.allclose(found.area[on], area, rtol=1e-9)
    assert np.allclose(found.peak_pressure[on], force[on] / area * np.exp(contact[on, 1]))


@pytest.mark.parametrize("module, command", [(one, "reduce"), (all_fingers, "reduce-population")])
@pytest.mark.parametrize("seed", [1, 2], ids=["same", "other"])
def test_a_second_build_of_an_output_is_refused_and_leaves_the_runs_of_the_first(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    module: ModuleType,
    command: str,
    seed: int,
) -> None:
    output, folder = tmp_path / "model.npz", tmp_path / "model.npz.parts"
    codes: list[int] = []

    def code_of(*options: str) -> int:
        with pytest.raises(SystemExit) as ended:
            main([command, "-o", str(output), *options])
        return ended.value.code

    def second(*_: object) -> None:
        """In place of the first build's first runs."""
        if codes:
            raise AssertionError("two builds at once")
        codes.append(-1)
        (folder / "modes.npy").write_bytes(b"of the first")
        codes.append(code_of(f"--seed={seed}"))
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "_modes", second)
    assert code_of() == EXIT_INTERRUPTED
    assert codes[-1] == EXIT_BAD_INPUT
    assert f"{folder}: another build is writing there; wait until" in capsys.readouterr().err
    assert (folder / "modes.npy").read_bytes() == b"of the first"
    with parts_folder(output, "another") as parts:  # the lock has ended with the first build
        assert [file.name for file in parts.iterdir()] == ["belongs_to"]
    assert not folder.exists()


@pytest.mark.slow
def test_an_interrupted_build_continues_where_it_stopped(tmp_path: Path) -> None:
    class Enough(Exception):
        pass

    def stop(stage: str, share: float) -> None:
        if stage == "held-out runs" and share == 1.0:
            raise Enough

    output = tmp_path / "model.npz"
    with pytest.raises(Enough):
        build(Geometry(), output, SMALL, 2, stop)
    done = {f: f.stat().st_mtime_ns for f in (tmp_path / "model.npz.parts").glob("training*")}
    assert done
    seen: list[tuple[str, float]] = []
    model, table = build(Geometry(), output, SMALL, 2, lambda *s: seen.append(s))
    assert not [s for s in seen if s[0] in ("full-order runs", "choosing coordinates")]
    assert not (tmp_path / "model.npz.parts").exists()
    again = ReducedModel.load(output, Geometry())
    assert again.hash == model.hash
    assert again.measured_error["pairs"] == len(table.pairs) == 6
