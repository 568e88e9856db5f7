"""Force and torque sensors.

`open_source(settings)` makes a driver from checked parameters (`SOURCE_TABLE`). Nothing is opened before its
`connect` is called.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from finger_common.diagnostics import Health
from finger_common.parameters import Parameter, ParameterTable

from .source import CRITICAL, GOOD, SATURATED, ForceSource, WrenchSample

__all__ = [
    "CRITICAL",
    "GOOD",
    "SATURATED",
    "SOURCE_TABLE",
    "ForceSource",
    "WrenchSample",
    "open_source",
]

CAN_PARAMETERS = (
    Parameter(
        "can_interface",
        "socketcan",
        "python-can interface the sensor hangs on: socketcan, pcan, slcan, socketcand, udp_multicast, virtual, …",
    ),
    Parameter(
        "can_channel",
        "",
        "Channel of that interface; empty for its usual one (socketcan: can0).",
    ),
    Parameter(
        "can_bitrate",
        0,
        "Bit rate; 0 leaves it as set, as socketcan needs.",
        unit="bit/s",
        minimum=0,
        maximum=1_000_000,
    ),
    Parameter("can_options", "", "Further options of the interface, key=value,key=value."),
)

SOURCE_TABLE = ParameterTable(
    Parameter(
        "device",
        "netcanoem",
        "Kind of sensor: ATI NETCANOEM on CAN, ATI Net F/T on Ethernet, or any CAN sensor a DBC file describes.",
        choices=("netcanoem", "netft", "dbc"),
    ),
    Parameter(
        "rate",
        500.0,
        "Samples per second: polled (netcanoem), asked for (netft, dbc).",
        unit="Hz",
        minimum=1.0,
        maximum=7000.0,
        advice="A CAN bus of 250 kbit/s carries at most about 800 readings of a NETCANOEM per second.",
    ),
    *CAN_PARAMETERS,
    Parameter(
        "base_identifier",
        0x20,
        "NETCANOEM: base identifier (0x20 with DIP switch SW2-1 on).",
        minimum=0,
        maximum=127,
    ),
    Parameter(
        "calibration_slot",
        0,
        "NETCANOEM: calibration to use; the board itself always starts with 0.",
        minimum=0,
        maximum=15,
    ),
    Parameter(
        "expected_serial",
        "",
        "Serial number the sensor must have; empty accepts any.",
    ),
    Parameter(
        "response_timeout",
        0.05,
        "NETCANOEM: time for a reply after which a poll counts as lost.",
        unit="s",
        minimum=0.001,
        maximum=1.0,
        advice="Long enough for a busy computer's pauses; shorter loses less time after a lost reply.",
    ),
    Parameter(
        "calibration_check_period",
        1.0,
        "NETCANOEM: how often one row of the matrix is read again, to notice a board that was reset.",
        unit="s",
        minimum=0.05,
        maximum=3600.0,
    ),
    Parameter("netft_host", "192.168.1.1", "Net F/T: address of the box (ATI's default)."),
    Parameter("netft_port", 49152, "Net F/T: UDP port of RDT.", minimum=1, maximum=65535),
    Parameter("netft_http_port", 80, "Net F/T: port of its web pages.", minimum=1, maximum=65535),
    Parameter(
        "netft_set_rate",
        False,
        "Net F/T: write `rate` into the box (comm.cgi) before the stream starts.",
    ),
    Parameter(
        "dbc_mapping",
        "",
        "dbc: YAML file that maps a DBC file's signals; empty for the shipped Robotous RFT.",
    ),
)
"""Parameters of all force drivers."""


def open_source(settings: Mapping[str, Any]) -> ForceSource:
    """Driver for the settings (keys of SOURCE_TABLE; others are ignored).

    Raises InputError for a setting that cannot be used.
    """
    values = SOURCE_TABLE.check({k: v for k, v in settings.items() if k in SOURCE_TABLE})
    health = Health("force", expected_rate=values["rate"], stale_after=0.5)
    can_arguments = {
        "interface": values["can_interface"],
        "channel": values["can_channel"],
        "bitrate": values["can_bitrate"],
        "options": values["can_options"],
    }
    # Imported where chosen: a rig with one sensor needs only that one's libraries.
    if values["device"] == "netcanoem":
        from .netcanoem import NetcanoemSource

        return NetcanoemSource(
            can_arguments,
            base=values["base_identifier"],
            slot=values["calibration_slot"],
            rate=values["rate"],
            response_timeout=values["response_timeout"],
            calibration_check_period=values["calibration_check_period"],
            expected_serial=values["expected_serial"],
            health=health,
        )
    if values["device"] == "netft":
        from .netft import NetFtSource

        return NetFtSource(
            values["netft_host"],
            values["rate"],
            values["netft_port"],
            values["netft_http_port"],
            values["netft_set_rate"],
            health=health,
        )
    from ..protocols.dbc import SensorMapping
    from .dbc import SHIPPED, DbcSource

    mapping = SensorMapping.load(values["dbc_mapping"] or SHIPPED)
    return DbcSource(can_arguments, mapping, values["rate"], health=health)
