"""Requests that are answered by the chunk, in C, against the same requests one by one."""

import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Device, Mapping
from tests.support.cases import each_case
from tests.support.chunks import (
    HOLES,
    REPLIED,
    End,
    adu,
    bodies,
    contents,
    in_pieces,
    make_device,
    mask_writes,
    notes,
    read_writes,
    reads,
    single_writes,
    streams,
    writes,
)
from tests.support.vectors import REQUESTS


@pytest.fixture(autouse=True)
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """ByFrame asks for the loop, and needs it on serial lines only."""
    monkeypatch.setattr("asyncio.get_running_loop", lambda: None)


@settings(max_examples=80)
@given(streams(), st.lists(st.integers(0, 4000), max_size=4), st.booleans())
def test_c_and_python_give_the_same_answers_and_counters(
    stream: bytes, cuts: list[int], one_for_all: bool
) -> None:
    ends = []
    for kind in ("chunk", "frames"):
        first, second = make_device(HOLES), make_device()
        end = End(first if one_for_all else {1: first, 2: second}, kind)
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        states = [contents(first), contents(second), notes(first), notes(second)]
        ends.append((bytes(end.sent), states, end.statistics, end.is_open))
    assert ends[0] == ends[1]


@settings(max_examples=40)
@given(
    st.lists(st.tuples(bodies(), st.sampled_from([1, 1, 1, 2, 9, 3])), min_size=1, max_size=12),
    st.integers(0, 30),
)
def test_c_and_python_answer_single_requests_alike(pairs: list[tuple[bytes, int]], cut: int):
    """Together, as in one turn of the server; one of them may send a part, and then the rest."""
    states = []
    for kind in ("chunk", "frames"):
        third = make_device(before_write=lambda access: None)
        devices = {1: make_device(), 2: make_device(), 3: third}
        ends = [End(devices, kind) for _ in pairs]
        if kind == "chunk":
            for end in ends:
                end.share(ends[0])
        requests = [adu(body, number, unit) for number, (body, unit) in enumerate(pairs)]
        ends[0].receive(requests[0][:cut], is_last=False)
        requests[0] = requests[0][cut:]
        for end, request in zip(ends, requests, strict=True):
            end.receive(request, is_last=end is ends[-1])
        answers = [bytes(end.sent) for end in ends]
        tallies = [end.statistics for end in ends]
        totals = [sum(tally.requests for tally in tallies), sum(tally.refused for tally in tallies)]
        tables = [contents(device) for device in devices.values()]
        states.append((answers, totals, tables, [notes(device) for device in devices.values()]))
    assert states[0] == states[1]


def touched(body: bytes) -> set[int]:
    """The addresses that a good request reads or writes."""
    places = struct.unpack_from(">HHHH" if body[0] == 23 else ">HH", body, 1)
    if body[0] in (5, 6, 22):
        return {places[0]}
    pairs = zip(places[::2], places[1::2], strict=True)
    return {address for first, count in pairs for address in range(first, first + count)}


TABLE_OF = {1: "coils", 5: "coils", 15: "coils", 2: "discrete_inputs", 4: "input_registers"}


@settings(max_examples=120)
@given(st.one_of(reads(), single_writes(), writes(), read_writes(), mask_writes))
def test_missing_addresses_are_answered_with_exception_2_and_stay_unchanged(body: bytes) -> None:
    """Other reasons for a refusal take precedence."""
    everything = Device(Mapping(65536, 65536, 65536, 65536))
    devices = [make_device(HOLES), make_device(HOLES, before_write=lambda access: None)]
    table = getattr(devices[0].mapping, TABLE_OF.get(body[0], "holding_registers"))
    exists = {address for range_ in table.ranges for address in range_}
    good = not everything.answer(body)[0] & 0x80
    for device in devices:
        before = contents(device)
        answer = device.answer(body)
        if good and touched(body) <= exists:
            assert answer[0] == body[0]
        elif good:
            assert answer == bytes([body[0] | 0x80, 2])
        if answer[0] & 0x80:
            assert contents(device) == before
        for name in HOLES:
            own = getattr(device.mapping, name)
            view, first = own.view, own.addresses.start
            assert not any(view[at - first] for at in own.addresses if not own.has(at))


@settings(max_examples=60)
@given(st.binary(min_size=1, max_size=600), st.lists(st.integers(0, 600), max_size=4))
def test_c_and_python_treat_bytes_that_are_no_requests_alike(data: bytes, cuts: list[int]) -> None:
    """Where a length makes no sense both stop, and what came before is answered."""
    stream = adu(b"\x03\0\x07\0\x01", 1) + data
    ends = []
    for kind in ("chunk", "frames"):
        end = End({1: make_device()}, kind)
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        ends.append((bytes(end.sent), end.is_open, end.statistics.requests))
    assert ends[0] == ends[1]


