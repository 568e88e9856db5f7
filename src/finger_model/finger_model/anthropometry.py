# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""From a person's fingertip, measured with calipers, to the lengths of the model.

The rules are simple proportions. Each length has a standard deviation: of the calipers, and of
what the calipers cannot see. Sources are named where a number is printed somewhere; the rest are
assumptions and say so. docs/your_finger.md has the drawing and the reasons.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from finger_common.errors import InputError
from finger_common.units import LENGTH_UNITS

from .geometry import DEVIATIONS, LENGTHS, Geometry

CALIPER_DEVIATION = 0.3e-3
"""m, standard deviation of one caliper reading on soft tissue; an assumption."""

RANGES = {
    "width": (8e-3, 30e-3),
    "depth": (5e-3, 25e-3),
    "length": (8e-3, 45e-3),
    "nail_width": (4e-3, 25e-3),
}
"""m, accepted readings; beyond them a wrong unit is likelier than a finger."""


@dataclass(frozen=True)
class TypicalFinger:
    """Width and depth of an adult's fingertip in m, with the width's deviation between people."""

    width: float
    depth: float
    width_deviation: float


FINGERS = {
    "thumb": TypicalFinger(20.5e-3, 12.3e-3, 2.0e-3),
    "index": TypicalFinger(17.0e-3, 11.0e-3, 1.5e-3),
    "middle": TypicalFinger(17.4e-3, 11.3e-3, 1.5e-3),
    "ring": TypicalFinger(16.3e-3, 10.6e-3, 1.5e-3),
    "little": TypicalFinger(14.4e-3, 9.4e-3, 1.4e-3),
}
"""Fingertips of adults. Index: the default geometry, within the 16–20 mm of Dandekar, Raju and
Srinivasan 2003. The others over the index: assumptions in the order of hand anthropometry."""

LENGTH_OVER_WIDTH = 1.5
"""Of a typical distal finger segment, crease to tip over width; an assumption."""
LENGTH_RANGE = (1.1, 2.2)
"""Length over width of fingertips; beyond it another length was measured. An assumption."""
UNKNOWN_LENGTH = 0.05
"""Relative deviation of the radial semi-axis of a finger whose length was not measured."""
KNOWN_LENGTH = 0.03
"""The same when it was: an ellipse is still not a circle."""
PAD_SHAPE = 0.08
"""Relative deviation of the pad's height: where the section is widest, no caliper says."""
UNKNOWN_DEPTH = 0.12
"""Relative deviation of the depth of a finger whose depth was not measured."""
EPIDERMIS = 0.30e-3
"""m, stratum corneum of a finger pad (Adams et al. 2013, J. R. Soc. Interface 10, 20120467,
fig. 1)."""
GROWN_UP = 16.0
"""Age in years until which fingers are taken to grow."""
EPIDERMIS_DEVIATION = 0.08e-3
"""m, between people; the epidermis of palms has 0.05 mm, the rest is an assumption."""
BONE_WIDTH = 4.0 / 8.5
BONE_WIDTH_DEVIATION = 0.12
"""Bone over pad, radial. A tuft of 7 mm (Mintalucci et al. 2014, J. Hand Surg. 39, 1068) in a
finger of 15–16 mm gives 0.45; 0.47 is an assumption near it."""
BONE_HEIGHT = 2.5 / 5.5
BONE_HEIGHT_DEVIATION = 0.20
"""Bone over pad, axial; an assumption."""
BONE_CENTER_DEVIATION = 0.3e-3
NAIL_WIDTH = 7.0 / 8.5
NAIL_WIDTH_DEVIATION = 0.10
"""Nail over pad; an assumption."""
NAIL_THICKNESS = 0.5e-3
NAIL_THICKNESS_DEVIATION = 0.1e-3
"""m; 0.5 mm of women, 0.6 mm of men (Elements of Morphology, without a study behind it)."""


class Length(NamedTuple):
    """A length of the model (m), its standard deviation (m), and the rule that gave both."""

    value: float
    deviation: float
    rule: str


