"""Tests of the order in which the lines of a listing are scheduled."""

import random

import pytest

from drake_quad.framework import scheduling
from drake_quad.framework.scheduling import schedule
from drake_quad.framework.symbols import LEAVES, Listing


def chains(count, length):
    """Return a listing of `count` independent chains of `length` additions, one chain after the other."""
    listing = Listing()
    for chain in range(count):
        x = listing.row(0, chain)
        for step in range(length):
            x = x + float(step)
    return listing


@pytest.mark.parametrize("seed", range(5))
def test_every_line_occurs_once_and_after_its_operands(seed):
    numbers = random.Random(seed)
    listing = Listing()
    values = [listing.row(0, index) for index in range(4)]
    for _ in range(300):
        x, y = numbers.choice(values), numbers.choice(values)
        values.append(numbers.choice([x + y, x * y, x / 3.0, x - y, abs(x), y]))
    order = schedule(listing)
    position = {line: k for k, line in enumerate(order)}
    assert sorted(order) == list(range(len(listing.operations)))
    for line, operation in enumerate(listing.operations):
        if operation.name not in LEAVES:
            assert all(position[operand] < position[line] for operand in operation.operands)


def test_chains_of_dependent_lines_are_interleaved_so_that_no_line_waits_for_the_previous_line():
    listing = chains(18, 5)
    order = [line for line in schedule(listing) if listing.operations[line].name == "add"]
    position = {line: k for k, line in enumerate(order)}
    gaps = [
        position[line] - position[operand]
        for line in order
        for operand in listing.operations[line].operands
        if operand in position
    ]
    assert min(gaps) >= scheduling._LATENCIES["add"] * scheduling._LINES_PER_CYCLE


def test_no_more_chains_of_dependent_lines_start_than_the_latency_requires():
    """Chains start until the first result is available. Then the first chain continues."""
    listing = chains(30, 2)
    sums = [line for line, operation in enumerate(listing.operations) if operation.name == "add"]
    begins, ends = sums[::2], sums[1::2]
    order = [line for line in schedule(listing) if line in sums]
    count = scheduling._LATENCIES["add"] * scheduling._LINES_PER_CYCLE
    assert order[: 2 * count] == begins[:count] + ends[:count]


def test_only_lines_within_the_window_are_scheduled(monkeypatch):
    """A window of one line keeps the order of the listing, and a small window stays close to it."""
    listing = chains(12, 5)
    sums = [line for line, operation in enumerate(listing.operations) if operation.name == "add"]
    for window in (1, 10):
        monkeypatch.setattr(scheduling, "_WINDOW", window)
        order = [line for line in schedule(listing) if line in sums]
        missing = list(sums)
        for line in order:
            assert missing.index(line) <= window - 1
            missing.remove(line)
        assert (order == sums) == (window == 1)


def test_rows_precede_their_first_use_and_unused_rows_are_last():
    listing = Listing()
    a, b, unused = (listing.row(0, index) for index in range(3))
    total = (a + 1.0) * b
    order = schedule(listing)
    assert order[-1] == unused.line
    assert order[-2] == total.line
    assert order[-3] == b.line


def test_the_schedule_of_an_empty_listing_is_empty():
    assert schedule(Listing()) == []
