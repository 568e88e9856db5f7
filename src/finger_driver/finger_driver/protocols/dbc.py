"""CAN sensors described by a DBC file and a mapping of its signals to force and torque.

The mapping is a YAML file; `data/robotous_rft.yaml` is the worked and commented example. Everything in it is checked
when it is loaded, so that a frame can only be right or malformed.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import DeviceError, InputError
from finger_common.files import load_yaml, number, read_text

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import cantools

CHANNELS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
_KEYS = {
    "name",
    "database",
    "start",
    "stop",
    "request",
    "frames",
    "within",
    "match",
    "channels",
    "saturation",
    "fault",
    "counter",
}


@dataclass(frozen=True)
class CanFrame:
    """A frame to send."""

    identifier: int
    data: bytes
    extended: bool = False


@dataclass(frozen=True)
class SignalMask:
    """Bits of a signal that mean something bad."""

    signal: str
    mask: int

    def set_in(self, signals: dict[str, Any]) -> bool:
        return bool(int(signals.get(self.signal, 0)) & self.mask)


@dataclass(frozen=True)
class SensorMapping:
    """Mapping of a DBC file's signals. `factors`: six dicts of factors by signal, in N and N m per unit."""

    name: str
    database: Any
    frames: tuple[str, ...]
    factors: tuple[dict[str, float], ...]
    start: tuple[CanFrame, ...] = ()
    stop: tuple[CanFrame, ...] = ()
    request: CanFrame | None = None
    within: float = 0.005
    match: dict[str, int] = field(default_factory=dict)
    saturation: SignalMask | None = None
    fault: SignalMask | None = None
    counter: tuple[str, int] | None = None
    """Signal that counts samples, and its modulus."""

    @classmethod
    def load(cls, path: str | Path) -> SensorMapping:
        """Read the YAML file and its DBC file; raises InputError naming file and key."""
        path = Path(path)
        data = load_yaml(path, "sensor mapping")
        where = str(path)
        unknown = set(data) - _KEYS
        if unknown:
            raise InputError(f"{where}: key '{sorted(unknown)[0]}' is not known; remove it")
        database = _database(path, data)
        frames = data.get("frames")
        if (
            not isinstance(frames, list)
            or not frames
            or not all(isinstance(f, str) for f in frames)
        ):
            raise InputError(f"{where}: 'frames' needs a list of messages of the database")
        signals: set[str] = set()
        for frame in frames:
            try:
                signals |= {s.name for s in database.get_message_by_name(frame).signals}
            except KeyError:
                raise InputError(f"{where}: message '{frame}' is not in the database") from None
        if len(set(frames)) != len(frames):
            raise InputError(f"{where}: 'frames' names a message twice")

        def known(name: Any, key: str) -> str:
            if name not in signals:
                raise InputError(
                    f"{where}: '{key}' names signal '{name}', which is in none of the frames"
                )
            return str(name)

        channels = _mapping(data.get("channels"), "channels", where)
        missing = [c for c in CHANNELS if c not in channels]
        if missing:
            raise InputError(f"{where}: channel '{missing[0]}' is missing under 'channels'")
        factors = []
        for channel in CHANNELS:
            terms = _mapping(channels[channel], channel, where)
            factors.append({known(s, channel): number(terms, s, where) for s in terms})
        counter = None
        if "counter" in data:
            entry = _mapping(data["counter"], "counter", where)
            modulus = int(number(entry, "modulus", where))
            if modulus < 2:
                raise InputError(f"{where}: 'modulus' of 'counter' must be at least 2")
            counter = (known(entry.get("signal"), "counter"), modulus)
        match = _mapping(data.get("match", {}), "match", where)
        return cls(
            name=str(data.get("name", path.stem)),
            database=database,
            frames=tuple(frames),
            factors=tuple(factors),
            start=_frames(data, "start", where),
            stop=_frames(data, "stop", where),
            request=_frame(data["request"], "request", where) if data.get("request") else None,
            within=number(data, "within", where) if "within" in data else 0.005,
            match={known(s, "match"): int(number(match, s, where)) for s in match},
            saturation=_mask(data, "saturation", known, where),
            fault=_mask(data, "fault", known, where),
            counter=counter,
        )

    def identifiers(self) -> dict[tuple[int, bool], str]:
        """Message name by (identifier, extended) of the frames of a sample."""
        found = {}
        for name in self.frames:
            message = self.database.get_message_by_name(name)
            found[(int(message.frame_id), bool(message.is_extended_frame))] = name
        return found

    def decode(self, name: str, data: bytes) -> dict[str, float]:
        """Signals of one frame; raises DeviceError when the data are too short or do not `match`."""
        try:
            signals = self.database.decode_message(name, data, decode_choices=False)
        except Exception as error:
            # cantools raises its own family and, for multiplexed messages, KeyError.
            raise DeviceError(f"frame {name} cannot be decoded ({error})") from None
        for signal, value in self.match.items():
            if signal in signals and int(signals[signal]) != value:
                raise DeviceError(f"frame {name} has {signal} {signals[signal]}, {value} is due")
        return dict(signals)

    def wrench(self, signals: dict[str, float]) -> np.ndarray:
        """Wrench (6,) in N and N m from the signals of all frames of a sample."""
        return np.array(
            [sum(f * signals[s] for s, f in terms.items()) for terms in self.factors], dtype=float
        )


def _database(path: Path, data: dict[str, Any]) -> Any:
    if not isinstance(data.get("database"), str):
        raise InputError(f"{path}: key 'database' is missing; name the DBC file")
    file = path.parent / data["database"]
    text = read_text(file, "DBC file")
    try:
        return cantools.database.load_string(text, database_format="dbc")
    except Exception as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{file}: not a DBC file ({reason}); correct it") from None


def _mapping(value: Any, key: str, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where}: '{key}' needs 'name: value' entries")
    return value


def _mask(data: dict[str, Any], key: str, known: Any, where: str) -> SignalMask | None:
    if key not in data:
        return None
    entry = _mapping(data[key], key, where)
    return SignalMask(known(entry.get("signal"), key), int(number(entry, "mask", where)))


def _frames(data: dict[str, Any], key: str, where: str) -> tuple[CanFrame, ...]:
    entries = data.get(key, [])
    if not isinstance(entries, list):
        raise InputError(f"{where}: '{key}' needs a list of frames")
    return tuple(_frame(entry, key, where) for entry in entries)


def _frame(entry: Any, key: str, where: str) -> CanFrame:
    entry = _mapping(entry, key, where)
    identifier = int(number(entry, "id", where))
    extended = bool(entry.get("extended", False))
    try:
        payload = bytes.fromhex(str(entry.get("data", "")))
    except ValueError:
        raise InputError(f"{where}: 'data' of '{key}' is not hexadecimal bytes") from None
    if not 0 <= identifier < (1 << 29 if extended else 1 << 11) or len(payload) > 8:
        raise InputError(f"{where}: frame of '{key}' has a wrong identifier or more than 8 bytes")
    return CanFrame(identifier, payload, extended)


class SampleAssembler:
    """Puts frames together to samples; a sample is complete when all its frames came in order and in time."""

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
