# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Records of a Net F/T are used in order, whatever the network or a forger does to them."""

from __future__ import annotations

from dataclasses import replace

from finger_driver.protocols.rdt import Record
from finger_driver.protocols.rdt_order import REORDERED, Outcome, RecordOrder


class Stream:
    """Records into the rule; numbers of those that can be used, and what was noticed."""

    def __init__(self, late: int = REORDERED) -> None:
        self._order = RecordOrder(late)
        self._outcomes: list[Outcome] = []

    def feed(self, *numbers: int | Record) -> list[int]:
        used: list[int] = []
        for number in numbers:
            record = number if isinstance(number, Record) else of_number(number)
            usable, outcome = self._order.add(record, 0)
            used += [r.rdt_sequence for r, _ in usable]
            self._outcomes.append(outcome)
        return used

    def counted(self, what: str) -> int:
        return sum(getattr(outcome, what) for outcome in self._outcomes)


def of_number(number: int, force: int = 0) -> Record:
    return Record(number % 2**32, 14 * number % 2**32, 0, (force, 0, 0, 0, 0, 0))


def test_a_forged_jump_is_left_out_and_the_stream_goes_on() -> None:
    stream = Stream()
    assert stream.feed(10, 11, 5011, 12, 13, 20, 14, 15) == [10, 11, 12, 13, 14, 15]
    assert stream.counted("left_out") == 2 and stream.counted("lost") == 0


def test_a_forged_old_number_does_not_end_the_stream() -> None:
    stream = Stream()
    assert stream.feed(5000, 5001, 1, 5002, 5003) == [5000, 5001, 5002, 5003]
    assert stream.counted("left_out") == 1


def test_records_lost_in_the_network_are_counted_and_the_next_ones_used() -> None:
    stream = Stream()
    assert stream.feed(1, 2, 5, 6, 7) == [1, 2, 5, 6, 7]
    assert stream.counted("lost") == 2 and stream.counted("left_out") == 0
    # Every second one lost: still a stream.
    assert stream.feed(9, 11, 13, 15) == [9, 11, 13, 15]
    assert stream.counted("lost") == 6


def test_records_that_swapped_places_are_both_used() -> None:
    stream = Stream()
    assert stream.feed(1, 3, 2, 4, 2, 5) == [1, 2, 3, 4, 5]
    assert stream.counted("out_of_order") == 2 and stream.counted("lost") == 0
    assert stream.feed(10, 9, 11) == [9, 10, 11] and stream.counted("lost") == 3


def test_numbers_pass_their_end() -> None:
    top = 2**32
    assert Stream().feed(top - 2, top - 1, top, top + 1) == [top - 2, top - 1, 0, 1]


def test_a_numbering_begun_anew_ends_the_connection() -> None:
    stream = Stream()
    assert stream.feed(5000, 5001, 1) == [5000, 5001] and stream.counted("restarted") == 0
    assert stream.feed(2) == [] and stream.counted("restarted") == 1


def test_records_overtaken_by_many_are_late_and_no_new_numbering() -> None:
    stream = Stream(late=875)
    numbers = [*range(5000, 5003), *range(5006, 5100), 5003, 5004, 5005, *range(5100, 5110)]
    assert stream.feed(*numbers) == [*range(5000, 5003), *range(5006, 5110)]
    assert stream.counted("out_of_order") == 3 and stream.counted("lost") == 3
    assert stream.counted("restarted") == stream.counted("left_out") == 0
    assert stream.feed(1) == stream.feed(2) == [] and stream.counted("restarted") == 1


def test_a_late_record_is_known_where_the_internal_number_passes_its_end() -> None:
    stream, end = Stream(), 2**32 // 14
    assert stream.feed(end, end + 3, end + 4, end + 1, end + 5) == [end, end + 3, end + 4, end + 5]
    assert stream.counted("out_of_order") == 1 and stream.counted("left_out") == 0


def test_two_contents_of_one_number_are_reported() -> None:
    stream = Stream()
    assert stream.feed(1, of_number(2, force=99), of_number(2), 3) == [1, 2, 3]
    assert stream.counted("conflict") == 1
    assert stream.feed(3, 3) == [] and stream.counted("conflict") == 1


def test_an_internal_number_that_goes_back_is_not_used_alone() -> None:
    stream = Stream()
    wild = replace(of_number(3), ft_sequence=1)
    assert stream.feed(1, 2, wild, of_number(3), 4) == [1, 2, 3, 4]


def test_the_time_of_receipt_stays_with_its_record() -> None:
    order = RecordOrder()
    order.add(of_number(1), 100)
    assert order.add(of_number(3), 300) == ([], Outcome())
    usable, outcome = order.add(of_number(2), 320)
    assert [(r.rdt_sequence, t) for r, t in usable] == [(2, 320), (3, 300)]
    assert outcome == Outcome(follows=True, out_of_order=True)
