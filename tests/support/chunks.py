"""A server's end of a connection, without the connection, and random requests for it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from libmodbus_py import Device, Mapping, pdu
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.trace import Trace
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.security.certificates import CertificateHolder
from libmodbus_py.server.framed import SessionSettings
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.service import SessionState
from libmodbus_py.server.sessions import ByChunk, ByFrame, Singles
from libmodbus_py.server.units import TcpUnits, Units

REPLIED = (1, 2, 3, 4, 5, 6, 15, 16, 22, 23)  # the functions that libmodbus answers from a mapping


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


def make_device(contents: Any = WHOLE, **options: Any) -> Device:
    return Device(Mapping(**contents), files={4: range(20)}, fifos={9: [1]}, **options)


class FakeChannel:
    """Calls the functions that it is given; see `libmodbus_py.server.service.Channel`."""

    def __init__(
        self,
        write: Callable[[bytes], object] = lambda data: None,
        follow: Callable[[], object] = lambda: None,
        trace: Trace | None = None,
    ) -> None:
        self.address = "peer"
        self.role: str | None = None
        self.holder: CertificateHolder | None = None
        self.trace = trace
        self.write = write
        self.follow = follow

    def hang_up(self) -> bool:
        return False


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
    requests = [b"\x0b", b"\x0c", *(bytes([8, 0, number, 0, 0]) for number in range(0x0B, 0x13))]
    return [device.answer(body) for body in requests]


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
    length = draw(st.sampled_from([size, size, size, (size + 1) & 0xFF, 0]))
    return bytes([function]) + draw(words) + count.to_bytes(2, "big") + bytes([length]) + data


@st.composite
def read_writes(draw: st.DrawFn) -> bytes:
    count = draw(st.integers(0, 122))
    length = draw(st.sampled_from([2 * count, 2 * count, 2 * count, 3]))
    read = draw(words) + draw(st.integers(0, 130)).to_bytes(2, "big")
    data = draw(st.binary(min_size=2 * count, max_size=2 * count))
    write = draw(words) + count.to_bytes(2, "big") + bytes([length & 0xFF])
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


def in_words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}H", *values)
