# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The Net F/T's configuration page `netftapi2.xml`.

Source: ATI 9610-05-Ethernet Axia, section 11; element names as read by public drivers. Counts per
unit are *not* always 10⁶: a real box gives 1 in lbf and 1 000 000 in N, so they are read, never
assumed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from xml.etree import ElementTree

from finger_common.errors import DeviceError

from . import units

PAGE = "/netftapi2.xml"
MAX_BYTES = 1_000_000

ZERO = (
    *("setcfgsel", "cfgcalsel", "cfgcalsn"),
    *("cfgtfx", "scfgtdu", "scfgtau"),
    "setbias",
)
"""Elements for the active slot, calibration and its serial number; tool transform with its units;
bias. Not every box has all."""


@dataclass(frozen=True)
class Configuration:
    """What the page gives of the box and its active configuration.

    counts_per_force, counts_per_torque: counts per unit. rdt_rate, internal_rate: records and
    internal samples per second, 0 where absent. zero: texts of what else the meaning of a count
    hangs on, in the order of `ZERO`: calibration, tool transform, bias.
    """

    counts_per_force: float
    counts_per_torque: float
    force_unit: str
    torque_unit: str
    product: str = ""
    rdt_enabled: bool = True
    rdt_rate: float = 0.0
    # Perhaps measured: it may change without anybody's doing.
    internal_rate: float = field(default=0.0, compare=False)
    zero: tuple[str, ...] = ("",) * len(ZERO)

    @property
    def serial(self) -> str:
        """Serial number of the transducer's calibration; empty where the page has none."""
        return self.zero[ZERO.index("cfgcalsn")]

    @property
    def force_scale(self) -> float:
        """N per count."""
        return units.force_factor(self.force_unit) / self.counts_per_force

    @property
    def torque_scale(self) -> float:
        """N m per count."""
        return units.torque_factor(self.torque_unit) / self.counts_per_torque


def parse(page: bytes) -> Configuration:
    """Configuration from the page; raises DeviceError naming a missing or wrong element."""
    if len(page) > MAX_BYTES:
        raise DeviceError(f"{PAGE} is larger than {MAX_BYTES} bytes; this is not a Net F/T")
    # A Net F/T sends no entities; nested ones can expand without limit.
    if b"<!" in page.replace(b"<!--", b""):
        raise DeviceError(f"{PAGE} holds declarations that a Net F/T does not send")
    try:
        root = ElementTree.fromstring(page)
        texts = {
            element.tag: (element.text or "").strip()
            for element in root.iter()
            if isinstance(element.tag, str)
        }
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise DeviceError(f"{PAGE} is not readable XML ({error}); is this a Net F/T?") from None
    enabled = texts.get("comrdte", "Enabled").lower() not in ("disabled", "0")
    configuration = Configuration(
        _positive(texts, "cfgcpf"),
        _positive(texts, "cfgcpt"),
        _text(texts, "scfgfu"),
        _text(texts, "scfgtu"),
        texts.get("prodname", "")[:64],
        enabled,
        _rate(texts.get("comrdtrate", "")),
        _rate(texts.get("runrate", "")),
        tuple(texts.get(name, "")[:200] for name in ZERO),
    )
    # Unknown units raise here rather than at the first sample.
    _ = configuration.force_scale, configuration.torque_scale
    return configuration


def _text(texts: dict[str, str], name: str) -> str:
    if not texts.get(name):
        raise DeviceError(f"{PAGE} has no element '{name}'; is this a Net F/T?")
    return texts[name]


def _positive(texts: dict[str, str], name: str) -> float:
    text = _text(texts, name)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise DeviceError(f"{PAGE}: '{name}' is '{text[:20]}', a positive number is needed")
    return value


def _rate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) and value > 0 else 0.0


def render(configuration: Configuration) -> bytes:
    """The page as a box would send it (the elements that drivers read)."""
    root = ElementTree.Element("netft")
    for name, value in (
        ("prodname", configuration.product),
        ("cfgcpf", f"{configuration.counts_per_force:.12g}"),
        ("cfgcpt", f"{configuration.counts_per_torque:.12g}"),
        ("scfgfu", configuration.force_unit),
        ("scfgtu", configuration.torque_unit),
        ("comrdte", "Enabled" if configuration.rdt_enabled else "Disabled"),
        ("comrdtrate", f"{configuration.rdt_rate:g}"),
        ("runrate", f"{configuration.internal_rate:g}"),
        *zip(ZERO, configuration.zero),
    ):
        ElementTree.SubElement(root, name).text = value
    return b'<?xml version="1.0"?>\n' + ElementTree.tostring(root)
