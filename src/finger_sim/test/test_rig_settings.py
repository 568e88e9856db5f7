# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the simulated rig: addresses apart, trials to come, bad values by name."""

import tempfile
from pathlib import Path

import pytest

from finger_common.errors import InputError
from finger_driver import can_bus
from finger_sim.addresses import RigAddresses
from finger_sim.rig_settings import RigSettings
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
    assert RigSettings(**one.parameters()).addresses() == one


def test_rigs_of_other_namespaces_have_other_folders_and_ports() -> None:
    spaces = ("finger", "/", "thumb", "hand/thumb", "hand/index", "hand_thumb")
    found = [RigSettings().addresses(space) for space in spaces]
    assert found[0].folder == Path("out/rig/devices").absolute()
    assert found[2].folder == Path("out/rig_thumb/devices").absolute()
    assert found[0].can_port == can_bus.DEFAULT_PORT == found[1].can_port
    assert len({a.can_port for a in found[1:]}) == 5
    assert all(1024 < a.can_port < 65536 for a in found)


def test_a_private_bus_has_a_port_that_no_node_gets_before_it(tmp_path: Path) -> None:
    """One of the system's own range was taken by a node's middleware before the bus opened."""
    ports = {RigAddresses.private(tmp_path).can_port for _ in range(200)}
    assert len(ports) > 100 and 7400 < min(ports) and max(ports) < 32768
    # A ROS domain d begins with 7400 + 250 d; its participants take the first ports.
    assert all((port - 7400) % 250 >= 200 for port in ports)


def test_two_rigs_share_neither_folder_nor_bus(tmp_path: Path) -> None:
    one = RigAddresses.private(tmp_path / "one")
    for other in (
        RigAddresses(one.folder, one.can_port + 1, one.can_channel),
        RigAddresses(tmp_path / "two", one.can_port, one.can_channel),
    ):
        with one.lock():
            with pytest.raises(InputError, match=r"in use by a simulated rig .* another can_port"):
                other.lock()
        with other.lock():
            pass


def test_the_bus_is_locked_without_a_file_that_stays_another_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file"))
    with RigAddresses.private(tmp_path / "rig").lock():
        pass


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
