# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading the sqlite3 files of bags, by `rosbags`."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import yaml

from finger_common.errors import InputError

from .definitions import FORMS, TopicInfo

_COMPUTED = """SELECT c.name FROM sqlite_master AS m JOIN pragma_table_xinfo(m.name) AS c
    WHERE c.hidden <> 0"""
"""Columns of a database that are computed when they are read."""

_BROKEN = (OSError, ValueError, KeyError, TypeError, AssertionError, yaml.YAMLError)


class SqliteFile:
    """One sqlite3 file.

    topics, counts (n,): of the file, and of their messages; count: of all messages. start_ns,
    end_ns: first and last log time, None without messages. Raises InputError, which names the file
    `named`, when it is no bag or cannot be opened.
    """

    def __init__(self, path: Path, named: Path) -> None:
        # Imported here: only those who have sqlite3 bags need apsw, which rosbags reads them with.
        import apsw
        from rosbags.rosbag2 import Reader
        from rosbags.rosbag2.errors import ReaderError

        self._broken = (ReaderError, apsw.Error, *_BROKEN)
        try:
            reader = Reader(path)
            reader.open()
            with contextlib.closing(
                apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)
            ) as database:
                computed = list(database.execute(_COMPUTED))
        except self._broken as error:
            text = _first_line(error)
            raise InputError(f"{named}: cannot be read as a sqlite3 bag ({text})") from None
        if computed:
            # A row of no bytes could compute gigabytes.
            reader.close()
            raise InputError(f"{named}: computes its column '{computed[0][0]}'; no recorder does")
        self._reader = reader
        self.topics = [_topic_info(connection) for connection in reader.connections]
        self.counts = [connection.msgcount for connection in reader.connections]
        self.count = reader.message_count
        self.start_ns: int | None = reader.start_time if self.count else None
        self.end_ns: int | None = reader.end_time - 1 if self.count else None

    def messages(
        self, wanted: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[tuple[int, int, bytes]]:
        """Log time (ns), place of the topic in `topics` and bytes of messages, by log time.

        wanted: topics, None for all; start, stop: as of `BagReader.messages`. Raises InputError
        where the file cannot be read on.
        """
        places = {c.id: place for place, c in enumerate(self._reader.connections)}
        chosen = [c for c in self._reader.connections if wanted is None or c.topic in wanted]
        if not chosen:
            return
        try:
            for connection, time_ns, raw in self._reader.messages(chosen, start, stop):
                yield time_ns, places[connection.id], bytes(raw)
        except self._broken as error:
            text = _first_line(error)
            raise InputError(f"database cannot be read to its end ({text})") from None

    def close(self) -> None:
        """Close the file."""
        if self._reader.is_open:
            self._reader.close()


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _topic_info(connection: Any) -> TopicInfo:
    """Topic, type and definition of a connection, as rosbags gives it."""
    from rosbags.rosbag2.metadata import dump_qos_v8

    return TopicInfo(
        connection.topic,
        connection.msgtype,
        connection.ext.serialization_format,
        connection.msgdef.data,
        FORMS[connection.msgdef.format],
        dump_qos_v8(connection.ext.offered_qos_profiles),
    )
