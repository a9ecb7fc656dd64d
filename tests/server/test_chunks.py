"""
Requests that are answered by the chunk, in C, against the same requests one by one.
"""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Access, Device, Hook, IllegalDataAddress, Mapping, pdu
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, cut, is_one_frame, split
from libmodbus_py.server.framed import SessionSettings
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.service import SessionState
from libmodbus_py.server.sessions import ByChunk, ByFrame, Singles
from libmodbus_py.server.units import TcpUnits, Units
from tests.support.cases import each_case
from tests.support.channels import FakeChannel
from tests.support.vectors import REQUESTS, FrameVector

REPLIED = (1, 2, 3, 4, 5, 6, 15, 16, 22, 23)
"""The functions that libmodbus answers from a mapping."""


BITS = [number % 3 == 0 for number in range(37)]

WHOLE = {
    "coils": {3: BITS},
    "discrete_inputs": {5: BITS[:35]},
    "holding_registers": {7: range(293)},
    "input_registers": {2: range(298)},
}
"""Small tables that do not begin at 0, so that most random addresses are beside them."""

HOLES = {
    "coils": {3: BITS[:10], 14: BITS[:5], 39: [True]},
    "discrete_inputs": {5: BITS[:3], 20: BITS[:15]},
    "holding_registers": {7: range(3), 11: range(50), 61: range(20), 299: [7]},
    "input_registers": {2: range(98), 200: range(100)},
}
"""The same from the first to the last address; one run touches another."""


def made_device(contents: Any = WHOLE, **options: Any) -> Device:
    return Device(Mapping(**contents), files={4: range(20)}, fifos={9: [1]}, **options)


class End:
    """A server's end of one connection, without the connection: bytes in, bytes out."""

    def __init__(self, devices: Any, kind: str, unknown: Any = "refuse") -> None:
        self.statistics = ServerStatistics()
        self.sent = bytearray()
        self.is_open = True
        self.calls: list[Callable[[], None]] = []
        units = TcpUnits(Units(devices, unknown))
        channel: Any = FakeChannel(self.write)
        settings = SessionSettings(parse("tcp://10.0.0.1"), self.statistics)
        if kind == "chunk":
            # Here every turn has one connection, which may be alone.
            singles = Singles(units, self.statistics, self.calls.append)
            self.session: Any = ByChunk(settings, units, channel, singles)
        else:
            self.session = ByFrame(settings, units, channel)

    def write(self, data: bytes) -> None:
        self.sent += data

    def share(self, other: End) -> None:
        """Be read in the same turn as another one."""
        self.session._singles = other.session._singles
        self.calls = other.calls

    def receive(self, data: bytes, *, is_last: bool = True) -> None:
        """Take bytes; the last one in a turn has all answers made."""
        if self.is_open and data:
            try:
                self.session.receive(data)
                while self.session.state is SessionState.BEHIND:
                    self.session.receive(b"")
            except FrameError:
                self.is_open = False
        while self.calls and is_last:
            self.calls.pop()()


@pytest.fixture(autouse=True)
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """ByFrame asks for the loop, and needs it on serial lines only."""
    monkeypatch.setattr("asyncio.get_running_loop", lambda: None)


def adu(body: bytes, transaction: int, unit: int = 1, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, 1 + len(body), unit) + body


def contents(device: Device) -> list[list[int]]:
    tables = device.mapping
    return [
        list(table)
        for table in (
            tables.coils,
            tables.discrete_inputs,
            tables.holding_registers,
            tables.input_registers,
        )
    ]


def notes(device: Device) -> list[bytes]:
    """Return the responses of functions 11 and 12, and all counters of function 8."""
    asked = [b"\x0b", b"\x0c", *(bytes([8, 0, number, 0, 0]) for number in range(0x0B, 0x13))]
    return [device.answer(body) for body in asked]


# --- random requests ---------------------------------------------------------------------------

words = st.one_of(st.integers(0, 320), st.integers(0, 0xFFFF)).map(lambda n: n.to_bytes(2, "big"))
counts = st.one_of(st.integers(0, 130), st.integers(0, 0xFFFF), st.sampled_from([1968, 1969, 2000]))


@st.composite
def reads(draw: st.DrawFn) -> bytes:
    count = draw(counts).to_bytes(2, "big")
    return bytes([draw(st.integers(1, 4))]) + draw(words) + count


@st.composite
def single_writes(draw: st.DrawFn) -> bytes:
    value = draw(st.one_of(words, st.sampled_from([b"\xff\x00", b"\x00\x00", b"\xff\x01"])))
    return bytes([draw(st.sampled_from([5, 6]))]) + draw(words) + value