@dataclass(frozen=True)
class GeometryEstimate:
    """A geometry and what is known of it.

    lengths: value, standard deviation and rule of every length of `geometry`, by its key.
    measured: the readings that it comes from, in words.
    """

    geometry: Geometry
    lengths: dict[str, Length]
    measured: str

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation (m) of every length, by its key."""
        return {key: length.deviation for key, length in self.lengths.items()}

    def yaml_text(self) -> str:
        """The file `geometry.yaml`: lengths, with deviation and rule in a comment, and the
        deviations."""
        lines = [
            "# Lengths of one finger in m, for finger-model; ± is one standard deviation.",
            f"# From {self.measured}. Rules and drawing: docs/your_finger.md",
        ]
        for key, value in self.geometry.to_dict().items():
            known = self.lengths[key]
            lines.append(f"{key}: {value:.6g}  # ± {known.deviation:.2g}; {known.rule}")
        lines.append(f"{DEVIATIONS}:  # the same standard deviations, as finger-fit takes them")
        lines += [f"  {key}: {deviation:.2g}" for key, deviation in self.deviations.items()]
        return "\n".join(lines) + "\n"


def parse_length(text: str, what: str) -> float:
    """A length in m from text such as 14mm, 1.4 cm, 0.014 m or 0.014 (metres).

    Raises InputError for other text, and for a plain number that cannot be metres.
    """
    match = re.fullmatch(r"\s*(\d+(?:[.,]\d*)?|[.,]\d+)\s*([A-Za-zµ]*)\s*", text)
    if match is None:
        raise InputError(f"{what} is {text!r}; give a length such as 14mm")
    value, unit = float(match[1].replace(",", ".")), match[2].lower()
    if unit and unit not in LENGTH_UNITS:
        raise InputError(f"{what} is {text!r}, with the unit {match[2]!r}; use mm, cm or m")
    if not unit and value >= 0.1:
        raise InputError(f"{what} is {text!r} without a unit: is it {value:g}mm? Write the unit")
    return value * LENGTH_UNITS[unit or "m"]


def _said(name: str, value: float) -> str:
    """A reading in words; raises InputError for one that no fingertip has."""
    low, high = RANGES[name]
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(
            f"{name.replace('_', ' ')} {value * 1e3:g} mm is outside {low * 1e3:g} … "
            f"{high * 1e3:g} mm, the range of fingertips; check the number and its unit"
        )
    return f"{name.replace('_', ' ')} {value * 1e3:g} mm"


def epidermis_of_age(age: float) -> float:
    """Typical thickness (m) at an age in years.

    Skin thins with age (Gambichler et al. 2006, J. Dermatol. Sci. 44, 145; Czekalla et al. 2019),
    and grows until 16. How much at the fingertip is not printed: 0.3 % a year after 40, 15 % less
    at birth, are assumptions. Raises InputError for an age outside 1 … 120.
    """
    if not 1 <= age <= 120:
        raise InputError(f"age {age:g} is outside 1 … 120 years")
    if age < GROWN_UP:
        return EPIDERMIS * (0.85 + 0.15 * age / GROWN_UP)
    return EPIDERMIS * max(1.0 - 0.003 * max(age - 40.0, 0.0), 0.84)


def estimate_geometry(
    width: float | None = None,
    depth: float | None = None,
    length: float | None = None,
    nail_width: float | None = None,
    finger: str | None = None,
    age: float | None = None,
) -> GeometryEstimate:
    """The model's lengths of a fingertip, from readings in m.

    width, depth: across the pad and from pad to nail, at the middle of the nail; length: from the
    last crease to the tip; nail_width; finger: a name of FINGERS, whose typical width and depth
    stand in for readings left out (default: index); age in years. Raises InputError for readings
    that no fingertip has, for an unknown finger, and without width and finger.
    """
    if finger is not None and finger not in FINGERS:
        raise InputError(f"no finger '{finger}'; the fingers are {', '.join(FINGERS)}")
    if width is None and finger is None:
        raise InputError(
            "give the width of the fingertip (--width 14mm), or --finger for a typical one"
        )
    if width is None and age is not None and age < GROWN_UP:
        raise InputError(
            f"a typical finger is that of an adult; at the age of {age:g} give the width (--width)"
        )
    measured = f"a typical adult {finger} finger" if width is None else _said("width", width)
    typical = FINGERS[finger or "index"]
    width_deviation = typical.width_deviation if width is None else CALIPER_DEVIATION
    width = typical.width if width is None else width
    for name, reading in (("length", length), ("depth", depth), ("nail_width", nail_width)):
        if reading is not None:
            measured += f", {_said(name, reading)}"
    if age is not None:
        measured += f", age {age:g}"
    radial = _radial(width, width_deviation, length)
    axial = _axial(width, width_deviation, depth, finger or "index")
    lengths = {
        "pad_semi_axis_radial": radial,
        "pad_semi_axis_axial": axial,
        "epidermis_thickness": _epidermis(age),
        "bone_semi_axis_radial": _share(
            radial, BONE_WIDTH, BONE_WIDTH_DEVIATION, "tuft: Mintalucci 2014"
        ),
        "bone_semi_axis_axial": _share(axial, BONE_HEIGHT, BONE_HEIGHT_DEVIATION),
        "bone_center_height": Length(0.0, BONE_CENTER_DEVIATION, "an assumption"),
        "nail_radius": _nail(radial.value, width, nail_width),
        "nail_thickness": Length(NAIL_THICKNESS, NAIL_THICKNESS_DEVIATION, "an assumption"),
    }
    assert set(lengths) == set(LENGTHS)
    geometry = Geometry(**{key: round(length.value, 8) for key, length in lengths.items()})
    return GeometryEstimate(geometry, lengths, measured)


def _radial(width: float, width_deviation: float, length: float | None) -> Length:
    """Semi-axis of a pad that is as round, from above, as the finger's width and length are."""
    radial, ratio, rule = 0.5 * width, UNKNOWN_LENGTH, "half the width"
    if length is not None:
        low, high = LENGTH_RANGE
        if not low <= length / width <= high:
            raise InputError(
                f"length {length * 1e3:g} mm is {length / width:.2f} of the width of "
                f"{width * 1e3:g} mm; in fingertips it is {low:g} to {high:g} of it, from the last "
                "crease to the tip: check both"
            )
        radial *= math.sqrt(length / (LENGTH_OVER_WIDTH * width))
        ratio = KNOWN_LENGTH
        rule = f"half the width, times the root of length over {LENGTH_OVER_WIDTH:g} widths"
    return Length(radial, math.hypot(0.5 * width_deviation, ratio * radial), rule)


