"""Hostile and mutated files: every reader ends with success or one sentence, within 10 s of
processor time and 500 MB, in a process of its own.
"""

from __future__ import annotations

import importlib
import io
import json
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from scipy.io import savemat

import finger_model
from finger_bag.definitions import definition_text, encode
from finger_bag.mcap_writer import MAGIC
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_fit.study.bags import bag_hash

h5py, pyarrow, parquet, pyxdf = (
    importlib.import_module(name) if find_spec(name.split(".")[0]) else None
    for name in ("h5py", "pyarrow", "pyarrow.parquet", "pyxdf")
)

ROOT = Path(__file__).parent.parent
CORPUS = ROOT / "tests" / "fuzz" / "corpus"
MODELS = Path(finger_model.__file__).parent / "data"

ALIASES = "a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10)
)
DIGITS = "9" * 4006
EVENT_HEAD = b"time_utc,stamp_ns,kind,text,index,attempt\n"
START = 1_700_000_000_000_000_000


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def bag_of(content: bytes, chunks: int) -> bytes:
    """An MCAP file that repeats one chunk and has no summary."""
    packed = zstandard.compress(content, 3)
    head = struct.pack("<QQQI", START, START, len(content), zlib.crc32(content))
    chunk = record(6, head + text("zstd") + struct.pack("<Q", len(packed)) + packed)
    return MAGIC + record(1, text("ros2") + text("")) + chunk * chunks


def channels(count: int) -> bytes:
    """A file that announces so many topics, each with one message."""
    parts = [messages(WRENCH, b"", 0)]
    for k in range(2, count):
        head = struct.pack("<HH", k, 1) + text(f"/t{k}") + text("cdr") + struct.pack("<I", 0)
        parts.append(record(4, head) + record(5, struct.pack("<HIQQ", k, 0, START, START)))
    return bag_of(b"".join(parts), 1)


def overlapping(count: int, later: bool) -> bytes:
    """Chunks of two messages that all lie within the time of all others; with `later`, each begins
    after the one before.
    """
    chunks = [messages(WRENCH, b"", 0)]
    for k in range(count):
        first = START + k if later else 0
        content = b"".join(
            record(5, struct.pack("<HIQQ", 1, 0, stamp, stamp))
            for stamp in (START + k, START + k + 1_000_000_000)
        )
        head = struct.pack("<QQQI", first, 2**62, len(content), 0) + text("")
        chunks.append(record(6, head + struct.pack("<Q", len(content)) + content))
    return MAGIC + record(1, text("ros2") + text("")) + b"".join(chunks)


def messages(message_type: str, cdr: bytes, count: int) -> bytes:
    schema = struct.pack("<H", 1) + text(message_type) + text("ros2msg")
    channel = struct.pack("<HH", 1, 1) + text("/finger/wrench") + text("cdr") + struct.pack("<I", 0)
    message = record(5, struct.pack("<HIQQ", 1, 0, START, START) + cdr)
    return (
        record(3, schema + text(definition_text(message_type)))
        + record(4, channel)
        + (message * count)
    )


WRENCH = "geometry_msgs/msg/WrenchStamped"
LONG_FRAME = encode(WRENCH, {"header": {"stamp": START, "frame_id": "x" * 60_000}})


def jpeg(size: int) -> bytes:
    """A whole image of 16 × 16 pixels whose header claims size × size."""
    data = bytearray((CORPUS / "image.jpg").read_bytes())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", size, size)
    return bytes(data)