@st.composite
def writes(draw: st.DrawFn) -> bytes:
    function = draw(st.sampled_from([15, 16]))
    count = draw(st.integers(0, 125))
    size = (count + 7) // 8 if function == 15 else 2 * count
    data = draw(st.binary(min_size=size, max_size=size))
    said = draw(st.sampled_from([size, size, size, (size + 1) & 0xFF, 0]))
    return bytes([function]) + draw(words) + count.to_bytes(2, "big") + bytes([said]) + data


@st.composite
def read_writes(draw: st.DrawFn) -> bytes:
    count = draw(st.integers(0, 122))
    said = draw(st.sampled_from([2 * count, 2 * count, 2 * count, 3]))
    read = draw(words) + draw(st.integers(0, 130)).to_bytes(2, "big")
    data = draw(st.binary(min_size=2 * count, max_size=2 * count))
    write = draw(words) + count.to_bytes(2, "big") + bytes([said & 0xFF])
    return b"\x17" + read + write + data


mask_writes = st.tuples(words, words, words).map(lambda parts: b"\x16" + b"".join(parts))

others = st.one_of(
    st.sampled_from([b"\x07", b"\x11", b"\x0b", b"\x0c", b"\x14\x07\x06\0\x04\0\x01\0\x02"]),
    st.binary(min_size=1, max_size=30),
)


@st.composite
def bodies(draw: st.DrawFn) -> bytes:
    """Mostly right requests; some cut or with bytes too many."""
    kinds = (reads(), single_writes(), writes(), read_writes(), mask_writes, others)
    body: bytes = draw(st.one_of(*kinds))[: pdu.MAX_PDU]
    change = draw(st.sampled_from([0, 0, 0, 0, -1, 1]))
    if change < 0 and len(body) > 1:
        body = body[: draw(st.integers(1, len(body) - 1))]
    return (body + b"\0" if change > 0 else body)[: pdu.MAX_PDU]


@st.composite
def streams(draw: st.DrawFn) -> bytes:
    frames = [
        adu(
            body,
            number,
            draw(st.sampled_from([1, 1, 1, 2, 9])),
            draw(st.sampled_from([0] * 9 + [7])),
        )
        for number, body in enumerate(draw(st.lists(bodies(), min_size=1, max_size=12)))
    ]
    return b"".join(frames)


def in_pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    ends = sorted({cut % (len(data) + 1) for cut in cuts} | {len(data)})
    return [data[start:end] for start, end in zip([0, *ends], ends, strict=False)]


@settings(max_examples=80)
@given(streams(), st.lists(st.integers(0, 4000), max_size=4), st.booleans())
def test_same_answers_contents_counters_and_statistics(
    stream: bytes, cuts: list[int], one_for_all: bool
) -> None:
    ends = []
    for kind in ("chunk", "frames"):
        first, second = made_device(HOLES), made_device()
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
def test_same_for_connections_that_send_one_request_each(
    asked: list[tuple[bytes, int]], cut: int
) -> None:
    """Together, as in one turn of the server; one of them may send a part, and then the rest."""
    states = []
    for kind in ("chunk", "frames"):
        hooked = made_device(before_write=lambda access: None)
        devices = {1: made_device(), 2: made_device(), 3: hooked}
        ends = [End(devices, kind) for _ in asked]
        if kind == "chunk":
            for end in ends:
                end.share(ends[0])
        requests = [adu(body, number, unit) for number, (body, unit) in enumerate(asked)]
        ends[0].receive(requests[0][:cut], is_last=False)
        requests[0] = requests[0][cut:]
        for end, request in zip(ends, requests, strict=True):
            end.receive(request, is_last=end is ends[-1])
        sent = [bytes(end.sent) for end in ends]
        counted = [end.statistics for end in ends]
        totals = [sum(each.requests for each in counted), sum(each.refused for each in counted)]
        tables = [contents(device) for device in devices.values()]
        states.append((sent, totals, tables, [notes(device) for device in devices.values()]))
    assert states[0] == states[1]


@settings(max_examples=30)
@given(streams(), st.lists(st.integers(0, 4000), max_size=4), st.sampled_from([WHOLE, HOLES]))
def test_hooks_change_no_answer(stream: bytes, cuts: list[int], holds: Any) -> None:
    """A device with hooks answers in Python what one without answers in C."""
    seen: list[Access] = []
    ends = []
    for hooks in ({}, {"before_read": seen.append, "before_write": seen.append}):
        device = made_device(holds, **hooks)
        end = End({1: device}, "chunk")
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        ends.append((bytes(end.sent), contents(device), notes(device), end.statistics))
    assert ends[0] == ends[1]


