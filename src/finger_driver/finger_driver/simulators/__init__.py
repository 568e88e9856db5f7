# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Wire-level simulators of the devices.

Each serves the device's own protocol, is given values from outside and knows no finger. In Python:

    bus = can_bus.open_bus("udp_multicast", options={"port": 43210})
    force = NetcanoemSimulator(bus, force=lambda stamp_ns: wrench6).start()   # until .stop()
    force.faults.set("silent", -1)   # n > 0: the next n times; -1: until clear() or set(…, 0)

    probe = SerialMoistureSimulator(link="run/moisture")    # a pty; the driver opens probe.port
    probe.send(42.0, "before")

    camera = FrameFolderWriter("run/frames", keep=50)   # driver: device "folder", path "run/frames"
    camera.write(stamp_ns, image)                       # (H, W) uint8, stamp in ns since the epoch

The drivers' parameters that fit these: `force_node` can_interface=udp_multicast,
can_options="port=43210"; `camera_node` device=folder, path=run/frames; `moisture_node`
device=serial, path=run/moisture.

From the command line, each in a process of its own: `finger-device-sim --help`. Faults are switched
by lines on its standard input, such as `silent -1`, `silent 0`, `clear`.
"""

from .images import FrameFolderWriter
from .netcanoem import NetcanoemSimulator
from .serial_moisture import SerialMoistureSimulator
from .simulator import Simulator
from .values import LoadOptions

__all__ = [
    "FrameFolderWriter",
    "LoadOptions",
    "NetcanoemSimulator",
    "SerialMoistureSimulator",
    "Simulator",
]
