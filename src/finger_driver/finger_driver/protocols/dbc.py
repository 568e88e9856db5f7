# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""CAN sensors described by a DBC file and a mapping of its signals to force and torque.

The mapping is a YAML file; `data/robotous_rft.yaml` is the worked and commented example. Everything
in it is checked when it is loaded, so that a frame can only be right or malformed.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np

from finger_common.errors import DeviceError, InputError
from finger_common.files import load_yaml, read_text

from .. import can_bus

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import cantools

CHANNELS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
_KEYS = frozenset(
    "name database start stop request frames within match channels saturation fault counter".split()
)


@dataclass(frozen=True)
class SignalMask:
    """Bits of a signal that mean a fault."""

    signal: str
    mask: int

    def set_in(self, signals: Mapping[str, Any]) -> bool:
        """Whether a decoded frame has one of the bits; a frame without the signal has none."""
        return bool(int(signals.get(self.signal, 0)) & self.mask)


@dataclass(frozen=True)
class SensorMapping:
    """Mapping of a DBC file's signals to force and torque.

    factors: six dicts of factors by signal, in N and N m per unit.
    start, stop: frames to send then. request: frame that polls a sample. within: s from the first
    to the last frame of a sample. counter: signal that counts samples, and its modulus.
    """

    name: str
    database: Any
    frames: tuple[str, ...]
    factors: tuple[dict[str, float], ...]
    start: tuple[can.Message, ...]
    stop: tuple[can.Message, ...]
    request: can.Message | None
    within: float
    match: dict[str, int]
    saturation: SignalMask | None
    fault: SignalMask | None
    counter: tuple[str, int] | None

    @classmethod
    def load(cls, path: str | Path) -> SensorMapping:
        """Read the YAML file and its DBC file; raises InputError naming file and key."""
        return _Reader(Path(path)).mapping()

    def identifiers(self) -> dict[tuple[int, bool], str]:
        """Message name by (identifier, extended) of the frames of a sample."""
        found = {}
        for name in self.frames:
            message = self.database.get_message_by_name(name)
            found[(int(message.frame_id), bool(message.is_extended_frame))] = name
        return found

    def decode(self, name: str, data: bytes) -> dict[str, float]:
        """Signals of one frame; raises DeviceError for data too short or that do not `match`."""
        try:
            signals = self.database.decode_message(name, data, decode_choices=False)
        except Exception as error:
            # cantools raises its own family and, for multiplexed messages, KeyError.
            raise DeviceError(f"frame {name} cannot be decoded ({error})") from None
        for signal, value in self.match.items():
            if signal in signals and int(signals[signal]) != value:
                raise DeviceError(
                    f"frame {name} has {signal} {signals[signal]}, {value} is expected"
                )
        return dict(signals)

    def wrench(self, signals: dict[str, float]) -> np.ndarray:
        """Wrench (6,) in N and N m from the signals of all frames of a sample."""
        return np.array(
            [sum(f * signals[s] for s, f in terms.items()) for terms in self.factors], dtype=float
        )