# --- hooks and handlers that want some of it ----------------------------------------------------

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
    asked = draw(st.lists(st.one_of(small_bodies(), small_bodies(), bodies()), max_size=12))
    return b"".join(adu(body, number) for number, body in enumerate(asked))


def in_words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


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


def hooked(wanted: dict[str, Any], functions: set[Any], told: Told) -> Device:
    """A device whose hooks note what they are told, move what is read, and refuse some."""

    def hook(name: str) -> Callable[[Access], None]:
        def call(access: Access) -> None:
            told.append((name, access))
            if access.address % 17 == 6:
                raise IllegalDataAddress
            if access.address % 19 == 10:
                raise ZeroDivisionError
            if name == "before_read" and access.table in HOLES:
                getattr(device.mapping, access.table)[access.address] = len(told) & 1

        return call

    def handle(request: Any) -> Any:
        told.append((str(request), Access("", 0, 0)))
        if isinstance(request, pdu.WriteRegister):
            return None
        return [1] * getattr(request, "read_count", getattr(request, "count", 0))

    hooks = {
        name: hook(name) if where == "all" else Hook(hook(name), **where)
        for name, where in wanted.items()
        if where is not None
    }
    device = made_device(SMALL, handlers=dict.fromkeys(functions, handle), **hooks)
    return device


@settings(max_examples=100)
@given(small_streams(), st.lists(st.integers(0, 4000), max_size=4), hook_places, handled)
def test_hooks_are_told_alike_both_ways(
    stream: bytes, cuts: list[int], wanted: dict[str, Any], functions: set[Any]
) -> None:
    ends = []
    for kind in ("chunk", "frames"):
        told: Told = []
        device = hooked(wanted, functions, told)
        end = End({1: device}, kind)
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        states = [contents(device), notes(device), told]
        ends.append((bytes(end.sent), states, end.statistics, end.is_open))
    assert ends[0] == ends[1]


@settings(max_examples=48)
@given(st.lists(small_bodies(), min_size=1, max_size=12), hook_places, handled)
def test_hooks_are_told_alike_of_requests_that_come_alone(
    asked: list[bytes], wanted: dict[str, Any], functions: set[Any]
) -> None:
    states = []
    for kind in ("chunk", "frames"):
        told: Told = []
        device = hooked(wanted, functions, told)
        ends = [End({1: device}, kind) for _ in asked]
        if kind == "chunk":
            for end in ends:
                end.share(ends[0])
        for number, (end, body) in enumerate(zip(ends, asked, strict=True)):
            end.receive(adu(body, number), is_last=end is ends[-1])
        sent = [bytes(end.sent) for end in ends]
        counted = [end.statistics for end in ends]
        totals = [sum(each.requests for each in counted), sum(each.refused for each in counted)]
        states.append((sent, totals, contents(device), notes(device), told))
    assert states[0] == states[1]


def is_wanted(where: Any, access: Access) -> bool:
    """As the words say it: whether it touches one address of them."""
    if where in (None, "all") or not where:
        return where is not None
    if access.table in ("file", "fifo"):
        number = access.file if access.table == "file" else access.address
        wanted, addresses = where.get(access.table + "s", []), range(number, number + 1)
    else:
        wanted = where.get(access.table, [])
        addresses = range(access.address, access.address + access.count)
    ranges = [wanted] if isinstance(wanted, range) else wanted
    return any(address in each for each in ranges for address in addresses)


@settings(max_examples=60)
@given(small_streams(), hook_places)
def test_hooks_are_told_of_what_touches_their_places(stream: bytes, wanted: dict[str, Any]) -> None:
    """Against the same hooks, told of all: none of them changes or refuses anything."""
    calls: list[Told] = []
    for given_places in (wanted, dict.fromkeys(wanted, "all")):
        told: Told = []
        hooks: dict[str, Any] = {}
        for name, where in given_places.items():

            def note(access: Access, name: str = name, told: Told = told) -> None:
                told.append((name, access))

            if where is not None:
                hooks[name] = note if where == "all" else Hook(note, **where)
        end = End({1: made_device(SMALL, **hooks)}, "chunk")
        end.receive(stream)
        calls.append(told)
    assert calls[0] == [each for each in calls[1] if is_wanted(wanted[each[0]], each[1])]


