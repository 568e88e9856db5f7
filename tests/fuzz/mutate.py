"""Changes of valid files that keep, or seem to keep, their structure.

Each function takes the bytes of a file and a random generator. What is damaged is a field, a key, a
cell or a message, and checksums are made to fit, so that the change reaches the code behind them.
"""

from __future__ import annotations

import copy
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import yaml
import zstandard

Mutation = Callable[[bytes, np.random.Generator], bytes]

MAGIC = b"\x89MCAP0\r\n"
NUMBERS = (0, 1, 2, 255, 256, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
TEXTS = (
    "",
    "[/red]",
    "[bold",
    "../../../evil",
    "/etc/evil",
    "C:\\evil",
    "a" * 300,
    "\x00",
    "\x1b[2J",
    "é" * 70,
    "$x_{",
    "%s%n",
    "nan",
    "1e400",
    "true",
    "<b>&amp;",
    "\u202e\u2028",
    "9" * 4006,
)
VALUES: tuple[Any, ...] = (
    *TEXTS,
    *NUMBERS,
    -1,
    10**400,
    1e308,
    float("nan"),
    float("inf"),
    None,
    True,
    [],
    {},
    [[[[]]]],
    {"a": {"b": []}},
    [1, 2, 3],
    "\ud800",
)


def _pick(rng: np.random.Generator, items: Any) -> Any:
    return items[int(rng.integers(len(items)))]


# Bytes -----------------------------------------------------------------------------------------


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 8))):
        out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data)))]


def splice(data: bytes, rng: np.random.Generator) -> bytes:
    """A stretch left out, repeated or moved."""
    a, b, c = sorted(int(i) for i in rng.integers(0, len(data) + 1, 3))
    moved = data[:a] + data[b:c] + data[a:b] + data[c:]
    return _pick(rng, (data[:a] + data[b:], data[:b] + data[a:], moved))


def set_number(data: bytes, rng: np.random.Generator) -> bytes:
    """A number in the first kilobyte, such as a size in a header, takes another value."""
    size = int(_pick(rng, (1, 2, 4, 8)))
    at = int(rng.integers(max(1, min(len(data), 1024) - size)))
    order = _pick(rng, ("little", "big"))
    return data[:at] + (_pick(rng, NUMBERS) % 256**size).to_bytes(size, order) + data[at + size :]


BYTES: tuple[Mutation, ...] = (flip, cut, splice, set_number)


# Text ------------------------------------------------------------------------------------------


def set_token(data: bytes, rng: np.random.Generator) -> bytes:
    """A word or number of a text takes another value."""
    text = data.decode(errors="replace")
    words = [w for w in text.replace(",", " ").replace(";", " ").split() if w] or [text]
    value = str(_pick(rng, VALUES))
    return text.replace(_pick(rng, words), value, int(rng.integers(1, 3))).encode(
        "utf-8", "replace"
    )


def repeat_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True) or [data]
    at = int(rng.integers(len(lines)))
    return b"".join([*lines[:at], lines[at] * int(_pick(rng, (2, 10, 2000))), *lines[at:]])


def nest(data: bytes, rng: np.random.Generator) -> bytes:
    """Brackets, tags or aliases without end somewhere."""
    at, depth = int(rng.integers(len(data) + 1)), int(_pick(rng, (10, 100, 50_000)))
    piece = _pick(rng, (b"[", b"{a: ", b"<a>", b"- ", b'{"a":', b"((", b"!!int ", b"&a [*a, "))
    return data[:at] + piece * depth + data[at:]


TEXT: tuple[Mutation, ...] = (set_token, repeat_line, nest, *BYTES)


# Trees: YAML and JSON ----------------------------------------------------------------------------


def _places(tree: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    pending = [tree]
    while pending:
        node = pending.pop()
        items = node.items() if isinstance(node, dict) else enumerate(node)
        for key, value in list(items):
            found.append((node, key))
            if isinstance(value, (dict, list)):
                pending.append(value)
    return found


def _change_tree(tree: Any, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 4))):
        places = _places(tree)
        if not places:
            return
        node, key = _pick(rng, places)
        kind = int(rng.integers(6))
        if kind == 0 and isinstance(node, dict):
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[str(_pick(rng, TEXTS))] = copy.deepcopy(node[key])
        elif kind == 2 and isinstance(node, list):
            node.insert(key, copy.deepcopy(node[key]))
        elif kind == 3:
            node[key] = [node[key]]
        else:
            node[key] = copy.deepcopy(_pick(rng, VALUES))


