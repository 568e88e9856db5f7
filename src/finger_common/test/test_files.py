# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Small files: nothing half-written, every error names the place and the remedy."""

from __future__ import annotations

import errno
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from finger_common import cli, files
from finger_common.errors import InputError
from finger_common.files import bounded_memory, read_csv, read_text
from finger_common.folder_lock import whole_folder


def test_atomic_write_replaces_only_when_the_block_succeeds(tmp_path: Path) -> None:
    path = tmp_path / "sub" / "a.txt"
    with files.atomic_write(path) as file:
        file.write("one")
    with pytest.raises(ZeroDivisionError), files.atomic_write(path) as file:
        file.write("two")
        raise ZeroDivisionError
    assert path.read_text() == "one"
    assert os.listdir(path.parent) == ["a.txt"]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o027, 0o640)])
def test_a_file_written_is_as_readable_as_any_other_of_its_user(
    tmp_path: Path, umask: int, mode: int
) -> None:
    before = os.umask(umask)
    try:
        with files.atomic_write(tmp_path / "a.txt") as file:
            file.write("one")
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == mode


def test_atomic_write_names_a_disk_that_is_full(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("one")
    with pytest.raises(InputError, match=r"a\.txt: cannot be written \(.*\); make room"):
        with files.atomic_write(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert path.read_text() == "one" and os.listdir(tmp_path) == ["a.txt"]


def test_atomic_write_names_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "f").write_text("")
    with (
        pytest.raises(InputError, match="writable folder"),
        files.atomic_write(tmp_path / "f" / "a"),
    ):
        pass


@pytest.mark.parametrize("name", ["a\0b", "\ud800"])
def test_an_output_that_cannot_be_a_file_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="not a file name"):
        with files.atomic_write(tmp_path / name):
            raise AssertionError
    assert not list(tmp_path.iterdir())


def test_a_device_without_end_is_not_read_to_the_limit_of_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("finger_common.files.MAXIMUM_PIPE", 1 << 20)
    with pytest.raises(InputError, match="/dev/zero: CSV file has more than 1048576 bytes"):
        read_csv("/dev/zero", ["time_s"])


def test_a_device_that_is_full_is_named() -> None:
    with pytest.raises(InputError, match=r"/dev/full: cannot be written \(No space left"):
        with files.atomic_write("/dev/full") as file:
            file.write("text")


@pytest.mark.parametrize(
    ("outputs", "says"),
    [
        (["p.csv", "./p.csv"], "./p.csv: is named for two outputs"),
        (["p.csv", None, "", "link"], "link: is named for two outputs"),
        (["bag", "bag/table.csv"], "bag/table.csv: lies in the output bag"),
        (["bag/in/table.csv", "bag"], "bag/in/table.csv: lies in the output bag"),
        (["new.csv", "input.csv"], "input.csv: is an input too"),
    ],
)
def test_an_output_that_would_replace_another_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, outputs: list[str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("input.csv").touch()
    Path("link").symlink_to("p.csv")
    with pytest.raises(InputError, match=says):
        files.check_outputs(outputs, ["input.csv", "", None])
    files.check_outputs(["p.csv", "q.csv", "bags", "/dev/null", "/dev/null"], ["input.csv"])


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("a: 1\nb: 2\na: 3\n", "line 3: 'a'"),
        ("a: 1\n'a': 3\n", "line 2: 'a'"),
        ("sets:\n  - {E0: 1, E1: 2,\n     E0: 3}\n", "line 3: 'E0'"),
        ("/n: {ros__parameters: {rate: 1}}\n/n: {ros__parameters: {rate: 2}}\n", "line 2: '/n'"),
    ],
)
def test_a_yaml_key_that_is_there_twice_is_refused(text: str, where: str) -> None:
    with pytest.raises(InputError, match=f"f.yaml, {where} is there twice; keep one"):
        files.parse_yaml(text, "f.yaml")


