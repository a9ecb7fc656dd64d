"""Hooks and handlers: what they want is answered in Python, all else by the chunk, in C."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Access, Device, Hook, IllegalDataAddress, Mapping, pdu
from libmodbus_py.protocol.framing import split
from tests.support.cases import each_case
from tests.support.chunks import (
    BITS,
    HOLES,
    WHOLE,
    End,
    adu,
    bodies,
    contents,
    in_pieces,
    in_words,
    make_device,
    notes,
    streams,
)


@pytest.fixture(autouse=True)
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """ByFrame asks for the loop, and needs it on serial lines only."""
    monkeypatch.setattr("asyncio.get_running_loop", lambda: None)


@settings(max_examples=30)
@given(streams(), st.lists(st.integers(0, 4000), max_size=4), st.sampled_from([WHOLE, HOLES]))
def test_hooks_change_no_answer(stream: bytes, cuts: list[int], holds: Any) -> None:
    """A device with hooks answers in Python what one without answers in C."""
    accesses: list[Access] = []
    ends = []
    for hooks in ({}, {"before_read": accesses.append, "before_write": accesses.append}):
        device = make_device(holds, **hooks)
        end = End({1: device}, "chunk")
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        ends.append((bytes(end.sent), contents(device), notes(device), end.statistics))
    assert ends[0] == ends[1]


# Small tables, and mostly right requests for a few of their items: what is near a range counts.
SMALL: dict[str, Any] = {
    "coils": {2: BITS[:20], 26: BITS[:10]},
    "discrete_inputs": {0: BITS[:36]},
    "holding_registers": {1: range(20), 25: range(11)},
    "input_registers": {3: range(30)},
}


starts, few = st.integers(0, 36), st.integers(1, 6)


@st.composite
def small_bodies(draw: st.DrawFn) -> bytes:
    at, count, other = draw(starts), draw(few), draw(few)
    kinds = [bytes([function]) + in_words(at, count) for function in (1, 2, 3, 4)]
    kinds += [
        b"\5" + in_words(at, 0xFF00),
        b"\6" + in_words(at, 7),
        b"\x16" + in_words(at, 0xF2, 37),
    ]
    kinds += [b"\x0f" + in_words(at, count) + b"\1\x15", b"\x18" + in_words(at)]
    values = in_words(*range(other))
    kinds.append(b"\x10" + in_words(at, other) + bytes([2 * other]) + values)
    write = in_words(draw(starts), other) + bytes([2 * other]) + values
    kinds += [b"\x17" + in_words(at, count) + write] * 3
    kinds.append(b"\x14\7\6" + in_words(draw(st.integers(3, 5)), at, count))
    return draw(st.one_of(*map(st.just, kinds)))


@st.composite
def small_streams(draw: st.DrawFn) -> bytes:
    requests = draw(st.lists(st.one_of(small_bodies(), small_bodies(), bodies()), max_size=12))
    return b"".join(adu(body, number) for number, body in enumerate(requests))


some_ranges = st.lists(
    st.tuples(starts, st.integers(1, 9)).map(lambda at: range(at[0], sum(at))), max_size=3
)


places = st.dictionaries(
    st.sampled_from([*HOLES, "files", "fifos"]),
    st.one_of(some_ranges, some_ranges, st.just(range(65536)), st.just([])),
    max_size=4,
)


# Of each hook: None for none, "all" for the function alone, else its places.
hook_places = st.fixed_dictionaries(
    {
        name: st.one_of(st.none(), st.just("all"), places)
        for name in ("before_write", "after_write", "before_read")
    }
)


handled = st.sets(st.sampled_from([pdu.ReadCoils, pdu.WriteRegister, pdu.ReadWriteRegisters]))


Told = list[tuple[str, Access]]


def hooked(ranges: dict[str, Any], functions: set[Any], calls: Told) -> Device:
    """A device whose hooks record their accesses, change the values read, and refuse some."""

    def hook(name: str) -> Callable[[Access], None]:
        def call(access: Access) -> None:
            calls.append((name, access))
            if access.address % 17 == 6:
                raise IllegalDataAddress
            if access.address % 19 == 10:
                raise ZeroDivisionError
            if name == "before_read" and access.table in HOLES:
                getattr(device.mapping, access.table)[access.address] = len(calls) & 1

        return call

    def handle(request: Any) -> Any:
        calls.append((str(request), Access("", 0, 0)))
        if isinstance(request, pdu.WriteRegister):
            return None
        return [1] * getattr(request, "read_count", getattr(request, "count", 0))

    hooks = {
        name: hook(name) if where == "all" else Hook(hook(name), **where)
        for name, where in ranges.items()
        if where is not None
    }
    device = make_device(SMALL, handlers=dict.fromkeys(functions, handle), **hooks)
    return device


@settings(max_examples=100)
@given(small_streams(), st.lists(st.integers(0, 4000), max_size=4), hook_places, handled)
def test_hooks_get_the_same_accesses_in_c_and_python(
    stream: bytes, cuts: list[int], ranges: dict[str, Any], functions: set[Any]
) -> None:
    ends = []
    for kind in ("chunk", "frames"):
        calls: Told = []
        device = hooked(ranges, functions, calls)
        end = End({1: device}, kind)
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        states = [contents(device), notes(device), calls]
        ends.append((bytes(end.sent), states, end.statistics, end.is_open))
    assert ends[0] == ends[1]


@settings(max_examples=48)
@given(st.lists(small_bodies(), min_size=1, max_size=12), hook_places, handled)
def test_hooks_get_the_same_accesses_of_single_requests(
    requests_: list[bytes], ranges: dict[str, Any], functions: set[Any]
) -> None:
    states = []
    for kind in ("chunk", "frames"):
        calls: Told = []
        device = hooked(ranges, functions, calls)
        ends = [End({1: device}, kind) for _ in requests_]
        if kind == "chunk":
            for end in ends:
                end.share(ends[0])
        for number, (end, body) in enumerate(zip(ends, requests_, strict=True)):
            end.receive(adu(body, number), is_last=end is ends[-1])
        answers = [bytes(end.sent) for end in ends]
        tallies = [end.statistics for end in ends]
        totals = [sum(tally.requests for tally in tallies), sum(tally.refused for tally in tallies)]
        states.append((answers, totals, contents(device), notes(device), calls))
    assert states[0] == states[1]


def is_wanted(where: Any, access: Access) -> bool:
    """As the words say it: whether it touches one address of them."""
    if where in (None, "all") or not where:
        return where is not None
    if access.table in ("file", "fifo"):
        number = access.file if access.table == "file" else access.address
        place, addresses = where.get(access.table + "s", []), range(number, number + 1)
    else:
        place = where.get(access.table, [])
        addresses = range(access.address, access.address + access.count)
    ranges = [place] if isinstance(place, range) else place
    return any(address in range_ for range_ in ranges for address in addresses)


@settings(max_examples=60)
@given(small_streams(), hook_places)
def test_hooks_for_ranges_get_accesses_to_their_ranges(stream: bytes, ranges: dict[str, Any]):
    """Against the same hooks, told of all: none of them changes or refuses anything."""
    calls: list[Told] = []
    for given_places in (ranges, dict.fromkeys(ranges, "all")):
        events: Told = []
        hooks: dict[str, Any] = {}
        for name, where in given_places.items():

            def note(access: Access, name: str = name, events: Told = events) -> None:
                events.append((name, access))

            if where is not None:
                hooks[name] = note if where == "all" else Hook(note, **where)
        end = End({1: make_device(SMALL, **hooks)}, "chunk")
        end.receive(stream)
        calls.append(events)
    assert calls[0] == [call for call in calls[1] if is_wanted(ranges[call[0]], call[1])]


def is_answered_in_c(device: Device, body: bytes, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Return True if C answers a request, alone and with others."""
    requests: list[bytes] = []

    def respond(device: Device, body: bytes, log: Any, caller: Any) -> bytes:
        requests.append(body)
        return b"\x83\1"

    with monkeypatch.context() as patch:
        patch.setattr(Device, "_respond", respond)
        End({1: device}, "chunk").receive(adu(body, 1) * 2)
        assert len(requests) in (0, 2)
        End({1: device}, "chunk").receive(adu(body, 1))
        assert len(requests) in (0, 3)
    return not requests


