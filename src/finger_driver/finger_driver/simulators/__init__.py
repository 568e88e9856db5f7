"""Wire-level simulators of the devices.

Each serves the device's own protocol, is fed values from outside and knows no finger. Inside a process:

    bus = can_bus.open_bus("udp_multicast", options={"port": 43210})
    force = NetcanoemSimulator(bus, force=lambda stamp_ns: wrench6).start()   # answers polls until .stop()
    force.faults.set("silent", -1)            # n > 0: the next n times; -1: until .faults.clear() or set(…, 0)

    probe = SerialMoistureSimulator(link="run/moisture")    # a pty; the driver opens probe.port
    probe.send(42.0, "before")

    camera = FrameFolderWriter("run/frames", keep=50)       # the driver: device "folder", path "run/frames"
    camera.write(stamp_ns, image)                           # (H, W) uint8, acquisition stamp in ns since the epoch

The drivers' parameters that fit these: `force_node` can_interface=udp_multicast, can_options="port=43210";
`camera_node` device=folder, path=run/frames; `moisture_node` device=serial, path=run/moisture.

From the command line, in a process of its own: `finger-device-sim netcanoem|rdt|rft|serial|export|images --help`.
Faults are switched by lines on its standard input, such as `silent -1`, `silent 0`, `clear`.
"""

from .export import ExportFileSimulator
from .faults import Faults
from .images import FrameFolderWriter
from .netcanoem import NetcanoemSimulator
from .netft import NetFtSimulator
from .rft import RftSimulator
from .serial_moisture import SerialMoistureSimulator

__all__ = [
    "ExportFileSimulator",
    "Faults",
    "FrameFolderWriter",
    "NetFtSimulator",
    "NetcanoemSimulator",
    "RftSimulator",
    "SerialMoistureSimulator",
]
