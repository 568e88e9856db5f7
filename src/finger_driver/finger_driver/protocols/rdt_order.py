# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which RDT records can be used, by their numbers: UDP loses, doubles and swaps datagrams."""

from __future__ import annotations

from dataclasses import dataclass

from .rdt import Record, difference

REORDERED = 64
"""Records by which two that came one after the other may lie apart."""

Received = tuple[Record, int]
"""A record and the host time (ns) of its receipt."""


@dataclass(frozen=True)
class Outcome:
    """What was noticed when a record came; nothing where it is only held for now.

    follows: it follows the newest record in both its numbers.
    out_of_order: it came late, twice, or before the one that it follows.
    conflict: its number came before, with other counts.
    left_out: an earlier record is given up; its number jumped, and the next did not follow it.
    lost: how many records are missing before and between the records that can be used now.
    restarted: the numbering has begun anew; no record can be used any more.
    """

    follows: bool = False
    out_of_order: bool = False
    conflict: bool = False
    left_out: bool = False
    lost: int = 0
    restarted: bool = False


class RecordOrder:
    """Puts the records of one stream in order.

    A record that follows the last one can be used at once. Any other one, after a gap or of a
    numbering begun anew, is held until the next has come, and used when that follows it. So a
    single forged or damaged record neither passes nor ends the stream.

    late: a record at most so many numbers back is a late datagram, one further back a new
    numbering.
    """

    def __init__(self, late: int = REORDERED) -> None:
        self._late = late
        self._last: Record | None = None
        self._held: Received | None = None

    def add(self, record: Record, received: int) -> tuple[list[Received], Outcome]:
        """Take the next record, received at host time (ns); give those that can be used now."""
        last, held, self._held = self._last, self._held, None
        came = record, received
        if last is None or (_step(last, record) == 1 and _follows(last, record)):
            self._last = record
            if held is None:
                return [came], Outcome(follows=True)
            if _step(record, held[0]) == 1 and _follows(record, held[0]):
                self._last = held[0]
                return [came, held], Outcome(follows=True, out_of_order=True)
            return [came], Outcome(follows=True, left_out=True)
        step = _step(last, record)
        if step == 0 or (-self._late <= step < 0 and _internal_step(record, last) > 0):
            self._held = held
            conflict = step == 0 and record.counts != last.counts
            return [], Outcome(out_of_order=True, conflict=conflict)
        swapped = held is not None and _follows(record, held[0])
        first, second = (came, held) if swapped else (held, came)
        if first is None or second is None or not _follows(first[0], second[0]):
            self._held = came
            return [], Outcome(left_out=held is not None)
        gap = _step(last, first[0])
        if gap < 1:
            return [], Outcome(out_of_order=swapped, restarted=True)
        self._last = second[0]
        lost = gap - 1 + _step(first[0], second[0]) - 1
        return [first, second], Outcome(out_of_order=swapped, lost=lost)


def _step(earlier: Record, later: Record) -> int:
    """Difference of two record numbers."""
    return difference(earlier.rdt_sequence, later.rdt_sequence)


def _internal_step(earlier: Record, later: Record) -> int:
    """Difference of the numbers of their internal samples."""
    return difference(earlier.ft_sequence, later.ft_sequence)


def _follows(earlier: Record, later: Record) -> bool:
    """Whether both numbers of `later` are soon after those of `earlier`."""
    return 1 <= _step(earlier, later) <= REORDERED and _internal_step(earlier, later) >= 0
