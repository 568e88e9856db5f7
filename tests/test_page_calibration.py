"""*Calibrate subject* from the page in a real browser, with the real protocol, page and model.

In the place of devices and participant a thread publishes forces and areas of a finger with a known
area, press by press as the cues ask for them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_looks import OVERFLOW, shots, violations

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import WrenchStamped  # noqa: E402

from finger_common.flags import AreaFlag  # noqa: E402
from finger_common.guided_presses import CALIBRATION_PRESSES, PRESS_BY_NAME  # noqa: E402
from finger_common.node import LATCHED_QOS  # noqa: E402
from finger_common.stamps import fill_time  # noqa: E402
from finger_common.trial_phases import TrialPhase  # noqa: E402
from finger_model.parameter_sets import ParameterSets  # noqa: E402
from finger_model.reduced import ReducedModel  # noqa: E402
from finger_msgs.msg import ContactArea, Moisture, Trial  # noqa: E402
from finger_sim.press import guided_style, plan_press  # noqa: E402

LARGER = 1.25
"""Areas of the finger over those of the shipped one."""
MOISTURE = 69.31
"""a.u., of the natural finger."""
PERIOD = 0.01
FRAME = 0.1
READING = 0.5
"""s between samples of the force, between areas, and between readings of the moisture probe."""


class Participant(threading.Thread):
    """Presses when the cue says so; in between nothing is on the plate."""

    def __init__(self, domain: int) -> None:
        super().__init__(daemon=True)
        self.presses = {press.name: self._plan(press) for press in CALIBRATION_PRESSES}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("devices", namespace="finger", context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._wrench = self._node.create_publisher(WrenchStamped, "wrench", 50)
        self._area = self._node.create_publisher(ContactArea, "contact_area", 10)
        self._moisture = self._node.create_publisher(Moisture, "moisture", 10)
        self._node.create_subscription(Trial, "trial", self._on_trial, LATCHED_QOS)
        self._pressing: tuple[str, float] | None = None
        self._phase = TrialPhase.IDLE
        self._end = threading.Event()

    @staticmethod
    def _plan(press: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rng = np.random.default_rng(CALIBRATION_PRESSES.index(press))
        plan = plan_press(rng, style=guided_style(press), target_force=press.target_force)
        parameters = ParameterSets.default().interpolate(MOISTURE).parameters
        area = ReducedModel.load().simulate(parameters, plan.time, plan.force).area
        return plan.time, plan.force, LARGER * area

    def _on_trial(self, message: Trial) -> None:
        phase = TrialPhase(message.phase)
        if phase is TrialPhase.PRESS and self._phase is not phase:
            self._pressing = (message.condition, time.time() + 0.3)
        elif phase not in (TrialPhase.PRESS, TrialPhase.LIFT):
            self._pressing = None
        self._phase = phase

    def _now(self) -> tuple[float, float]:
        """Force and area."""
        if self._pressing is None:
            return 0.0, 0.0
        name, began = self._pressing
        at, force, area = self.presses[name]
        since = time.time() - began
        return (
            float(np.interp(since, at, force, left=0.0, right=0.0)),
            float(np.interp(since, at, area, left=0.0, right=0.0)),
        )

    def run(self) -> None:
        next_frame = next_sample = next_reading = time.monotonic()
        while not self._end.is_set():
            self._executor.spin_once(timeout_sec=max(next_sample - time.monotonic(), 0.0))
            if time.monotonic() < next_sample:
                continue
            next_sample = max(next_sample + PERIOD, time.monotonic())
            stamp, (force, area) = time.time_ns(), self._now()
            wrench = WrenchStamped()
            wrench.wrench.force.z = -force
            fill_time(wrench.header.stamp, stamp)
            self._wrench.publish(wrench)
            if time.monotonic() >= next_frame:
                next_frame = max(next_frame + FRAME, time.monotonic())
                flags = 0 if area > 0 else int(AreaFlag.NO_CONTACT)
                message = ContactArea(gross_area=area, area_stddev=1e-6, flags=flags)
                fill_time(message.header.stamp, stamp)
                self._area.publish(message)
            wanted = self._phase in (TrialPhase.MOISTURE_BEFORE, TrialPhase.MOISTURE_AFTER)
            if wanted and time.monotonic() >= next_reading:
                next_reading = time.monotonic() + READING
                reading = Moisture(value=MOISTURE)
                fill_time(reading.header.stamp, stamp)
                self._moisture.publish(reading)

    def close(self) -> None:
        self._end.set()
        self.join(10)
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


BUSY = (
    "need_recorder:=false", "gap_limit:=2.0", "frame_gap_limit:=3.0", "stale_after:=3.0",
    "release_time:=1.0", "lift_timeout:=20.0", "max_attempts:=20",
)  # fmt: skip
"""Limits of the protocol that a loaded machine keeps."""


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(900)
def test_calibrate_subject_from_the_page_to_the_live_model(
    ros_domain: int,
    process: Callable[..., Any],
    free_port: Callable[[], int],
    tmp_path: Path,
    browser: Any,
    project_root: Path,
) -> None:
    port, subjects = free_port(), tmp_path / "subjects"

    def start(module: str, *parameters: str) -> None:
        flags = [flag for parameter in parameters for flag in ("-p", parameter)]
        process("-m", module, "--ros-args", "-r", "__ns:=/finger", *flags)

    start("finger_model.model_node", f"subjects_folder:={subjects}", "gap_limit:=2.0")
    start("finger_operator.protocol_node", f"output:={tmp_path / 'sessions'}", *BUSY)
    start("finger_operator.page_node", f"port:={port}")
    participant = Participant(ros_domain)
    participant.start()
    page = browser.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))

    def until(condition: Callable[[], Any], what: str, seconds: float = 120.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"no {what}; {page.inner_text('body')}"
            page.wait_for_timeout(100)

    def served() -> bool:
        try:
            page.goto(f"http://127.0.0.1:{port}/")
        except Exception:  # the server is not there yet
            page.wait_for_timeout(300)
            return False
        return True

    end = time.monotonic() + 60
    while not served():
        assert time.monotonic() < end, "the page is not served"
    until(lambda: page.is_hidden("#banner"), "rig without a problem")
    until(lambda: "Press Space" in page.inner_text("#cue-text"), "plan")
    page.keyboard.press("Space")
    page.fill("#plan-subject", "S01")
    page.fill("#plan-width", "15.5")
    page.fill("#plan-depth", "11.2")
    page.click("#plan-calibrate")
    page.wait_for_selector("#session-dialog:not([open])", state="attached", timeout=30e3)
    first = CALIBRATION_PRESSES[0]
    until(lambda: f"Trial 1 of {len(PRESS_BY_NAME)}" in page.inner_text("#cue-trial"), "trial")
    until(lambda: page.inner_text("#cue-text") == first.text, "words of the first press")
    page.wait_for_selector("#cue[data-look=lift]", timeout=300e3)
    folder = shots(project_root)
    page.screenshot(path=str(folder / "calibration_lift.png"))
    until(lambda: "Calibrated:" in page.inner_text("#cue-text"), "result", 600.0)
    said = page.inner_text("#cue-text")
    assert "lengths from width 15.5 mm, depth 11.2 mm" in said
    assert f"{len(PRESS_BY_NAME)} of {len(PRESS_BY_NAME)} trials kept" in said
    for width, height in ((1366, 768), (390, 844)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(300)
        page.screenshot(path=str(folder / f"calibrated_{width}.png"))
        assert page.evaluate(OVERFLOW) == []
    assert violations(page) == []

    saved = ParameterSets.load(subjects / "S01.yaml")
    assert saved.prior != ParameterSets.default().prior
    assert saved.geometry is not None
    assert saved.geometry.pad_semi_axis_radial == pytest.approx(0.00775)
    page.set_viewport_size({"width": 1366, "height": 768})
    page.keyboard.press("Space")
    until(lambda: page.inner_text("#cue-word") == "No session", "end of the session")
    assert errors == []
    participant.close()