class _Reader:
    """Reads and checks one mapping file."""

    def __init__(self, path: Path) -> None:
        self._data = load_yaml(path, "sensor mapping")
        self._path = path
        for key in self._data:
            if key not in _KEYS:
                raise InputError(f"{path}: key '{key}' is not known; remove it")

    def mapping(self) -> SensorMapping:
        database = self._get("database", self._database)
        self._signals: set[str] = set()

        def messages(names: list[str]) -> tuple[str, ...]:
            for name in names:
                self._signals |= {s.name for s in database.get_message_by_name(name).signals}
            if not names or len(set(names)) != len(names):
                raise ValueError("messages are missing or named twice")
            return tuple(names)

        def counter(entry: dict[str, Any]) -> tuple[str, int]:
            if int(entry["modulus"]) < 2:
                raise ValueError("modulus must be at least 2")
            return self._signal(entry["signal"]), int(entry["modulus"])

        def mask(entry: dict[str, Any]) -> SignalMask:
            return SignalMask(self._signal(entry["signal"]), int(entry["mask"]))

        def frames(entries: list[dict[str, Any]]) -> tuple[can.Message, ...]:
            return tuple(_message(entry) for entry in entries)

        return SensorMapping(
            frames=self._get("frames", messages),
            database=database,
            name=self._get("name", str, self._path.stem),
            factors=self._get("channels", self._factors),
            start=self._get("start", frames, ()),
            stop=self._get("stop", frames, ()),
            request=self._get("request", _message, None),
            within=self._get("within", float, 0.005),
            match=self._get("match", lambda v: {self._signal(s): int(v[s]) for s in v}, {}),
            saturation=self._get("saturation", mask, None),
            fault=self._get("fault", mask, None),
            counter=self._get("counter", counter, None),
        )

    def _get(self, key: str, convert: Callable[[Any], Any], *default: Any) -> Any:
        """Value of a key, converted; raises InputError naming file and key."""
        if key not in self._data:
            if default:
                return default[0]
            raise InputError(f"{self._path}: key '{key}' is missing; see the shipped mapping")
        try:
            return convert(self._data[key])
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"{self._path}: '{key}' cannot be used ({error}); see the shipped mapping"
            ) from None

    def _database(self, name: str) -> Any:
        file = self._path.parent / name
        text = read_text(file, "DBC file")
        try:
            return cantools.database.load_string(text, database_format="dbc")
        except Exception as error:
            reason = " ".join(str(error).split())
            raise InputError(f"{file}: not a DBC file ({reason}); correct it") from None

    def _signal(self, name: str) -> str:
        if name not in self._signals:
            raise ValueError(f"signal '{name}' is in none of the frames")
        return name

    def _factors(self, channels: dict[str, dict[str, float]]) -> tuple[dict[str, float], ...]:
        factors = tuple(
            {self._signal(s): float(f) for s, f in channels[channel].items()}
            for channel in CHANNELS
        )
        if not all(math.isfinite(f) for terms in factors for f in terms.values()):
            raise ValueError("factors must be finite numbers")
        return factors


def _message(entry: dict[str, Any]) -> can.Message:
    """Frame to send; raises ValueError for one that CAN cannot carry."""
    extended = bool(entry.get("extended", False))
    payload = bytes.fromhex(str(entry.get("data", "")))
    if not 0 <= int(entry["id"]) < (1 << 29 if extended else 1 << 11) or len(payload) > 8:
        raise ValueError("wrong identifier or more than 8 bytes")
    return can_bus.frame(int(entry["id"]), payload, extended)


class SampleAssembler:
    """Puts frames together to samples; all frames of one must come in order and in time."""

    def __init__(self, mapping: SensorMapping) -> None:
        self._mapping = mapping
        self.incomplete = 0
        """Samples given up because a frame was missing, swapped or late."""
        self.reset()

    def reset(self) -> None:
        """Forget a sample begun."""
        self._signals: dict[str, float] = {}
        self._next = 0
        self._first_stamp = 0

    def add(self, name: str, data: bytes, stamp_ns: int) -> tuple[int, dict[str, float]] | None:
        """Stamp of the first frame and signals of a sample that this frame completes, else None.

        Raises DeviceError for a frame that cannot be decoded; the sample begun is given up.
        """
        try:
            signals = self._mapping.decode(name, data)
        except DeviceError:
            self._give_up()
            raise
        position = self._mapping.frames.index(name)
        late = (stamp_ns - self._first_stamp) * 1e-9 > self._mapping.within
        if self._next and (position != self._next or late):
            self._give_up()
        if position != self._next:
            return None
        if position == 0:
            self._first_stamp = stamp_ns
        self._signals.update(signals)
        self._next += 1
        if self._next < len(self._mapping.frames):
            return None
        result = (self._first_stamp, self._signals)
        self.reset()
        return result

    def _give_up(self) -> None:
        if self._next:
            self.incomplete += 1
        self.reset()
