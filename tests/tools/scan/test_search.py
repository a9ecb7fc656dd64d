"""What a unit has, over sockets and pseudo-terminals: devices that refuse in their own ways."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.scan import Extent, Search, search
from libmodbus_py.tools.scan.search import FINEST, Cells, halving
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.interop import program
from tests.support.peers import mbap
from tests.tools.scan.simulated_bus import line, served

# Seconds; our servers answer all that is asked here, however busy the machine is.
PATIENT = 20.0

BOUND = "the bound on requests"


def ranges(searched: Search) -> dict[str, list[range]]:
    with searched:
        return {extent.table: extent.ranges for extent in searched}


Answers = Callable[[int, int, int], int | None]
"""Gives for function, address and count an exception's code, 0 for an answer, None for silence."""


def replying(answer: Answers) -> Callable[[bytes], list[bytes]]:
    """Return what gives the bytes that a device answers to reads."""

    def reply(request: bytes) -> list[bytes]:
        function, address = request[7], int.from_bytes(request[8:10], "big")
        count = int.from_bytes(request[10:12], "big")
        code = answer(function, address, count)
        if code is None:
            return []
        if code:
            return [mbap(request, bytes([function | 0x80, code]))]
        size = (count + 7) // 8 if function < 3 else 2 * count
        return [mbap(request, bytes([function, size]) + bytes(size))]

    return reply


def answering(network: Network, answer: Answers) -> Scripted:
    return served(network, "tcp://10.0.0.1", replying(answer))


def test_all_ranges_are_found_with_few_requests() -> None:
    """Of two tables of registers 525 reads each are the fewest, and 33 of bits."""
    with Server(Device(Mapping(65536, 65536, 65536, 65536))).background("tcp://127.0.0.1:0") as to:
        searched = search(to.urls[0], timeout=PATIENT)
        extents = {extent.table: extent for extent in searched}
    for extent in extents.values():
        assert (extent.ranges, extent.unseen, extent.ended) == ([range(65536)], 0, "")
    assert searched.requests == sum(extent.requests for extent in extents.values())
    assert 2 * (525 + 33) <= searched.requests <= 2 * (525 + 33) + 20
    assert extents["holding_registers"].most == 125
    assert extents["coils"].most == 2000


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp", "udp"])
def test_ranges_with_gaps_are_found(scheme: str) -> None:
    """Our server answers 2 for any read that touches a hole."""
    mapping = Mapping(
        coils=[range(8), range(10, 26)],
        holding_registers=[
            range(100, 103),
            range(200, 300),
            range(310, 314),
            range(40_000, 40_200),
        ],
        input_registers=range(7),
    )
    with Server({17: Device(mapping)}).background(f"{scheme}://127.0.0.1:0") as to:
        searched = search(f"{to.urls[0]}?unit=17&timeout={PATIENT}")
        assert ranges(searched) == {
            "coils": [range(8), range(10, 26)],
            "discrete_inputs": [],
            "holding_registers": [
                range(100, 103),
                range(200, 300),
                range(310, 314),
                range(40_000, 40_200),
            ],
            "input_registers": [range(7)],
        }
        assert searched.requests <= 2000
        assert {extent.ended for extent in searched.extents} == {BOUND}
        assert all(extent.unseen < 300 for extent in searched.extents)


def test_ranges_are_found_on_a_line() -> None:
    with line({17: Device(Mapping(holding_registers=range(100, 300)))}) as wire:
        searched = search(f"rtu://{wire.client}?baudrate=115200&unit=17", most_requests=400)
        assert ranges(searched)["holding_registers"] == [range(100, 300)]
        assert searched.requests <= 400
        assert set(wire.sent_by("client")[1::8]) == {1, 2, 3, 4}  # functions that read


@pytest.mark.parametrize(
    ("code", "tables", "requests", "reason"),
    [
        (1, 4, 4, "the device lacks the function"),
        (6, 1, 5, "the device stays busy"),
        (11, 1, 1, "the unit does not answer any more"),
    ],
)
def test_a_table_that_refuses_all_is_left_soon(network: Network, code, tables, requests, reason):
    searched = search(answering(network, lambda *counts: code).url, timeout=PATIENT)
    assert [extent.ranges for extent in searched] == [[]] * tables
    assert searched.requests == requests
    assert {extent.ended for extent in searched.extents} == {reason}


def test_a_busy_device_is_asked_again(network: Network) -> None:
    counts: dict[tuple[int, int, int], int] = {}

    def answer(function: int, *where: int) -> int:
        if function != 3:
            return 1
        counts[function, *where] = counts.get((function, *where), 0) + 1
        if counts[function, *where] < 2 and where[0] in (0, 1, 25):
            return 6
        return 0 if sum(where) <= 30 else 2

    searched = search(answering(network, answer).url, timeout=PATIENT, most_requests=300)
    assert ranges(searched)["holding_registers"] == [range(30)]


def test_a_device_that_is_silent_at_missing_addresses_is_searched(network: Network) -> None:
    def answer(function: int, address: int, count: int) -> int | None:
        if function != 3:
            return 1
        return 0 if address + count <= 10 else None

    searched = search(answering(network, answer).url, timeout=0.03, most_requests=150)
    assert ranges(searched)["holding_registers"] == [range(10)]
    assert searched.extents[2].ended == BOUND


