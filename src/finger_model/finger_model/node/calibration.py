# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The model node's part for the calibration of a subject: follows the announcements of trials,
keeps the presses, has them fitted in a thread of its own and publishes what became of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR, OK, WARN
from finger_common.errors import FingerError
from finger_common.node import STATE_QOS, ManagedNode
from finger_common.parameter_values import parameter_values
from finger_common.subject_code import known_finger
from finger_msgs.msg import SessionStatus, Trial

from ..anthropometry import GeometryEstimate, session_estimate
from ..calibration import Calibration, CalibrationPress
from ..parameter_sets import ParameterSets
from ..subject_calibration import PressCollector, keep_subject, why_refused

Fit = Callable[
    [ParameterSets, list[CalibrationPress], "float | None", "GeometryEstimate | None"], Calibration
]
"""Of sets in use, presses, moisture (a.u.) and what calipers told of the finger."""
Use = Callable[[str, str, ParameterSets], None]
"""Takes the parameters of a subject's finger live."""


class LiveCalibration:
    """Calibrates the subjects of one model node.

    The node holds its lock when it calls `hear`, not when it calls `wait`. fit, use: called in the
    thread of the fit, without the lock.
    """

    def __init__(self, node: ManagedNode, fit: Fit, use: Use) -> None:
        self.collector = PressCollector()
        self._node = node
        self._fit = fit
        self._use = use
        self._thread: threading.Thread | None = None
        self._plan: Any = None

    def open(self) -> None:
        """Connect; what is made here ends with the node's cleanup."""
        self._protocol = self._node.create_polled_subscription(
            SessionStatus, "protocol/status", STATE_QOS, overridable=False
        )
        self._publisher = self._node.create_publisher(DiagnosticStatus, "calibration", STATE_QOS)

    def forget(self) -> None:
        """Begin without presses."""
        self.collector = PressCollector()

    def wait(self) -> None:
        """Until no fit is under way."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def hear(self, message: Trial, sets: ParameterSets) -> None:
        """One announcement, of which a fit may begin with these sets."""
        folder = self._node.values["subjects_folder"]
        if self.collector.begins(message.session, message.condition):
            # Before somebody presses for it in vain.
            reason = why_refused(message.index, message.phase, message.note, folder)
            if reason:
                self._refuse(message, reason)
        of_trial = message.session, message.condition, message.index, message.attempt
        if not self.collector.announce(*of_trial, message.phase):
            return
        if self._thread is not None and self._thread.is_alive():
            self._refuse(message, "the one before is still being computed")
            return
        arguments = message, sets, self.collector.presses(), self.collector.moisture(), folder
        self._thread = threading.Thread(
            target=self._calibrate, args=arguments, name="calibration", daemon=True
        )
        self._thread.start()

    def _calibrate(
        self,
        message: Trial,
        sets: ParameterSets,
        presses: list[CalibrationPress],
        moisture: float | None,
        folder: str,
    ) -> None:
        """Fit the presses, take the result live and save it; in a thread of its own."""
        began, subject = time.monotonic(), message.subject
        finger = known_finger(message.header.frame_id)
        try:
            found = self._fit(sets, presses, moisture, self._calipers_of(message.session))
            taken = time.monotonic() - began
            self._use(subject, finger, found.sets)
            answer = keep_subject(folder, subject, finger, found, taken)
        except Exception as error:
            reason = one_line(error) if isinstance(error, FingerError) else repr(error)
            self._refuse(message, reason)
            return
        told = f"{answer.sentence}; {answer.place}"
        self._node.get_logger().info(f"subject {subject} calibrated: {told}")
        self._tell(message, OK if answer.kept else WARN, answer.message, answer.values)

    def _calipers_of(self, session: str) -> GeometryEstimate | None:
        """What calipers told of the finger of a session, as the protocol node's status has it."""
        for message in self._protocol.messages():
            self._plan = message
        if self._plan is None or self._plan.session != session:
            return None
        return session_estimate(parameter_values(self._plan.plan))

    def _refuse(self, message: Trial, reason: str) -> None:
        self._node.get_logger().error(f"subject {message.subject} not calibrated: {reason}")
        self._tell(message, ERROR, reason, {})

    def _tell(self, message: Trial, level: int, text: str, values: dict[str, str]) -> None:
        """Publish what became of the calibration that a trial belongs to."""
        status = DiagnosticStatus(level=bytes([level]), name=message.subject, message=text)
        status.hardware_id = message.session
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        if rclpy.ok(context=self._node.context):
            self._publisher.publish(status)