def test_the_event_log_has_the_latest_of_many_requests() -> None:
    """64 events are 32 requests; which of them were refused has no short period."""
    states = []
    for kind in ("chunk", "frames"):
        device = make_device()
        end = End({1: device}, kind)
        for number in range(100):
            address = 7 if number % 7 and number % 5 else 0
            end.receive(adu(bytes([3, 0, address, 0, 1]), number))
        states.append(notes(device))
    assert states[0] == states[1]


def test_all_functions_of_libmodbus_are_answered_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not in Python, which would give the same answers."""
    monkeypatch.delattr(Device, "_respond")
    device = Device(Mapping(65536, 65536, 65536, 65536))
    vectors = [vector for vector in REQUESTS if vector.function in REPLIED]
    assert {vector.function for vector in vectors} == set(REPLIED)
    end = End(device, "chunk")
    for vector in vectors:
        end.receive(vector.tcp)
    assert end.statistics.requests == len(vectors)
    assert end.statistics.refused == 0


def request_of(function: int, count: int) -> bytes:
    """A read or write of so many items, whole."""
    head = bytes([function]) + b"\0\0" + count.to_bytes(2, "big")
    if function == 15:
        return head + bytes([-(-count // 8)]) + bytes(-(-count // 8))
    return head + bytes([2 * count]) + bytes(2 * count) if function == 16 else head


def read_write_of(read: int, write: int) -> bytes:
    counts = struct.pack(">HHHHB", 0, read, 0, write, 2 * write)
    return b"\x17" + counts + bytes(2 * write)


# Application Protocol V1.1b3, sections 6.1-6.4, 6.11, 6.12 and 6.17.
LIMITS = {1: 2000, 2: 2000, 3: 125, 4: 125, 15: 1968, 16: 123}


@each_case(
    ("body", "is_good"),
    [
        *[
            pytest.param(request_of(function, count), 1 <= count <= limit, id=f"{function}-{count}")
            for function, limit in LIMITS.items()
            for count in (0, 1, limit, limit + 1)
            if (function, count) != (16, 124)  # which no frame has room for
        ],
        *[
            pytest.param(read_write_of(read, write), is_good, id=f"23-{read}-{write}")
            for read, write, is_good in [
                (0, 1, False),
                (1, 0, False),
                (1, 1, True),
                (125, 121, True),
                (126, 121, False),
            ]
        ],
        *[
            pytest.param(bytes.fromhex(text), False, id=text)
            for text in (  # a byte count that does not match the data
                "0f 0000 0009 01 00",
                "0f 0000 0008 02 0000",
                "10 0000 0001 01 0000",
                "10 0000 0001 02 000000",
                "17 0000 0001 0000 0001 03 0000",
                "17 0000 0001 0000 0001 02 000000",
                "17 0000 0001 0000 0001 02 00",
            )
        ],
        *[pytest.param(bytes([function, 0]), False, id=f"cut {function}") for function in REPLIED],
    ],
)
def test_counts_are_checked_in_c(body, is_good, monkeypatch) -> None:
    monkeypatch.delattr(Device, "_respond", raising=False)
    end = End(Device(Mapping(65536, 65536, 65536, 65536)), "chunk")
    end.receive(adu(body, 1))
    refusal = bytes([body[0] | 0x80, 3])
    assert (end.sent == adu(refusal, 1)) is not is_good
    assert (end.statistics.requests, end.statistics.refused) == (1, not is_good)


def test_no_byte_beside_a_table_changes(
    compiled: Callable[[str], Path],
) -> None:
    """
    3.1.6 as released writes in front of the table (CVE-2022-0367), Debian's is patched: here
    it is a modbus_reply that checks no address at all.
    """
    process = subprocess.run([compiled("beside")], capture_output=True, text=True, timeout=50)
    assert process.stderr == ""
    assert process.returncode == 0
    # 40 items: singles (5, 6, 22) for each of 6 counts; of 1, 2, 39 and 40 items so many
    # first addresses are right for 8 others (23 twice).
    executed = 3 * 6 * 40 + 8 * (40 + 39 + 2 + 1)
    assert process.stdout == f"{65536 * 6 * 11 - executed} refused, {executed} executed\n"


def test_answers_may_exceed_the_buffer_of_one_call() -> None:
    """A thousand of the longest answers are 259 000 bytes."""
    device = make_device()
    end = End(device, "chunk")
    end.receive(b"".join(adu(b"\x03\0\x07\0\x7d", number) for number in range(1000)))
    answer = device.answer(b"\x03\0\x07\0\x7d")
    assert end.sent == b"".join(adu(answer, number) for number in range(1000))