def test_one_key_in_several_mappings_is_read() -> None:
    """As in parameter files of ROS; a merge fills in what is not there."""
    text = "a: &a {x: 1, y: a}\nb: {<<: *a, y: {x: x, a: [x, x, {x: 1}]}}\nx: [{a: 1}, {a: 2}]\n"
    found = files.parse_yaml(text, "f.yaml")
    assert found["b"] == {"x": 1, "y": {"x": "x", "a": ["x", "x", {"x": 1}]}}
    assert found["x"] == [{"a": 1}, {"a": 2}]


def test_a_json_key_that_is_there_twice_is_refused() -> None:
    once = '{"a": {"b": "{\\"a\\": 1}"}, "c": [{"a": 1},\n {"a": 2}]%s}'
    assert files.parse_json(once % "", "f.json")["c"] == [{"a": 1}, {"a": 2}]
    with pytest.raises(InputError, match=r"f\.json, line 3: 'c' is there twice; keep one"):
        files.parse_json(once % ',\n"\\u0063" : 3', "f.json")


def test_devices_pipes_and_links_stay_what_they_are(tmp_path: Path) -> None:
    """Root could replace /dev/null, on which a whole machine relies, by a file."""
    pipe, link, device = tmp_path / "pipe", tmp_path / "link", tmp_path / "device"
    os.mkfifo(pipe)
    link.symlink_to("target")
    device.symlink_to("/dev/null")
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    for path in (pipe, link, device):
        with files.atomic_write(path) as file:
            file.write("text")
    assert os.read(reader, 100) == b"text" and pipe.is_fifo()
    os.close(reader)
    assert link.is_symlink() and (tmp_path / "target").read_text() == "text"
    assert device.is_symlink() and Path("/dev/null").is_char_device()
    assert {p.name for p in tmp_path.iterdir()} == {"pipe", "link", "device", "target"}


def test_csv_columns_are_found_by_name_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("# made by hand\nforce_n, extra,time_s\n1.5,x,0\n\n2.5,y,0.1\n")
    table = files.read_csv(path, ["time_s", "force_n"])
    np.testing.assert_array_equal(table["time_s"], [0.0, 0.1])
    np.testing.assert_array_equal(table["force_n"], [1.5, 2.5])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty", "time_s,force_n"]),
        ("time_s,force_n\n", ["no rows"]),
        ("t,force_n\n0,1\n", ["line 1", "'time_s'", "header"]),
        ("time_s;force_n\n0;1\n", ["line 1", "by commas"]),
        ("time_s,force_n\n0,1\n0.1,nan\n", ["line 3", "'nan'", "'force_n'"]),
        ("time_s,force_n\n0,1\n0.1\n", ["line 3", "'force_n'"]),
        ("time_s,force_n\n0,inf\n", ["line 2", "'inf'"]),
        ("time_s,force_n\n0,0,0,0\n0,1,0,7\n", ["line 2", "4 cells", "decimal point"]),
    ],
)
def test_bad_csv_is_refused_with_file_line_and_column(
    tmp_path: Path, text: str, words: list[str]
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        files.read_csv(path, ["time_s", "force_n"])
    for word in ["bad.csv", *words]:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[:", "not valid YAML"),
        ("- 1\n", "list"),
        ("a: [1", "line"),
        ("# only this\n", "empty"),
        ("ü: 1\na:\n\tb: 2\n", r"line 3: not valid YAML \(a tab; indent with blanks\)"),
    ],
)
def test_bad_yaml_is_refused_with_the_file_named(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=word) as error:
        files.load_yaml(path)
    assert "p.yaml" in str(error.value)


def test_binary_in_place_of_yaml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_bytes(b"\xff\xfe\x00\x89PNG")
    with pytest.raises(InputError, match="UTF-8"):
        files.load_yaml(path)


def test_a_text_without_end_is_refused_before_it_fills_the_memory() -> None:
    tracemalloc.start()
    with pytest.raises(InputError, match="has more than"):
        read_text("/dev/zero")
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()


def test_memory_is_bounded_by_the_size_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "small").write_bytes(b"x")
    with bounded_memory(tmp_path / "small"):
        assert len(bytes(50_000_000)) == 50_000_000
    with (
        pytest.raises(InputError, match="small: holds more than"),
        bounded_memory(tmp_path / "small"),
    ):
        bytes(2_000_000_000)
    assert len(bytes(500_000_000)) == 500_000_000, "no limit is left behind"


