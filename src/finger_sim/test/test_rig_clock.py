# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated rig after a step of the system clock: devices and participant go on."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_common.host_clock import HostClock
from finger_common.stamps import NANOSECONDS
from finger_sim.participant import FrameClock, Participant, _Press
from finger_sim.rig import SimulatedRig
from finger_sim.rig_settings import RigSettings

PERIOD = NANOSECONDS // 10


@pytest.fixture(params=[-3600, 3600], ids=["back", "forth"])
def stepped(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> FrameClock:
    """The clock of a rig that was started before the system clock was stepped by an hour."""
    real = time.time_ns
    host = HostClock(wall=lambda: time.time_ns())
    clock = FrameClock(host.now() + PERIOD, PERIOD, host)
    monkeypatch.setattr(time, "time_ns", lambda: real() + request.param * NANOSECONDS)
    return clock


def waits_of(user: Any) -> list[float]:
    """What `user` waits (s) from now on, and does not."""
    waits: list[float] = []
    user._stop = SimpleNamespace(wait=waits.append)
    return waits


def test_the_camera_waits_for_its_next_frame_alone(stepped: FrameClock) -> None:
    rig = SimulatedRig(RigSettings())
    rig._clock = stepped
    waits = waits_of(rig)
    rig._wait_until(stepped.first_ns)
    assert 0.0 <= waits[0] <= PERIOD / NANOSECONDS


def test_a_press_begins_with_the_next_frames_and_takes_its_time(stepped: FrameClock) -> None:
    played: list[int] = []
    participant = Participant(
        None,
        stepped,
        print,
        lambda trial, start_ns: played.append(start_ns),  # type: ignore[arg-type]
    )
    waits = waits_of(participant)
    now = stepped.host.now()
    participant._play(SimpleNamespace(press=SimpleNamespace(duration=4.0)))  # type: ignore[arg-type]
    assert 0.0 <= (played[0] - now) / NANOSECONDS < 0.5
    assert 4.0 <= waits[0] < 4.5


def test_the_force_sensor_feels_the_press_while_it_is_played(stepped: FrameClock) -> None:
    """The simulated board asks by the system clock."""
    rig = SimulatedRig(RigSettings())
    rig._clock = stepped
    rig.participant = Participant(None, stepped, print, print)  # type: ignore[arg-type]
    press = SimpleNamespace(time=np.array([0.0, 10.0]), force=np.array([1.0, 1.0]), duration=10.0)
    unloaded = rig.wrench(time.time_ns())[2]
    trial = SimpleNamespace(press=press, pull=None)
    rig.participant._press = _Press(trial, stepped.host.now() - NANOSECONDS)  # type: ignore[arg-type]
    rig.participant.pressure_center = lambda now_ns: np.zeros(2)  # type: ignore[method-assign]
    assert unloaded - rig.wrench(time.time_ns())[2] == pytest.approx(1.0)