def scans() -> bytes:
    """A progressive image of 9 megapixels, its last scan repeated until the file is large."""
    mode = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_QUALITY, 10]
    data = cv2.imencode(".jpg", np.zeros((3000, 3000), np.uint8), mode)[1].tobytes()
    last = data[data.rindex(b"\xff\xda") : -2]
    return data[:-2] + last * ((900_000 - len(data)) // len(last)) + data[-2:]


def tile() -> bytes:
    """A TIFF of 256 × 256 pixels in a tile of 16,000 × 16,000, which is all black."""
    packed = zlib.compress(bytes(16_000 * 16_000), 9)
    one = {256: 256, 257: 256, 258: 8, 259: 8, 262: 1, 277: 1, 322: 16_000, 323: 16_000}
    tags = {**one, 324: 8 + 2 + 12 * 10 + 4, 325: len(packed)}
    entries = [struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items()]
    head = b"II*\x00" + struct.pack("<IH", 8, len(tags))
    return head + b"".join(entries) + bytes(4) + packed


def png(size: int) -> bytes:
    """All black, truly of that size."""
    packer = zlib.compressobj(9)
    row = bytes(size + 1)
    pixels = b"".join(packer.compress(row) for _ in range(size)) + packer.flush()

    def part(name: bytes, body: bytes) -> bytes:
        crc = struct.pack(">I", zlib.crc32(name + body))
        return struct.pack(">I", len(body)) + name + body + crc

    head = struct.pack(">IIBBBBB", size, size, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", pixels) + part(b"IEND", b"")


def npz(header: str) -> bytes:
    """Arrays of a shipped model, one of which claims another size."""
    out = io.BytesIO()
    with zipfile.ZipFile(MODELS / "reduced_default.npz") as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "betas.npy":
                padded = header.ljust(117) + "\n"
                data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded.encode()
            new.writestr(name, data)
    return out.getvalue()


def edited(file: str, member: str, old: bytes, new: bytes) -> bytes:
    """A workbook of the corpus with some bytes of one of its parts replaced."""
    out = io.BytesIO()
    with zipfile.ZipFile(CORPUS / file) as before:
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as after:
            for name in before.namelist():
                data = before.read(name)
                after.writestr(name, data.replace(old, new) if name == member else data)
    return out.getvalue()


def xlsx(cell: int) -> bytes:
    """A table with one cell of that many characters."""
    text = b"<t>" + b"x" * cell + b"</t>"
    return edited("readings.xlsx", "xl/sharedStrings.xml", b"<t>phase</t>", text)


def zeros_npz(count: int) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, time_s=np.zeros(count))
    return out.getvalue()


def zeros_mat(count: int) -> bytes:
    out = io.BytesIO()
    savemat(out, {"time_s": np.zeros(count), "force_n": np.zeros(9)}, do_compression=True)
    return out.getvalue()


def zeros_hdf5(count: int) -> bytes:
    """Arrays of which nothing is stored but their size."""
    out = io.BytesIO()
    with h5py.File(out, "w") as file:
        for name in ("time_s", "force_n"):
            file.create_dataset(name, (count,), "f8", chunks=(1000,))
    return out.getvalue()


def zeros_parquet(count: int) -> bytes:
    out = io.BytesIO()
    column = pyarrow.array(np.zeros(count))
    table = pyarrow.table({"time_s": column, "force_n": column})
    parquet.write_table(table, out, compression="zstd", row_group_size=count)
    return out.getvalue()


def sheet(rows: bytes) -> bytes:
    """A workbook with such rows below its own."""
    end = b"</sheetData>"
    return edited("table.xlsx", "xl/worksheets/sheet1.xml", end, rows + end)


def xdf(channels: int) -> bytes:
    """A stream that claims so many channels."""
    data = (CORPUS / "table.xdf").read_bytes()
    begin = data.index(b"<?xml", 20) - 11
    old = data[begin : data.index(b"</desc></info>") + len(b"</desc></info>")]
    text = old[11:].replace(b"<channel_count>1<", b"<channel_count>%d<" % channels)
    new = old[:1] + struct.pack("<I", len(text) + 6) + old[5:11] + text
    return data.replace(old, new)


def wide_bag(folder: Path) -> Path:
    """A bag with a thousand images of 9 megapixels, which are one and the same."""
    image = png(3000)
    kind = "sensor_msgs/msg/CompressedImage"
    with open_bag(CORPUS / "bag.mcap") as reader, BagWriter(folder / "wide") as bag:
        plate = b"area_per_pixel: 1.0e-10\n"
        bag.attach("plate_calibration.yaml", plate)
        for message in reader:
            if message.topic.endswith("wrench"):
                bag.copy(message)
        topic = bag.add_topic("/finger/image_raw/compressed", kind)
        for k in range(1000):
            stamp = START + 1_000_000 * k
            fields = {"header": {"stamp": stamp}, "format": "png", "data": image}
            bag.write_raw(topic, encode(kind, fields), stamp)
    return (folder / "wide" / "wide_0.mcap").rename(folder / "bag-wide.mcap")


def session(change: Callable[[dict[str, Any]], None]) -> bytes:
    state = json.loads((CORPUS / "session.json").read_text())
    change(state)
    return json.dumps(state).encode()


def evil_condition(state: dict[str, Any]) -> None:
    for trial in state["trials"]:
        trial["condition"] = "../../../evil"


def evil_plan(state: dict[str, Any]) -> None:
    evil_condition(state)
    state["plan"]["conditions"] = ["../../../evil"]


BOMBS: dict[str, Callable[[], bytes]] = {
    **{
        f"{kind}-aliases.yaml": lambda: ALIASES.encode()
        for kind in "metadata mapping parameters plate material camera rig sensor geometry".split()
    },
    "plate-digits.yaml": lambda: f"area_per_pixel: {DIGITS}\n".encode(),
    "plate-hexadecimal.yaml": lambda: b"area_per_pixel: 0x" + b"f" * 900_000,
    "plate-sexagesimal.yaml": lambda: b"area_per_pixel: 1" + b":59" * 300_000,
    "plate-deep.yaml": lambda: b"a: " + b"[" * 500_000,
    "plate-wide.yaml": lambda: b"a: [" + b"[]," * 300_000 + b"]",
    "plate-tag.yaml": lambda: b"area_per_pixel: !!int x\n",
    "material-digits.yaml": lambda: f"young_modulus: {DIGITS}\n".encode(),
    "settings-digits.json": lambda: f'{{"onset_force": {DIGITS}}}'.encode(),
    "settings-deep.json": lambda: b'{"a":' * 200_000,
    "checkpoint-wide.json": lambda: b'{"candidates": [' + b"[]," * 300_000 + b"[]]}",
    "session-deep.json": lambda: b"[" * 500_000,
    "session-condition.json": lambda: session(evil_condition),
    "session-plan.json": lambda: session(evil_plan),
    "session-current.json": lambda: session(lambda s: s.update(current=99)),
    "session-negative.json": lambda: session(lambda s: s.update(current=-1)),
    "session-no_trials.json": lambda: session(lambda s: s.update(trials=[])),
    "session-no_attempt.json": lambda: session(lambda s: s["trials"][1].update(attempts=[])),
    "session-digits.json": lambda: session(lambda s: s.update(current=int(DIGITS))),
    "session-surrogate.json": lambda: session(lambda s: s.update(step="\ud800")),
    "bag-empty_messages.mcap": lambda: bag_of(messages(WRENCH, b"", 1_900_000), 1),
    "bag-long_frame.mcap": lambda: bag_of(messages(WRENCH, LONG_FRAME, 500), 10),
    "bag-chunk_starts.mcap": lambda: (
        MAGIC
        + b"\xff" * 30
        + (record(6, bytes(28) + b"\x04\x00\x00\x00zstd" + bytes(8)) + b"\x00") * 15_000
    ),
    "bag-channels.mcap": lambda: channels(60_000),
    "bag-overlapping.mcap": lambda: overlapping(7000, False),
    "bag-overlapping_later.mcap": lambda: overlapping(7000, True),
    "bag-idle.mcap": lambda: MAGIC + (b"\x80" + bytes(8)) * 100_000,
    "image-30000.jpg": lambda: jpeg(30_000),
    "image-65500.jpg": lambda: jpeg(65_500),
    "image-4000.jpg": lambda: jpeg(4000),
    "image-16_megapixels.png": lambda: png(4000),
    "image-64_megapixels.png": lambda: png(8000),
    "image-10_megapixels.png": lambda: png(3200),
    "image-scans.jpg": scans,
    "image-tile.tif": tile,
    "image-claims.bmp": lambda: (
        b"BM" + bytes(12) + struct.pack("<IiiHHI", 40, 60000, 60000, 1, 24, 0)
    ),
    "image-claims.pgm": lambda: b"P5 60000 60000 255\n",
    "model-800_gigabytes.npz": lambda: npz(
        "{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000,), }"
    ),
    "model-objects.npz": lambda: npz("{'descr': '|O', 'fortran_order': False, 'shape': (2,), }"),
    "readings-cell.xlsx": lambda: xlsx(380_000_000),
    "readings-quote.csv": lambda: b'value;time\n"' + b"x" * 900_000,
    "force-cell.csv": lambda: b"time_s,force_n\n0," + b"9" * 900_000 + b"\n",
    "force-digits.csv": lambda: b"time_s,force_n\n" + b"0,1\n" * 200_000,
    "events-cell.csv": lambda: EVENT_HEAD + b'2026,1,note,"' + b"x" * 900_000 + b'",0,0\n',
    "events-digits.csv": lambda: EVENT_HEAD + f"2026,{DIGITS},note,x,0,0\n".encode() * 200,
    "events-quotes.csv": lambda: EVENT_HEAD + b'"' * 900_000,
    "table-cell.csv": lambda: b"time_s,force_n\n0," + b"9" * 900_000 + b"\n",
    "table-wide.csv": lambda: b"," * 450_000 + b"x\n" + b"1\n" * 200_000,
    "table-zeros.npz": lambda: zeros_npz(30_000_000),
    "table-zeros.mat": lambda: zeros_mat(24_000_000),
    "table-rows.xlsx": lambda: sheet(b"<row><c><v>1</v></c><c><v>1</v></c></row>" * 2_000_000),
    "table-last_row.xlsx": lambda: sheet(b'<row r="2000000000"><c><v>1</v></c></row>'),
    "table-last_column.xlsx": lambda: sheet(b'<row><c r="XFD1"><v>1</v></c></row>' * 100_000),
    "fits-digits.json": lambda: f'{{"conditions": {{"dry": {{"E0": {DIGITS}}}}}}}'.encode(),
    "fits-list.json": lambda: b'{"subjects": ["S01"]}',
    "fits-text.json": lambda: b'{"subjects": {"S01": {"conditions": {"dry": "E0"}}}}',
    "fits-entry.json": lambda: b'{"conditions": {"dry": {"from_data": [], "moisture_mean": "x"}}}',
    "netft-nested.xml": lambda: b"<a>" * 300_000,
}
if h5py:
    BOMBS["table-fill.h5"] = lambda: zeros_hdf5(200_000_000)
    BOMBS["table-claims.h5"] = lambda: zeros_hdf5(10**13)
if pyarrow:
    BOMBS["table-zeros.parquet"] = lambda: zeros_parquet(24_000_000)
if pyxdf:
    BOMBS["table-channels.xdf"] = lambda: xdf(2_000_000_000)
REFUSED_SESSIONS = {name for name in BOMBS if name.startswith("session-")}


def fuzz(*arguments: object) -> dict[str, Any]:
    """Report of tests/fuzz; fails with the cases that failed."""
    call = ["nice", sys.executable, str(ROOT / "tests" / "fuzz"), *map(str, arguments)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=1500)
    assert done.stdout, done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    assert done.returncode == 0, json.dumps(report["failed"], indent=1)[:5000]
    return report


@pytest.mark.timeout(1600)
def test_bombs_end_with_one_sentence(tmp_path: Path) -> None:
    paths = []
    for name, make in BOMBS.items():
        data = make()
        assert len(data) <= 1_000_000, name
        paths.append(tmp_path / name)
        paths[-1].write_bytes(data)
    # The calibration attached to a bag whose areas must be measured in its images.
    with open_bag(CORPUS / "bag.mcap") as reader:
        with BagWriter(tmp_path / "made", reader.info.metadata) as bag:
            bag.attach("plate_calibration.yaml", ALIASES.encode())
            for message in reader:
                if not message.topic.endswith("contact_area"):
                    bag.add_topic(message.topic, message.type)
                    bag.copy(message)
    paths.append((tmp_path / "made" / "made_0.mcap").rename(tmp_path / "bag-attached.mcap"))
    paths.append(wide_bag(tmp_path))
    assert paths[-1].stat().st_size < 1_000_000
    report = fuzz("--files", *paths)
    outcomes = {(r["file"], r["reader"]): r["outcome"] for r in report["results"]}
    refused = {file for (file, _), outcome in outcomes.items() if outcome == "refused"}
    assert refused >= REFUSED_SESSIONS
    assert refused >= {name for name in BOMBS if "aliases" in name or "digits.y" in name} - {
        "metadata-aliases.yaml"  # the files beside it are read without it
    }
    tables = {name for name in BOMBS if name.startswith(("table-", "fits-"))}
    assert refused >= tables - {"table-wide.csv"}
    assert refused >= {"image-30000.jpg", "image-65500.jpg", "model-800_gigabytes.npz"}
    assert refused >= {"image-scans.jpg", "image-tile.tif"}
    assert outcomes["bag-attached.mcap", "process"] == "refused"
    assert outcomes["bag-wide.mcap", "process"] == "success"
    assert report["longest"] < 10 and report["most_megabytes"] < 500


@pytest.mark.timeout(1600)
def test_300_mutated_files_end_with_success_or_one_sentence() -> None:
    report = fuzz("--cases", 300, "--seed", 20, "--few")
    assert report["cases"] == 300 and report["runs"] > 340
    outcomes = [key.split(", ")[-1] for key in report["outcomes"]]
    assert {"success", "refused"} == set(outcomes)


def test_a_sparse_file_beside_a_bag_is_neither_read_nor_hashed(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as bag:
        bag.write("moisture", {"header": {"stamp": START}, "value": 1.0})
    before = bag_hash(path)
    with open(path / "notes.bin", "wb") as file:
        file.truncate(6 << 30)
    assert bag_hash(path) == before


@pytest.mark.parametrize("size", [1, 70_000])
def test_hash_of_a_bag_is_that_of_its_content(size: int, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(np.random.default_rng(0).bytes(size))
    (tmp_path / "b.mcap").write_bytes((tmp_path / "a.mcap").read_bytes()[:-1] + b"?")
    assert bag_hash(tmp_path / "a.mcap") != bag_hash(tmp_path / "b.mcap")