WRITE_READ = b"\x17" + in_words(100, 1, 300, 1) + b"\2\0\1"


@each_case(
    ("hooks", "in_c", "in_python"),
    [
        pytest.param(
            {name: print},
            [b"\1" + in_words(3, 8), b"\4" + in_words(2, 8), b"\3" + in_words(7, 8)],
            [
                b"\6" + in_words(7, 1),
                b"\x16" + in_words(7, 0, 0),
                WRITE_READ,
                b"\5" + in_words(3, 0),
            ],
            id=name,
        )
        for name in ("before_write", "after_write")
    ]
    + [
        pytest.param(
            {"before_read": print},
            [b"\6" + in_words(7, 1), b"\x16" + in_words(7, 0, 0), b"\5" + in_words(3, 0)],
            [b"\1" + in_words(3, 8), b"\4" + in_words(2, 8), b"\3" + in_words(7, 8), WRITE_READ],
            id="before_read",
        ),
        pytest.param(
            {"before_read": Hook(print, input_registers=range(100, 200))},
            [
                b"\4" + in_words(99, 1),
                b"\4" + in_words(200, 9),
                b"\3" + in_words(150, 1),
                WRITE_READ,
            ],
            [b"\4" + in_words(99, 2), b"\4" + in_words(199, 9), b"\4" + in_words(150, 1)],
            id="a range that is read",
        ),
        pytest.param(
            {"before_write": Hook(print, holding_registers=[range(20, 30), range(200, 210)])},
            [
                b"\6" + in_words(30, 1),
                b"\x16" + in_words(199, 0, 0),
                b"\x10" + in_words(30, 2) + b"\4" + bytes(4),
                b"\3" + in_words(20, 9),
                WRITE_READ,
            ],
            [
                b"\6" + in_words(29, 1),
                b"\x16" + in_words(200, 0, 0),
                b"\x10" + in_words(19, 2) + b"\4" + bytes(4),
                b"\x17" + in_words(100, 1, 209, 1) + b"\2\0\1",
            ],
            id="ranges that are written",
        ),
        pytest.param(
            {"after_write": Hook(print, holding_registers=range(300))},
            [WRITE_READ],
            [b"\6" + in_words(299, 1)],
            id="an end",
        ),
        pytest.param(
            {"handlers": {pdu.ReadHoldingRegisters: print}},
            [b"\6" + in_words(7, 1), b"\4" + in_words(2, 8), WRITE_READ],
            [b"\3" + in_words(7, 1), b"\3" + in_words(7, 0), b"\3"],
            id="a handler",
        ),
        pytest.param(
            {"before_write": Hook(print, coils=[]), "before_read": Hook(print, files=range(9))},
            [b"\5" + in_words(3, 0), b"\1" + in_words(3, 1)],
            [],
            id="nowhere",
        ),
    ],
)
def test_only_requests_with_hooks_or_handlers_are_answered_in_python(
    hooks, in_c, in_python, monkeypatch
) -> None:
    device = Device(Mapping(400, 400, 400, 400), **hooks)
    assert [is_answered_in_c(device, body, monkeypatch) for body in in_c] == [True] * len(in_c)
    assert not any(is_answered_in_c(device, body, monkeypatch) for body in in_python)