def _axial(width: float, width_deviation: float, depth: float | None, finger: str) -> Length:
    """Height of the pad: half the finger's depth."""
    rule, deviation = "half the depth", CALIPER_DEVIATION
    if depth is None:
        depth = width * FINGERS[finger].depth / FINGERS[finger].width
        deviation = depth * math.hypot(UNKNOWN_DEPTH, width_deviation / width)
        rule += f", of a typical {finger} finger of this width"
    elif depth > width + CALIPER_DEVIATION:
        raise InputError(
            f"depth {depth * 1e3:g} mm is larger than width {width * 1e3:g} mm; fingertips are "
            "wider than deep: check whether the two are exchanged"
        )
    axial = 0.5 * depth
    return Length(axial, math.hypot(0.5 * deviation, PAD_SHAPE * axial), rule)


def _epidermis(age: float | None) -> Length:
    rule = "stratum corneum of a finger pad (Adams 2013)"
    if age is None:
        return Length(EPIDERMIS, EPIDERMIS_DEVIATION, rule)
    return Length(epidermis_of_age(age), EPIDERMIS_DEVIATION, f"{rule}, at the age of {age:g}")


def _share(pad: Length, share: float, deviation: float, source: str = "") -> Length:
    """A length that is a share of the pad's; deviation: of the share, relative."""
    rule = f"{share:.2f} of the pad" + (f" ({source})" if source else ", an assumption")
    spread = share * math.hypot(deviation * pad.value, pad.deviation)
    return Length(share * pad.value, spread, rule)


def _nail(radial: float, width: float, nail_width: float | None) -> Length:
    """Half the nail's width; it keeps its share of the finger's width where length changes
    `radial`."""
    if nail_width is None:
        nail = NAIL_WIDTH * radial
        rule = f"{NAIL_WIDTH:.2f} of the pad, an assumption"
        return Length(nail, NAIL_WIDTH_DEVIATION * NAIL_WIDTH * radial, rule)
    if nail_width > width:
        raise InputError(
            f"nail width {nail_width * 1e3:g} mm is larger than the width of the finger, "
            f"{width * 1e3:g} mm; check both"
        )
    nail = radial * nail_width / width
    deviation = math.hypot(0.5 * CALIPER_DEVIATION, 0.03 * nail)
    return Length(nail, deviation, "half the nail's width, as a share of the finger's")


def session_geometry(plan: Mapping[str, Any]) -> str | None:
    """`geometry.yaml` of a guided session's subject; None and InputError as `session_estimate`."""
    found = session_estimate(plan)
    return None if found is None else found.yaml_text()


def session_estimate(plan: Mapping[str, Any]) -> GeometryEstimate | None:
    """Lengths of a guided session's subject; None where no calipers were used.

    plan: as in session.json; `finger_width` and `finger_depth` (m), `finger` and `age` are used,
    0 and "" for what was not noted. Raises InputError as `estimate_geometry` does, and for a depth
    without width.
    """
    width, depth = (plan.get(key) or None for key in ("finger_width", "finger_depth"))
    if width is None and depth is None:
        return None
    if width is None:
        raise InputError("the fingertip has a depth but no width; enter the width too, or neither")
    finger, age = (plan.get(key) or None for key in ("finger", "age"))
    return estimate_geometry(width, depth, finger=finger, age=age)