def change_json(data: bytes, rng: np.random.Generator) -> bytes:
    tree = json.loads(data)
    _change_tree(tree, rng)
    return json.dumps(tree).encode()


def change_yaml(data: bytes, rng: np.random.Generator) -> bytes:
    tree = yaml.safe_load(data)
    _change_tree(tree, rng)
    return yaml.safe_dump(tree, sort_keys=False).encode("utf-8", "replace")


def multiply_aliases(data: bytes, rng: np.random.Generator) -> bytes:
    """Anchors that refer to each other: some are harmless, some stand for 10^9 values."""
    levels, width = int(rng.integers(1, 10)), int(rng.integers(1, 10))
    lines = ["a0: &a0 [1, 2, 3]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * width)}]" for i in range(1, levels)]
    return "\n".join(lines).encode() + b"\n" + data


# Archives and arrays -----------------------------------------------------------------------------


def change_member(data: bytes, rng: np.random.Generator) -> bytes:
    """One file of a ZIP archive changed, the archive itself whole."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = _pick(rng, sorted(members))
    kinds = TEXT if name.endswith((".xml", ".rels")) else BYTES
    members[name] = _pick(rng, kinds)(members[name] or b" ", rng)
    if rng.integers(4) == 0:
        del members[name]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, content in members.items():
            archive.writestr(key, content)
    return out.getvalue()


def change_array(data: bytes, rng: np.random.Generator) -> bytes:
    """One array of an NPZ file with another shape, type or value."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = _pick(rng, sorted(arrays))
    array = np.atleast_1d(arrays[name])
    changed: tuple[Any, ...] = (
        array[:0],
        array.ravel(),
        array[None],
        np.concatenate([array, array]),
        array.astype("U20"),
        array.T,
        np.full(array.shape, np.nan),
        np.full(array.shape, 1e300),
        np.array(str(_pick(rng, VALUES)).encode("utf-8", "replace").decode()),
    )
    arrays[name] = changed[int(rng.integers(len(changed)))]
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


# Images ------------------------------------------------------------------------------------------


def set_png_header(data: bytes, rng: np.random.Generator) -> bytes:
    """Another width, height, depth or colour type in a PNG, with a checksum that fits."""
    if not data.startswith(b"\x89PNG"):
        return set_number(data, rng)
    head = bytearray(data[12:29])
    if rng.integers(2):
        at = int(_pick(rng, (4, 8)))
        head[at : at + 4] = (_pick(rng, NUMBERS) % 2**32).to_bytes(4, "big")
    else:
        head[int(rng.integers(12, 17))] = int(rng.integers(20))
    return data[:12] + bytes(head) + zlib.crc32(bytes(head)).to_bytes(4, "big") + data[33:]


# MCAP --------------------------------------------------------------------------------------------

FIELDS: dict[int, tuple[int, ...]] = {
    1: (0, 4),
    2: (0, 8, 16),
    3: (0, 2, 6),
    4: (0, 2, 4),
    5: (0, 2, 6, 14, 22, 26, 28, 30, 34, 38, 42),
    6: (0, 8, 16, 24, 28, 32),
    7: (0, 2, 6, 14),
    8: (0, 8, 16, 24, 32),
    9: (0, 8, 16),
    10: (0, 8, 16, 24, 32),
    11: (0, 8, 10, 14, 18, 22, 26, 34, 42),
    12: (0, 4),
    13: (0, 8, 16),
    14: (0, 1, 9),
    15: (0,),
}
"""Where the fields of a record begin, by opcode; the rest of it is text and content."""


def records(data: bytes) -> list[tuple[int, bytes]]:
    """(opcode, body) of a sequence of records."""
    position, found = 0, []
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        found.append((opcode, data[position + 9 : position + 9 + length]))
        position += 9 + length
    return found