def test_numbers_written_the_yaml_1_2_way_count() -> None:
    data = files.parse_yaml("a: 1e5\nb: 2\nc: true\nd: .nan\n", "here")
    assert files.number(data, "a", "here") == 1e5
    assert files.number(data, "b", "here") == 2.0
    for key in ("c", "d", "missing"):
        with pytest.raises(InputError, match=key):
            files.number(data, key, "here")


def test_hash_is_independent_of_the_order_of_keys() -> None:
    assert files.sha256_of({"a": 1, "b": 2}) == files.sha256_of({"b": 2, "a": 1})
    assert files.sha256_of({"a": 1}) != files.sha256_of({"a": 2})


def test_cli_turns_errors_into_one_line_and_exit_codes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["/usr/bin/finger-x"])

    def bad(argv: object) -> int:
        raise InputError("a.csv, line 3:\n 'x' is not a number; correct it")

    assert cli.run(bad) == 2
    assert capsys.readouterr().err == "finger-x: a.csv, line 3: 'x' is not a number; correct it\n"

    def interrupted(argv: object) -> int:
        raise KeyboardInterrupt

    assert cli.run(interrupted) == 130
    assert cli.run(lambda argv: 1) == 1
    assert cli.run(lambda argv: None) == 0


def test_help_shows_the_example(capsys: pytest.CaptureFixture[str]) -> None:
    parser = cli.Parser(prog="finger-x", example="finger-x --force f.csv")
    with pytest.raises(SystemExit) as exit_info:
        parser.parse_args(["--help"])
    assert exit_info.value.code == 0
    assert "example:\n  finger-x --force f.csv" in capsys.readouterr().out


def test_a_durable_file_is_on_the_disk_before_it_takes_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def fsync(handle: int) -> None:
        done.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "file")

    replace = os.replace
    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", lambda a, b: (done.append("name"), replace(a, b)))
    for durable in (False, True):
        with files.atomic_write(tmp_path / "session.json", durable=durable) as file:
            file.write("{}")
    assert done == ["name", "file", "name", "folder"]


def test_a_folder_takes_its_name_when_it_is_whole(tmp_path: Path) -> None:
    (tmp_path / ".out.partial" / "killed").mkdir(parents=True)
    with whole_folder(tmp_path / "out") as partial:
        (partial / "bag").mkdir()
        assert not (tmp_path / "out").exists()
        with pytest.raises(InputError, match="out: is being written by another program"):
            with whole_folder(tmp_path / "out"):
                raise AssertionError
        assert (partial / "bag").is_dir()
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["bag"]
    with pytest.raises(ZeroDivisionError), whole_folder(tmp_path / "other"):
        raise ZeroDivisionError
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("kind", ["file", "pipe", "link", "full"])
def test_a_folder_that_cannot_take_its_name_is_refused_before_it_is_written(
    tmp_path: Path, kind: str
) -> None:
    out = tmp_path / "out"
    if kind == "file":
        out.touch()
    elif kind == "pipe":
        os.mkfifo(out)
    elif kind == "link":
        out.symlink_to("nothing")
    else:
        (out / "bag").mkdir(parents=True)
    with pytest.raises(InputError, match="out: exists already; choose another name or remove it"):
        with whole_folder(out):
            raise AssertionError
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_path_of_a_thousand_levels_is_written_to(tmp_path: Path) -> None:
    deep = tmp_path.joinpath(*["d"] * 1500)
    try:
        files.make_folder(deep.parent)
        with files.atomic_write(deep / "file") as file:
            file.write("text")
        assert read_text(deep / "file") == "text"
        (deep / "file").unlink()
    finally:
        (tmp_path / "file").touch()  # a folder is left
        os.removedirs(deep)  # shutil.rmtree, as pytest uses it, would not end


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    files.make_folder(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        files.make_folder(tmp_path / "file")
    with pytest.raises(NotADirectoryError):
        files.make_folder(tmp_path / "file" / "folder")
