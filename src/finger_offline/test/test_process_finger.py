# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A recording is processed with the finger it was made with, and through a change of the finger."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from live_recording import EventLog
from session_bags import START, wrench

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_common.errors import InputError
from finger_model.estimator import ContactEstimator, EstimateBlock, EstimatorSettings
from finger_model.estimator.estimate import ESTIMATE_DTYPE
from finger_model.finger import load_for, load_reduced
from finger_model.geometry import Geometry
from finger_model.messages import event_of
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced.model import ReducedModel
from finger_offline.contact_states import serialize
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions

THIN = Geometry(
    pad_semi_axis_radial=7e-3,
    pad_semi_axis_axial=5e-3,
    bone_semi_axis_radial=3.2e-3,
    nail_radius=5.8e-3,
)
MODERATE = Geometry(pad_semi_axis_radial=8e-3)
SETTINGS = EstimatorSettings(drift_sd=0.05, normal_axis="+z")
STEP = 2_000_000
PART = 1500


def calibrated(geometry: Geometry) -> ParameterSets:
    """Sets as the calibration of a subject whose finger was measured gives them."""
    sets = ParameterSets.default()
    assert sets.prior is not None
    return sets.with_prior(sets.prior, geometry)


def live_recording(
    path: Path,
    fingers: Sequence[tuple[ReducedModel, ParameterSets]],
    lengths_told: bool = True,
) -> list[bytes]:
    """A bag as the recorder makes it beside a model node that begins anew with each finger, in the
    midst of a contact; gives the states that it published.

    lengths_told: whether events name the lengths of the finger in use.
    """
    published: list[bytes] = []
    before: ContactEstimator | None = None
    with BagWriter(path) as bag:
        tell = EventLog(bag).write
        for part, (model, sets) in enumerate(fingers):
            estimator = ContactEstimator(model, sets, SETTINGS)
            begin = START + part * PART * STEP
            event = estimator.start_event(begin)
            if not lengths_told:
                event = replace(event, parameter_sets=sets.to_yaml())
                estimator.apply_event(event)
            if before is not None:
                estimator.go_on_from(before)
            tell(event, begin)
            for k in range(PART):
                stamp = begin + k * STEP
                if k == 700:
                    tell(estimator.reset("asked"), stamp)
                force = max(0.0, 1.2 * float(np.sin((k + 500) / 300)))
                message = wrench(stamp, -force)
                bag.write("wrench", message, stamp)
                vector = message["wrench"]["force"]
                found = estimator.add_wrench(stamp, (vector["x"], vector["y"], vector["z"]))
                rows = np.array([tuple(e) for e in found], ESTIMATE_DTYPE)
                published += serialize(EstimateBlock(rows), "force_sensor")
                if k % 50 == 20:
                    area = stamp - 20_000_000, 42e-6 * force**0.7, 2e-6, 0 if force > 0.05 else 1
                    names = ("gross_area", "area_stddev", "flags")
                    fields = dict(zip(names, area[1:]))
                    bag.write("contact_area", {"header": {"stamp": area[0]}, **fields}, stamp + 1)
                    assert estimator.add_area(*area)
            before = estimator
    return published


def states(path: Path) -> list[bytes]:
    """The ContactStates of a bag."""
    with open_bag(path) as reader:
        return [item.raw for item in reader.messages(["/finger/contact_state"])]