def test_a_unit_that_stops_answering_ends_the_search_with_the_ranges_found(network: Network):
    counts: list[int] = []

    def answer(function: int, address: int, count: int) -> int | None:
        if function != 3:
            return 1
        counts.append(count)
        return 0 if len(counts) < 5 else None

    searched = search(answering(network, answer).url, timeout=0.03)
    assert ranges(searched)["holding_registers"] == [range(1 + 125 * 3)]
    assert searched.extents[-1].ended == "the unit does not answer any more"
    assert searched.requests < 30


@pytest.mark.parametrize("bound", [4, 5, 100, 1000])
def test_a_search_sends_no_more_than_the_given_number_of_requests(network: Network, bound: int):
    server = answering(network, lambda function, address, count: 0 if count == 1 else 3)
    with search(server.url, timeout=PATIENT, most_requests=bound) as searched:
        extents = list(searched)
    assert searched.requests == len(server.requests) == bound
    assert {extent.ended for extent in extents} == {BOUND}
    assert all(extent.unseen for extent in extents)


def test_libmodbus_own_server_is_searched(compiled: Callable[[str], Path]) -> None:
    with program(compiled("server"), "tcp", 0) as process:
        assert process.stdout is not None
        port = process.stdout.readline().split()[1]
        tables = ranges(search(f"tcp://127.0.0.1:{port}", timeout=PATIENT))
    assert tables == {
        "coils": [range(10, 2110)],
        "discrete_inputs": [range(20, 2120)],
        "holding_registers": [range(100, 400)],
        "input_registers": [range(200, 400)],
    }


def test_a_search_that_is_closed_keeps_the_ranges_found(network: Network) -> None:
    url = answering(network, lambda *counts: 0).url
    searched = search(url, timeout=PATIENT)
    first = next(searched)
    assert isinstance(first, Extent)
    searched.close()
    assert list(searched) == []
    assert searched.extents == [first]

    def fail(progress: Any) -> None:
        if progress.requests == 4:
            raise KeyboardInterrupt

    searched = search(url, timeout=PATIENT, on_progress=fail)
    with pytest.raises(KeyboardInterrupt):
        next(searched)
    (extent,) = searched.extents
    assert extent.ended == "the user, or a lost connection"
    assert extent.ranges == [range(6001)]


SIZE = 65536

Reader = Callable[[range], bool]


def strict(*there: range) -> Reader:
    """Refuses every read that touches a hole."""
    cells = {cell for entry in there for cell in entry}
    return lambda read: all(cell in cells for cell in read)


def limited(most: int, *there: range) -> Reader:
    """Refuses reads of more than so many, too."""
    answers = strict(*there)
    return lambda read: len(read) <= most and answers(read)


def found(reader: Reader, most: int = 125, bound: int = 1_000_000) -> tuple[Cells, list[range]]:
    """Return what halving finds, and all its reads."""
    cells = Cells(most)
    steps = halving(cells)
    reads: list[range] = []
    try:
        read = next(steps)
        while len(reads) < bound:
            assert 1 <= len(read) <= most
            assert 0 <= read.start < read.stop <= SIZE
            reads.append(read)
            read = steps.send(reader(read))
    except StopIteration:
        pass
    return cells, reads


@pytest.mark.parametrize(
    "there",
    [
        [range(10)],
        [range(1)],
        [range(100, 400)],
        [range(2), range(5, 6)],
        [range(99, 223), range(224, 225), range(230, 300)],
        [range(65_400, 65_536)],
        [range(65_536)],
        [range(40_000, 40_125), range(40_126, 40_300)],
        [range(777, 777 + FINEST)],
        [],
    ],
    ids=str,
)
@pytest.mark.parametrize("most", [1, 2, 7, 100, 125, 2000])
def test_ranges_are_exact_whatever_length_a_device_accepts(there, most) -> None:
    cells, reads = found(limited(most, *there), 2000 if most == 2000 else 125)
    assert cells.ranges == there
    assert cells.unseen < FINEST
    assert len(set(reads)) == len(reads)  # nothing is asked twice


@pytest.mark.parametrize(("limit", "least"), [(1, 1), (2, 1), (10, 5), (60, 30), (124, 62)])
def test_the_longest_read_that_a_device_accepts_is_found(limit: int, least: int) -> None:
    cells, reads = found(limited(limit, range(5000)), bound=10_000)
    assert least <= cells.most <= limit
    assert cells.ranges == [range(5000)]
    refused = [read for read in reads if len(read) > limit and read.start < 5000]
    assert len(refused) < 20  # once, not with each


@settings(max_examples=60)
@given(
    st.lists(st.integers(0, 2000), max_size=12),
    st.integers(1, 125),
    st.randoms(use_true_random=False),
)
def test_no_range_is_reported_that_cannot_be_read(ends: list[int], most: int, random: Any) -> None:
    """Also of a device that sometimes refuses what it has."""
    points = sorted(set(ends))
    there = [range(*pair) for pair in zip(points[::2], points[1::2], strict=False)]
    reader = limited(most, *there)
    cells, _ = found(lambda read: reader(read) and random.random() > 0.1, bound=5000)
    claimed = {cell for range_ in cells.ranges for cell in range_}
    assert claimed <= {cell for entry in there for cell in entry}