TOGETHER = pytest.mark.parametrize("connections", [1, 5], ids=["a chunk", "one each"])


def in_one_turn(devices: Any, requests: list[bytes], connections: int) -> list[bytes]:
    """Return the answers to requests of one connection, or of several in one turn."""
    ends = [End(devices, "chunk") for _ in range(connections)]
    for end in ends:
        end.share(ends[0])
    if connections == 1:
        ends[0].receive(b"".join(requests))
    else:
        for end, request in zip(ends, requests, strict=True):
            end.receive(request, is_last=end is ends[-1])
    return list(split(b"".join(bytes(end.sent) for end in ends)))


@TOGETHER
def test_a_hook_changes_what_the_next_request_of_the_turn_reads(connections: int) -> None:
    """The third of five needs Python, between units, and with one to the server itself."""
    first, second = make_device(), make_device()

    def change(access: Access) -> None:
        first.mapping.holding_registers[7] = second.mapping.holding_registers[7] = 99

    first = make_device(before_write=Hook(change, holding_registers=range(100, 101)))
    read, write = b"\3" + in_words(7, 1), b"\6" + in_words(100, 5)
    bodies = [(read, 1), (read, 2), (write, 1), (read, 0), (read, 2)]
    bodies_ = in_one_turn(
        {0: first, 1: first, 2: second},
        [adu(body, number, unit) for number, (body, unit) in enumerate(bodies)],
        connections,
    )
    answers = [b"\3\2\0\0", b"\3\2\0\0", write, b"\3\2\0\x63", b"\3\2\0\x63"]
    assert bodies_ == [
        adu(answer, number, unit)
        for number, (answer, (_, unit)) in enumerate(zip(answers, bodies, strict=True))
    ]


@TOGETHER
def test_a_hook_may_give_its_device_another_mapping(connections: int) -> None:
    def change(access: Access) -> None:
        device.mapping = Mapping(holding_registers={0: [50, 51]})

    hook = Hook(change, holding_registers=range(9, 10))
    device = Device(Mapping(holding_registers={0: range(10)}), before_write=hook)
    read, far, write = b"\3" + in_words(1, 1), b"\3" + in_words(5, 1), b"\6" + in_words(9, 5)
    requests = [adu(body, number) for number, body in enumerate([read, far, write, read, far])]
    answers = [request[7:] for request in in_one_turn({1: device}, requests, connections)]
    assert answers == [b"\3\2\0\1", b"\3\2\0\5", b"\x86\2", b"\3\2\0\x33", b"\x83\2"]