def areas(path: Path, options: ProcessOptions | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Areas (n,) in m², of the model alone and corrected, by processing a bag."""
    blocks: list[EstimateBlock] = []
    process(path, None, options, on_block=blocks.append)
    alone, fused = (np.concatenate([b.column(n) for b in blocks]) for n in ("model_area", "area"))
    return alone, fused


def file_of(geometry: Geometry, path: Path) -> str:
    """A geometry.yaml."""
    path.write_text(yaml.safe_dump(geometry.to_dict()))
    return str(path)


@pytest.fixture
def geometry_file(tmp_path: Path) -> str:
    return file_of(THIN, tmp_path / "thin.yaml")


def test_a_finger_of_a_geometry_file_is_known_from_its_recording(
    tmp_path: Path, geometry_file: str
) -> None:
    finger = load_reduced("", geometry_file), ParameterSets.default()
    published = live_recording(tmp_path / "live", [finger])
    result = process(tmp_path / "live", tmp_path / "out")
    assert states(tmp_path / "out") == published
    assert result.problems == [] and result.notes == process(tmp_path / "live", None).notes
    # Naming it changes nothing.
    process(tmp_path / "live", tmp_path / "named", ProcessOptions(geometry_file=geometry_file))
    assert states(tmp_path / "named") == published


def test_an_earlier_recording_of_such_a_finger_needs_its_name(
    tmp_path: Path, geometry_file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    finger = load_reduced("", geometry_file), ParameterSets.default()
    published = live_recording(tmp_path / "live", [finger], lengths_told=False)
    arguments = ["process", str(tmp_path / "live"), "-o", str(tmp_path / "out")]
    for more in ([], ["--set", "drift_sd=0.1"]):
        assert run(command, [*arguments, *more]) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert (
            f"live: topic '/finger/model_events': recorded with reduced model {finger[0].hash[:8]}"
            in said
        )
        assert "--geometry" in said and "--model" in said
        assert not (tmp_path / "out").exists()
    assert run(command, [*arguments, "--geometry", geometry_file]) == 0
    assert states(tmp_path / "out") == published


def test_a_poor_model_file_is_named(tmp_path: Path) -> None:
    shipped = ReducedModel.load()
    live_recording(tmp_path / "live", [(shipped, ParameterSets.default())])
    meta = {**shipped.meta, "measured_error": {**shipped.measured_error, "rms_max": 0.022}}
    ReducedModel(shipped.arrays, meta).save(tmp_path / "poor.npz")
    shipped.save(tmp_path / "good.npz")
    for name, number in (("poor", 1), ("good", 0)):
        options = ProcessOptions(model_file=str(tmp_path / f"{name}.npz"))
        notes = process(tmp_path / "live", None, options).notes
        assert sum("is less exact than" in note for note in notes) == number


def test_a_named_finger_keeps_the_recorded_settings(tmp_path: Path) -> None:
    live_recording(tmp_path / "live", [(ReducedModel.load(), ParameterSets.default())])
    thin = load_reduced(geometry_file=THIN), ParameterSets.default()
    expected = live_recording(tmp_path / "thin", [thin])
    options = ProcessOptions(geometry_file=file_of(THIN, tmp_path / "thin.yaml"))
    result = process(tmp_path / "live", tmp_path / "out", options)
    assert states(tmp_path / "out") == expected
    assert any("none of the recording's" in note for note in result.notes)
    # The new bag tells of the finger that it is of.
    process(tmp_path / "out", tmp_path / "again")
    assert states(tmp_path / "again") == expected


def test_given_settings_and_parameters_keep_the_recorded_finger(tmp_path: Path) -> None:
    thin = load_reduced(geometry_file=THIN)
    live_recording(tmp_path / "live", [(thin, ParameterSets.default())])
    model, fused = areas(tmp_path / "live")
    alone = areas(tmp_path / "live", ProcessOptions(estimator={"fuse_area": False}))
    assert np.array_equal(alone[0], model) and not np.array_equal(alone[1], fused)
    sets = ParameterSets(ParameterSets.default().sets[:1])
    sets.save(tmp_path / "dry.yaml")
    live_recording(tmp_path / "dry", [(thin, sets)])
    given = ProcessOptions(parameter_file=str(tmp_path / "dry.yaml"))
    assert np.array_equal(areas(tmp_path / "live", given), areas(tmp_path / "dry"))


def test_a_setting_that_contradicts_a_recorded_one_is_refused(tmp_path: Path) -> None:
    live_recording(tmp_path / "live", [(ReducedModel.load(), ParameterSets.default())])
    with pytest.raises(InputError, match=r"liftoff_force.*onset_force"):
        process(tmp_path / "live", None, ProcessOptions(estimator={"onset_force": 0.02}))


def test_a_node_that_began_anew_with_another_finger_is_followed(tmp_path: Path) -> None:
    default = ReducedModel.load(), ParameterSets.default()
    subject = calibrated(MODERATE)
    fingers = [
        default,
        (load_for(subject), subject),
        (load_reduced(geometry_file=THIN), default[1]),
    ]
    published = live_recording(tmp_path / "live", fingers)
    result = process(tmp_path / "live", tmp_path / "out", ProcessOptions(slip=True, shape=True))
    assert result.problems == [] and states(tmp_path / "out") == published


def test_a_named_finger_of_the_recording_leaves_the_others(
    tmp_path: Path, geometry_file: str
) -> None:
    subject = calibrated(MODERATE)
    thin = load_reduced("", geometry_file), ParameterSets.default()
    fingers = [(load_for(subject), subject), thin]
    published = live_recording(tmp_path / "live", fingers, lengths_told=False)
    result = process(
        tmp_path / "live", tmp_path / "out", ProcessOptions(geometry_file=geometry_file)
    )
    assert states(tmp_path / "out") == published
    assert not any("named" in note for note in result.notes)


def test_parameters_of_another_finger_than_the_named_one_are_refused(
    tmp_path: Path, geometry_file: str
) -> None:
    live_recording(tmp_path / "live", [(ReducedModel.load(), ParameterSets.default())])
    parameters = str(tmp_path / "S01.yaml")
    calibrated(MODERATE).save(parameters)
    both = ProcessOptions(parameter_file=parameters, geometry_file=geometry_file)
    with pytest.raises(InputError, match=r"S01.yaml: holds the lengths of another finger .*thin"):
        process(tmp_path / "live", None, both)
    # Their own lengths go with them.
    one = ProcessOptions(parameter_file=parameters)
    result = process(tmp_path / "live", tmp_path / "out", one)
    assert any("none of the recording's" in note for note in result.notes)
    with open_bag(tmp_path / "out") as reader:
        (event, *_) = [event_of(m.message) for m in reader.messages(["/finger/model_events"])]
    assert event.model_hash == load_for(calibrated(MODERATE)).hash
    assert event.estimator_settings() == SETTINGS