def joined(parts: list[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in parts)


def _set_field(opcode: int, body: bytes, rng: np.random.Generator) -> bytes:
    at = min(_pick(rng, FIELDS.get(opcode, (0,))), max(len(body) - 1, 0))
    size = int(_pick(rng, (1, 2, 4, 8)))
    return (
        body[:at] + (_pick(rng, NUMBERS) % 256**size).to_bytes(size, "little") + body[at + size :]
    )


def _set_text(opcode: int, body: bytes, rng: np.random.Generator) -> bytes:
    """Another text in a record, with its length: a topic, a type, an encoding, a name, a value."""
    places = []
    for at in range(len(body) - 4):
        (size,) = struct.unpack_from("<I", body, at)
        if 0 < size < 100_000 and at + 4 + size <= len(body):
            places.append((at, size))
    if not places:
        return body
    at, size = _pick(rng, places)
    new = _pick(rng, TEXTS).encode("utf-8", "replace")
    return body[:at] + struct.pack("<I", len(new)) + new + body[at + 4 + size :]


def _change_records(
    parts: list[tuple[int, bytes]], rng: np.random.Generator
) -> list[tuple[int, bytes]]:
    at = int(rng.integers(len(parts)))
    if rng.integers(2):
        # Rare kinds of records are as likely as messages.
        wanted = _pick(rng, sorted({opcode for opcode, _ in parts}))
        at = _pick(rng, [i for i, (opcode, _) in enumerate(parts) if opcode == wanted])
    opcode, body = parts[at]
    kind = int(rng.integers(8))
    if kind < 3:
        new = [(opcode, _set_field(opcode, body, rng))]
    elif kind == 3:
        new = [(opcode, _set_text(opcode, body, rng))]
    elif kind == 4:
        new = [(opcode, _pick(rng, BYTES)(body, rng) if body else b"\x00")]
    elif kind == 5:
        new = [(opcode, body)] * int(_pick(rng, (0, 2, 3, 500)))
    elif kind == 6:
        new = [(int(rng.integers(256)), body)]
    else:
        other = parts[int(rng.integers(len(parts)))]
        new = [other, (opcode, body)]
    return [*parts[:at], *new, *parts[at + 1 :]]


def _inside_chunk(body: bytes, rng: np.random.Generator) -> bytes:
    start, end, size, _ = struct.unpack_from("<QQQI", body)
    (name,) = struct.unpack_from("<I", body, 28)
    stored = body[32 + name + 8 :]
    content = zstandard.ZstdDecompressor().decompress(stored, max_output_size=size)
    content = joined(_change_records(records(content), rng))
    packed = zstandard.compress(content, 1)
    head = struct.pack("<QQQI", start, end, len(content), zlib.crc32(content))
    return head + body[28 : 32 + name] + struct.pack("<Q", len(packed)) + packed


def change_mcap(data: bytes, rng: np.random.Generator) -> bytes:
    """A record of a bag changed, outside or inside a chunk, mostly with a summary that fits."""
    parts = records(data[len(MAGIC) : -len(MAGIC)])
    for _ in range(int(rng.integers(1, 4))):
        chunks = [i for i, (opcode, _) in enumerate(parts) if opcode == 6]
        if chunks and rng.integers(2):
            at = _pick(rng, chunks)
            try:
                parts[at] = (6, _inside_chunk(parts[at][1], rng))
            except (struct.error, zstandard.ZstdError, IndexError, MemoryError):
                continue
        else:
            parts = _change_records(parts, rng)
    if rng.integers(4):
        parts = _with_footer(parts)
    return MAGIC + joined(parts) + MAGIC


def _with_footer(parts: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """The same records with a footer whose place of the summary and checksum fit."""
    ends = [i for i, (opcode, _) in enumerate(parts) if opcode == 15]
    if not ends:
        return parts
    parts = [part for part in parts if part[0] != 2]
    before, summary = joined(parts[: ends[-1] + 1]), joined(parts[ends[-1] + 1 :])
    start = len(MAGIC) + len(before)
    head = struct.pack("<QQ", start, 0)
    crc = zlib.crc32(summary + struct.pack("<BQ", 2, 20) + head)
    return [*parts, (2, head + struct.pack("<I", crc))]


BY_ENDING: dict[str, tuple[Mutation, ...]] = {
    ".mcap": (change_mcap, change_mcap, change_mcap, *BYTES),
    ".yaml": (change_yaml, change_yaml, change_yaml, multiply_aliases, *TEXT),
    ".json": (change_json, change_json, change_json, *TEXT),
    ".csv": TEXT,
    ".dbc": TEXT,
    ".xml": TEXT,
    ".xlsx": (change_member, change_member, *BYTES),
    ".npz": (change_array, change_array, change_member, *BYTES),
    ".h5": BYTES,
    ".mat": BYTES,
    ".parquet": BYTES,
    ".xdf": TEXT,
    ".png": (set_png_header, *BYTES),
    ".jpg": BYTES,
    ".bmp": BYTES,
    ".tif": BYTES,
    ".pgm": (set_token, *BYTES),
}
