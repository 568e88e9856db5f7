# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Node `simulated_rig`: announces the current trial to the simulated participant.

Node around `rig.SimulatedRig`. It publishes nothing: what it measures leaves through the
simulated devices alone.
"""

from __future__ import annotations

from typing import Any

from finger_common.node import LATCHED_QOS, ManagedNode, main_of
from finger_msgs.msg import Trial

from .rig import RIG_READY, SimulatedRig
from .rig_settings import RigSettings


class RigNode(ManagedNode):
    """The simulated rig as a process of the suite."""

    NAME = "simulated_rig"
    SETTINGS = (RigSettings,)

    def configure(self) -> None:
        log = self.get_logger().info
        self._rig = SimulatedRig(self.settings(RigSettings), log, self.get_namespace())
        self.closing.callback(self._rig.stop)
        self._rig.start()
        addresses = self._rig.addresses
        log(
            f"devices: CAN udp_multicast {addresses.can_channel}, port={addresses.can_port}; "
            f"images {addresses.spool}; moisture probe {addresses.probe}; "
            f"plate calibration {addresses.calibration}"
        )

    def activate(self) -> None:
        self._subscription = self.create_subscription(Trial, "trial", self._on_trial, LATCHED_QOS)
        self.get_logger().info(f"{RIG_READY} in {self._rig.addresses.folder}")

    def parameters_changed(self, changes: dict[str, Any]) -> None:
        if "faults" in changes:
            self._rig.show_faults(RigSettings.select({**self.values, **changes}))

    def deactivate(self) -> None:
        self.destroy_subscription(self._subscription)

    def _on_trial(self, message: Trial) -> None:
        self._rig.announce(message.condition, message.index, message.attempt, message.phase)


main = main_of(RigNode)

if __name__ == "__main__":
    main()
