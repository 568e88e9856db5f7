# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One contact estimate: the only declaration of its fields.

The compiled core's rows, messages, CDR bytes and CSV columns derive from it.

To add a field:

1. add it here, to ContactEstimate, in the order of the message;
2. add it to src/finger_msgs/msg/ContactState.msg and to the copy in
   src/finger_bag/finger_bag/data/finger_msgs;
3. fill it in `stream.process` (only `parameter_set` is filled outside the compiled core);
4. for a CSV and Parquet column, give its Field a `column` and add its name to CSV_FIELDS, which has
   the order of the columns;
5. write the node reference again: `make reference`.

A column that derives from other fields and is in no message belongs to
finger_offline/contact_states.py, as `time_s` does: its name to COLUMNS, its values to `columns`,
its type to the schema of `_open_parquet`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, NamedTuple, get_type_hints

import numpy as np


@dataclass(frozen=True)
class Field:
    """What is known of a field of ContactEstimate.

    type: as in ContactState.msg; unit: SI; column: name in the CSV file, empty for none; scale:
    from the unit to that of the column; message: place in ContactState where it is not the field's
    own name.
    """

    type: str
    unit: str = ""
    column: str = ""
    scale: float = 1.0
    message: str = ""
    name: str = ""


class ContactEstimate(NamedTuple):
    """State of the contact at one wrench sample: the fields of ContactState, in its order.

    Values that are not known are NaN; `onset_ns` is 0 before the first contact.
    """

    stamp_ns: Annotated[int, Field("time", "ns", "stamp_ns", message="header.stamp")]
    normal_force: Annotated[float, Field("float64", "N", "force_n")]
    lateral_force: Annotated[float, Field("float64", "N", "lateral_force_n")]
    in_contact: Annotated[bool, Field("bool", "", "in_contact")]
    onset_ns: Annotated[int, Field("time", "ns", message="onset")]
    model_area: Annotated[float, Field("float64", "m²", "model_area_mm2", 1e6)]
    measured_area: Annotated[float, Field("float64", "m²", "measured_area_mm2", 1e6)]
    measured_area_age: Annotated[float, Field("float64", "s", "measured_area_age_s")]
    area: Annotated[float, Field("float64", "m²", "area_mm2", 1e6)]
    area_stddev: Annotated[float, Field("float64", "m²", "area_sd_mm2", 1e6)]
    area_force_slope: Annotated[float, Field("float64", "m²/N", "area_force_slope_mm2_per_n", 1e6)]
    radius: Annotated[float, Field("float64", "m", "radius_mm", 1e3)]
    indentation: Annotated[float, Field("float64", "m", "indentation_mm", 1e3)]
    mean_pressure: Annotated[float, Field("float64", "Pa", "mean_pressure_kpa", 1e-3)]
    peak_pressure: Annotated[float, Field("float64", "Pa", "peak_pressure_kpa", 1e-3)]
    moisture: Annotated[float, Field("float64", "a.u.", "moisture_au")]
    moisture_age: Annotated[float, Field("float64", "s")]
    parameter_set: Annotated[str, Field("string", "", "parameter_set")]
    flags: Annotated[int, Field("uint32", "", "flags")]
    radius_stddev: Annotated[float, Field("float64", "m", "radius_sd_mm", 1e3)]
    indentation_stddev: Annotated[float, Field("float64", "m", "indentation_sd_mm", 1e3)]
    mean_pressure_stddev: Annotated[float, Field("float64", "Pa", "mean_pressure_sd_kpa", 1e-3)]
    peak_pressure_stddev: Annotated[float, Field("float64", "Pa", "peak_pressure_sd_kpa", 1e-3)]


def _described() -> Iterator[Field]:
    for name, hint in get_type_hints(ContactEstimate, include_extras=True).items():
        field: Field = hint.__metadata__[0]
        yield Field(**{**vars(field), "name": name, "message": field.message or name})


ESTIMATE_FIELDS = tuple(_described())
"""The fields of ContactEstimate, in the order of ContactState.msg."""

CSV_FIELDS = (
    "normal_force",
    "area",
    "radius",
    "indentation",
    "peak_pressure",
    "mean_pressure",
    "area_stddev",
    "model_area",
    "measured_area",
    "measured_area_age",
    "area_force_slope",
    "lateral_force",
    "moisture",
    "in_contact",
    "flags",
    "stamp_ns",
    "parameter_set",
    "radius_stddev",
    "indentation_stddev",
    "mean_pressure_stddev",
    "peak_pressure_stddev",
)
"""Order of the CSV columns, after `time_s`. The first five are those of `finger-model simulate`."""

NAME_LENGTH = 24
"""Characters of `parameter_set`; InterpolatedParameters.name has 15 at most."""

_NUMPY_TYPES = {
    "time": "i8",
    "float64": "f8",
    "bool": "?",
    "string": f"U{NAME_LENGTH}",
    "uint32": "u4",
}

ESTIMATE_DTYPE = np.dtype([(f.name, _NUMPY_TYPES[f.type]) for f in ESTIMATE_FIELDS], align=True)
"""Row of an EstimateBlock."""


@dataclass
class EstimateBlock:
    """Estimates of n samples: rows (n,) of ESTIMATE_DTYPE."""

    rows: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[ContactEstimate]:
        return map(ContactEstimate._make, self.rows.tolist())

    def column(self, name: str) -> np.ndarray:
        """One field of ContactEstimate (n,)."""
        return self.rows[name]
