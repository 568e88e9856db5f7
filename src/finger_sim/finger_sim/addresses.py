# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where the devices of a simulated rig are found.

Imports no finger model, so that commands start soon.
"""

from __future__ import annotations

import errno
import secrets
import socket
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from finger_common.errors import InputError
from finger_common.folder_lock import lock_folder
from finger_driver import can_bus

CAN_CHANNEL = can_bus.DEFAULT_CHANNEL["udp_multicast"]
"""Multicast group of the simulated CAN bus."""


@dataclass(frozen=True)
class RigAddresses:
    """Folder of the rig, multicast group and port of its CAN bus."""

    folder: Path
    can_port: int = can_bus.DEFAULT_PORT
    can_channel: str = CAN_CHANNEL

    @classmethod
    def private(cls, folder: Path) -> RigAddresses:
        """Addresses that no other rig on this machine uses: own port, own group."""
        while True:
            # Neither a port that the system gives to any socket (from 32768 on), which a node could
            # have got before the bus opens, nor one of a ROS domain (the first half of each 250).
            port = 7600 + 250 * secrets.randbelow(100) + secrets.randbelow(50)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
                probe.bind(("", port))
                break
        group = ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
        return cls(folder, port, f"239.{group}")

    def lock(self) -> ExitStack:
        """Lock folder and CAN bus until closed; raises InputError where another rig has them."""
        locks = ExitStack()
        try:
            locks.enter_context(lock_folder(self.folder, "a simulated rig"))
            locks.enter_context(self._lock_bus())
        except InputError as error:
            locks.close()
            raise InputError(f"{error}, or another can_port") from None
        return locks

    def _lock_bus(self) -> socket.socket:
        """Lock the CAN bus against every user of this computer until the socket is closed.

        The name is in the kernel (unix(7), abstract); a file would stay, and its owner's alone. On
        other systems than Linux the bus is not guarded.
        """
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            lock.bind(f"\0finger_can_{self.can_channel}_{self.can_port}")
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                lock.close()
                raise InputError(
                    f"CAN bus {self.can_channel}:{self.can_port}: in use by a simulated rig on "
                    "this computer; end it, or choose another can_channel"
                ) from None
        return lock

    @property
    def spool(self) -> Path:
        """Folder in which frames appear."""
        return self.folder / "spool"

    @property
    def probe(self) -> Path:
        """Serial device of the moisture probe (a link to a pseudo-terminal)."""
        return self.folder / "moisture_probe"

    @property
    def calibration(self) -> Path:
        """Plate calibration of the simulated camera, without error."""
        return self.folder / "plate_calibration.yaml"

    @property
    def truth(self) -> Path:
        """Folder of the true contacts."""
        return self.folder / "truth"

    @property
    def planned(self) -> Path:
        """Folder of the frames of planned trials."""
        return self.folder / "planned"

    def parameters(self) -> dict[str, Any]:
        """As parameters of the rig's node."""
        return {
            "folder": str(self.folder),
            "can_port": self.can_port,
            "can_channel": self.can_channel,
        }
