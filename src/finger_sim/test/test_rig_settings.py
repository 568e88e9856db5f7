"""Settings of the simulated rig: addresses apart, trials to come, bad values by name."""

from pathlib import Path

import pytest

from finger_common.errors import InputError
from finger_sim.rig_settings import RigAddresses, RigSettings
from finger_sim.trial_plan import TrialRequest


def test_blocks_become_requests_in_the_order_of_the_session() -> None:
    settings = RigSettings("rig", seed=7, upcoming=["dry:2", "moist:1"])
    assert settings.upcoming_trials() == [
        TrialRequest("dry", 0, 0, 7),
        TrialRequest("dry", 1, 0, 7),
        TrialRequest("moist", 2, 0, 7),
    ]
    assert RigSettings("rig").upcoming_trials() == []


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"folder": ""}, "'folder' is empty"),
        ({"upcoming": ["dry"]}, "block 'dry'.*CONDITION:TRIALS"),
        ({"upcoming": ["wet:3"]}, "condition 'wet'.*dry, natural, moist"),
        ({"frame_rate": 0.0}, "'frame_rate' is 0.0, outside 0.5 … 60 Hz"),
    ],
)
def test_values_that_cannot_be_used_are_named(values: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        RigSettings(**{"folder": "rig", **values})


def test_private_addresses_differ_and_are_parameters_of_the_rig(tmp_path: Path) -> None:
    one, other = (RigAddresses.private(tmp_path / name) for name in ("one", "other"))
    assert (one.can_channel, one.can_port) != (other.can_channel, other.can_port)
    assert RigSettings(**one.parameters()).addresses == one


def test_faults_are_read_with_their_number() -> None:
    faults = ["force status 0x0802", "camera silent", "moisture unplugged"]
    assert RigSettings("rig", faults=faults).present_faults() == [
        ("force", "status", 0x802),
        ("camera", "silent", -1),
        ("moisture", "unplugged", -1),
    ]


@pytest.mark.parametrize("fault", ["force", "force unplugged", "plate silent", "camera silent x"])
def test_a_fault_that_does_not_exist_is_refused(fault: str) -> None:
    with pytest.raises(InputError, match=f"fault '{fault}'"):
        RigSettings("rig", faults=[fault])