def is_answered_in_c(device: Device, body: bytes, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Both in a chunk and alone."""
    asked: list[bytes] = []

    def answer(device: Device, body: bytes, caller: Any) -> bytes:
        asked.append(body)
        return b"\x83\1"

    with monkeypatch.context() as patch:
        patch.setattr(Device, "answer", answer)
        End({1: device}, "chunk").receive(adu(body, 1) * 2)
        assert len(asked) in (0, 2)
        End({1: device}, "chunk").receive(adu(body, 1))
        assert len(asked) in (0, 3)
    return not asked


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
def test_only_what_hooks_and_handlers_want_is_answered_in_python(
    hooks: dict[str, Any],
    in_c: list[bytes],
    in_python: list[bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device = Device(Mapping(400, 400, 400, 400), **hooks)
    assert [is_answered_in_c(device, body, monkeypatch) for body in in_c] == [True] * len(in_c)
    assert not any(is_answered_in_c(device, body, monkeypatch) for body in in_python)


# --- holes --------------------------------------------------------------------------------------


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
def test_holes_are_answered_with_exception_2_and_stay_as_they_are(body: bytes) -> None:
    """Other reasons for a refusal take precedence."""
    everything = Device(Mapping(65536, 65536, 65536, 65536))
    devices = [made_device(HOLES), made_device(HOLES, before_write=lambda access: None)]
    table = getattr(devices[0].mapping, TABLE_OF.get(body[0], "holding_registers"))
    exists = {address for each in table.ranges for address in each}
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
def test_same_for_bytes_that_are_no_requests(data: bytes, cuts: list[int]) -> None:
    """Where a length makes no sense both stop, and what came before is answered."""
    stream = adu(b"\x03\0\x07\0\x01", 1) + data
    ends = []
    for kind in ("chunk", "frames"):
        end = End({1: made_device()}, kind)
        for piece in in_pieces(stream, cuts):
            end.receive(piece)
        ends.append((bytes(end.sent), end.is_open, end.statistics.requests))
    assert ends[0] == ends[1]


def test_the_event_log_has_the_latest_of_many_requests() -> None:
    """64 events are 32 requests; which of them were refused has no short period."""
    states = []
    for kind in ("chunk", "frames"):
        device = made_device()
        end = End({1: device}, kind)
        for number in range(100):
            address = 7 if number % 7 and number % 5 else 0
            end.receive(adu(bytes([3, 0, address, 0, 1]), number))
        states.append(notes(device))
    assert states[0] == states[1]


# --- worked examples ---------------------------------------------------------------------------


def replied_vectors() -> list[FrameVector]:
    return [vector for vector in REQUESTS if vector.function in REPLIED]


def test_all_functions_of_libmodbus_are_answered_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by the way around, which would give the same answers."""
    monkeypatch.delattr(Device, "answer")
    device = Device(Mapping(65536, 65536, 65536, 65536))
    vectors = replied_vectors()
    assert {vector.function for vector in vectors} == set(REPLIED)
    end = End(device, "chunk")
    for vector in vectors:
        end.receive(vector.tcp)
    assert end.statistics.requests == len(vectors)
    assert end.statistics.refused == 0


def test_illegal_values_are_refused_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(Device, "answer")
    end = End(made_device(), "chunk")
    for function in REPLIED:
        end.receive(adu(bytes([function, 0]), function))
    assert end.sent == b"".join(
        struct.pack(">HHHBBB", function, 0, 3, 1, function | 0x80, 3) for function in REPLIED
    )
    assert (end.statistics.requests, end.statistics.refused) == (len(REPLIED), len(REPLIED))


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
    ],
)
def test_counts_at_their_limits(
    body: bytes, is_good: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(Device, "answer", raising=False)
    end = End(Device(Mapping(65536, 65536, 65536, 65536)), "chunk")
    end.receive(adu(body, 1))
    refusal = bytes([body[0] | 0x80, 3])
    assert (end.sent == adu(refusal, 1)) is not is_good
    assert end.statistics.requests == 1


@each_case(
    "body",
    [
        b"\x0f\0\0\0\x09\x01\0",
        b"\x0f\0\0\0\x08\x02\0\0",
        b"\x10\0\0\0\x01\x01\0\0",
        b"\x10\0\0\0\x01\x02\0\0\0",
        b"\x17\0\0\0\x01\0\0\0\x01\x03\0\0",
        b"\x17\0\0\0\x01\0\0\0\x01\x02\0\0\0",
        b"\x17\0\0\0\x01\0\0\0\x01\x02\0",
    ],
    ids=lambda body: body.hex(),
)
def test_a_byte_count_that_is_not_what_follows(
    body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(Device, "answer", raising=False)
    end = End(Device(Mapping(65536, 65536, 65536, 65536)), "chunk")
    end.receive(adu(body, 1))
    assert end.sent == adu(bytes([body[0] | 0x80, 3]), 1)


def test_nothing_beside_a_table_is_touched_whatever_libmodbus_checks(
    compiled: Callable[[str], Path],
) -> None:
    """
    3.1.6 as released writes in front of the table (CVE-2022-0367), Debian's is patched: here
    it is a modbus_reply that checks no address at all.
    """
    done = subprocess.run([compiled("beside")], capture_output=True, text=True, timeout=50)
    assert done.stderr == ""
    assert done.returncode == 0
    # 40 items: singles (5, 6, 22) for each of 6 counts; of 1, 2, 39 and 40 items so many
    # first addresses are right for 8 others (23 twice).
    executed = 3 * 6 * 40 + 8 * (40 + 39 + 2 + 1)
    assert done.stdout == f"{65536 * 6 * 11 - executed} refused, {executed} executed\n"


# --- more than one call has room for ----------------------------------------------------------


def test_more_answers_than_one_call_has_room_for() -> None:
    """A thousand of the longest answers are 259 000 bytes."""
    device = made_device()
    end = End(device, "chunk")
    end.receive(b"".join(adu(b"\x03\0\x07\0\x7d", number) for number in range(1000)))
    answer = device.answer(b"\x03\0\x07\0\x7d")
    assert end.sent == b"".join(adu(answer, number) for number in range(1000))


TOGETHER = pytest.mark.parametrize("connections", [1, 5], ids=["a chunk", "one each"])


def in_one_turn(devices: Any, asked: list[bytes], connections: int) -> list[bytes]:
    """Return the answers to requests of one connection, or of several in one turn."""
    ends = [End(devices, "chunk") for _ in range(connections)]
    for end in ends:
        end.share(ends[0])
    if connections == 1:
        ends[0].receive(b"".join(asked))
    else:
        for end, request in zip(ends, asked, strict=True):
            end.receive(request, is_last=end is ends[-1])
    return list(split(b"".join(bytes(end.sent) for end in ends)))


@TOGETHER
def test_a_hook_changes_what_the_next_request_of_the_turn_reads(connections: int) -> None:
    """The third of five needs Python, between units, and with one to the server itself."""
    first, second = made_device(), made_device()

    def change(access: Access) -> None:
        first.mapping.holding_registers[7] = second.mapping.holding_registers[7] = 99

    first = made_device(before_write=Hook(change, holding_registers=range(100, 101)))
    read, write = b"\3" + in_words(7, 1), b"\6" + in_words(100, 5)
    bodies = [(read, 1), (read, 2), (write, 1), (read, 0), (read, 2)]
    found = in_one_turn(
        {0: first, 1: first, 2: second},
        [adu(body, number, unit) for number, (body, unit) in enumerate(bodies)],
        connections,
    )
    answers = [b"\3\2\0\0", b"\3\2\0\0", write, b"\3\2\0\x63", b"\3\2\0\x63"]
    assert found == [
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
    asked = [adu(body, number) for number, body in enumerate([read, far, write, read, far])]
    answers = [each[7:] for each in in_one_turn({1: device}, asked, connections)]
    assert answers == [b"\3\2\0\1", b"\3\2\0\5", b"\x86\2", b"\3\2\0\x33", b"\x83\2"]


# --- headers -----------------------------------------------------------------------------------


@each_case("length", [*range(10), *range(250, 260), 0x1FE, 0xFFFF])
@each_case("protocol", [0, 1, 0xFF00])
def test_c_and_python_agree_on_headers(protocol: int, length: int) -> None:
    """What C answers is a frame for Python, too; a frame that C leaves is not complete yet."""
    request = bytes.fromhex("03 0007 0001")
    data = struct.pack(">HHHB", 1, protocol, length, 1) + request.ljust(300, b"\0")
    device = made_device()
    end, *_ = device.answer_chunk(data, 0, 1)
    found: list[Any] = []
    try:
        cut_at = cut(data, 0, found, 1)
    except FrameError:
        cut_at = 0
    is_frame = bool(found) and isinstance(found[0], Frame)
    is_whole = 6 + length <= len(data)
    assert (end > 0) is (is_frame and is_whole)
    assert end in (0, cut_at)
    assert is_one_frame(data[: 6 + length]) is (is_frame and is_whole)


@given(st.lists(bodies(), min_size=1, max_size=5))
def test_a_chunk_is_split_as_it_is_cut(asked: list[bytes]) -> None:
    frames = [adu(body, number) for number, body in enumerate(asked)]
    assert list(split(b"".join(frames))) == frames
    found: list[Any] = []
    assert cut(b"".join(frames), 0, found, 99) == len(b"".join(frames))
    assert [each.pdu for each in found] == asked
