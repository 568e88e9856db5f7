"""Moisture readings.

`open_source(settings)` makes a driver from checked parameters (`SOURCE_TABLE`). Nothing is opened before its
`connect` is called.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from finger_common.diagnostics import Health
from finger_common.errors import InputError
from finger_common.parameters import Parameter, ParameterTable

from ..protocols.lines import DEFAULT_PATTERN
from .source import MoistureSource, Reading

__all__ = ["SOURCE_TABLE", "MoistureSource", "Reading", "open_source"]

SOURCE_TABLE = ParameterTable(
    Parameter(
        "device",
        "manual",
        "Where readings come from: entered by the operator, a serial adapter, an export file that is watched.",
        choices=("manual", "serial", "export"),
    ),
    Parameter("path", "", "serial: the port. export: the file (CSV or XLSX)."),
    Parameter(
        "serial_baud_rate", 9600, "Baud rate of the port.", unit="Bd", minimum=50, maximum=4_000_000
    ),
    Parameter(
        "serial_pattern",
        DEFAULT_PATTERN,
        "Regular expression a whole line must match, with a group value and perhaps a group phase.",
    ),
    Parameter("export_value_column", "value", "export: heading of the readings' column."),
    Parameter(
        "export_time_column",
        "",
        "export: heading of the column with the time of the reading; empty for the file's time.",
    ),
    Parameter(
        "export_time_format", "%Y-%m-%d %H:%M:%S", "export: format of that time, local time."
    ),
    Parameter(
        "export_phase_column",
        "",
        "export: heading of a column that says before or after; or empty.",
    ),
    Parameter("export_delimiter", ";", "export: character between the columns of a CSV file."),
    Parameter("export_decimal_comma", True, "export: numbers are written 42,0 instead of 42.0."),
    Parameter("export_encoding", "utf-8-sig", "export: encoding of a CSV file, such as cp1252."),
    Parameter("export_sheet", "", "export: sheet of an XLSX file; empty for the first."),
    Parameter(
        "export_period",
        0.25,
        "export: time between looks; a file is read when two looks find it the same.",
        unit="s",
        minimum=0.02,
        maximum=60.0,
    ),
)
"""Parameters of all moisture drivers."""


def open_source(settings: Mapping[str, Any]) -> MoistureSource:
    """Driver for the settings (keys of SOURCE_TABLE; others are ignored).

    Raises InputError for a setting that cannot be used.
    """
    values = SOURCE_TABLE.check({k: v for k, v in settings.items() if k in SOURCE_TABLE})
    health = Health("moisture")
    if values["device"] != "manual" and not values["path"]:
        raise InputError("parameter 'path' is empty; name the serial port or the export file")
    if values["device"] == "manual":
        from .manual import ManualSource

        return ManualSource(health)
    if values["device"] == "serial":
        from .serial import SerialSource

        return SerialSource(
            values["path"], values["serial_baud_rate"], values["serial_pattern"], health
        )
    from ..protocols.export_table import TableFormat
    from .export import ExportSource

    form = TableFormat(
        **{
            name: values[f"export_{name}"]
            for name in (
                "value_column",
                "time_column",
                "phase_column",
                "delimiter",
                "decimal_comma",
                "encoding",
                "time_format",
                "sheet",
            )
        }
    )
    return ExportSource(values["path"], form, health, values["export_period"])
