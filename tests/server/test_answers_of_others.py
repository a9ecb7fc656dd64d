"""Servers on a line with other units, whose frames are neither carried out nor damage."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from libmodbus_py import Client, Gateway, Route
from libmodbus_py.ports.schemes import SCHEMES, TRANSPORTS
from tests.simulation.lan import Lan, LineEnd
from tests.support.driver import ascii_frame, rtu
from tests.support.framing import NO_REQUESTS
from tests.support.lan_server import unit_one
from tests.support.urls import url_for

WRITE = rtu("01 06 0001 0003")
READ = rtu("01 03 0001 0001")
LINE = "rtu:///dev/line?baudrate=115200"

# What unit 2 is asked, and what it answers; a whole write to unit 1 is in each of the two first.
TRAFFIC = [
    (rtu("02 03 0000 0004"), rtu("02 03 08" + WRITE.hex())),
    (rtu("02 08 0000" + WRITE.hex()), rtu("02 08 0000" + WRITE.hex())),
    (rtu("02 06 0000 0001"), rtu("02 06 0000 0001")),
    (rtu("02 10 0000 0001 02 0007"), rtu("02 10 0000 0001")),
    (rtu("02 11"), rtu("02 11 02 07 FF")),
    (rtu("02 03 0000 0001"), rtu("02 83 02")),
    (rtu("02 00"), rtu("02 80 01")),
]


LINES = {
    scheme: (rtu if framing == "rtu" else ascii_frame, TRANSPORTS[transport])
    for scheme, (framing, transport) in SCHEMES.items()
    if framing in ("rtu", "ascii") and not TRANSPORTS[transport].is_listening
}
"""Scheme -> what makes its frames, and the rules of its transport."""

each_line = pytest.mark.parametrize("scheme", LINES)
STREAMS = [entry for entry, (_, rules) in LINES.items() if not rules.is_datagram]
each_stream = pytest.mark.parametrize("scheme", STREAMS)


def place_on(scheme: str) -> str:
    """Return the URL of a server."""
    return url_for(scheme, "10.0.0.1:1502", line="/dev/line?baudrate=115200")


def pieces(data: bytes, count: int) -> list[bytes]:
    size = -(-len(data) // count)
    return [data[at : at + size] for at in range(0, len(data), size)]


@contextmanager
def saying(lan: Lan, url: str) -> Iterator[Callable[..., bytes]]:
    """Yield what writes something, in so many pieces, and returns what is answered."""
    if "/dev/line" in url:
        master = LineEnd(lan.line("/dev/line"))

        def say(data: bytes, count: int = 1) -> bytes:
            master.heard = b""
            for piece in pieces(data, count):
                master.write(piece)
                lan.pass_time(0.001)
            lan.pass_time(2)
            return master.heard

        yield say
        return
    with lan.client(url) as client:

        def send(data: bytes, count: int = 1) -> bytes:
            for piece in pieces(data, count):
                client.sendall(piece)
                lan.pass_time(0.001)
            lan.pass_time(2)
            answer = b""
            while client.has_input():
                answer += client.recv(300)
            return answer

        yield send


def damaged(frame: bytes) -> bytes:
    """Return a frame with another CRC or LRC."""
    if not frame.startswith(b":"):
        return frame[:-1] + bytes([frame[-1] ^ 1])
    return frame[:-3] + (b"1" if frame[-3:-2] == b"0" else b"0") + frame[-2:]


@pytest.mark.parametrize(
    "scheme", [item for item, (code, rules) in LINES.items() if code is rtu and not rules.is_serial]
)
def test_answers_of_other_units_in_one_connection_count_no_error(lan: Lan, scheme: str) -> None:
    """As a serial device server passes them on that hears its own line."""
    url = place_on(scheme)
    with unit_one(url) as (server, writes), saying(lan, url) as say:
        for request, answer in TRAFFIC:
            assert say(request) == b""
            assert say(answer) == b""
            assert say(READ) == rtu("01 03 02 0000"), request.hex()
        assert writes == []
        assert server.statistics.bad_frames == 0


@pytest.mark.parametrize("pause", [0.0, 0.002, 0.03])
def test_a_clean_line_with_other_units_counts_no_error(lan: Lan, pause: float) -> None:
    with unit_one(LINE) as (server, writes):
        master, other = LineEnd(lan.line("/dev/line")), LineEnd(lan.line("/dev/line"))
        for request, answer in TRAFFIC:
            master.heard = b""
            for end, data in ((master, request), (other, answer), (master, READ)):
                end.write(data)
                lan.pass_time(max(pause, len(data) * 11 / 115200))
            lan.pass_time(0.1)
            assert master.heard == answer + rtu("01 03 02 0000"), request.hex()
        assert writes == []
        assert server.statistics.bad_frames == 0
        assert server.statistics.requests == 2 * len(TRAFFIC)
        # Of unit 1: frames on the line and damage (application protocol, 6.8).
        for counter, count in ((0x0B, 3 * len(TRAFFIC) + 1), (0x0C, 0)):
            master.heard = b""
            master.write(rtu(f"01 08 00{counter:02X} 0000"))
            lan.pass_time(0.1)
            assert master.heard == rtu(f"01 08 00{counter:02X} {count:04X}")


@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize(
    ("scheme", "count"), [*((line, 1) for line in LINES), *((stream, 3) for stream in STREAMS)]
)
def test_a_valid_frame_that_is_no_request_is_neither_answered_nor_counted_as_damage(
    lan: Lan, scheme: str, count: int, is_gateway: bool
) -> None:
    """In one piece or in three; with a right CRC it is of another unit, or of no unit."""
    encode, url = LINES[scheme][0], place_on(scheme)
    with unit_one(url, is_gateway=is_gateway) as (server, writes), saying(lan, url) as say:
        for body, unit in itertools.product(NO_REQUESTS, (0, 1, 2)):
            assert say(encode(f"{unit:02X} {body}"), count) == b"", (body, unit)
            assert say(encode("01 03 0001 0001")) == encode("01 03 02 0000"), (body, unit)
        assert server.statistics.bad_frames == 0
        assert writes == []
        assert say(encode("01 08 000C 0000")) == encode("01 08 000C 0000")


@each_line
def test_a_gateway_passes_on_no_frame_that_is_no_request(lan: Lan, scheme: str) -> None:
    encode, url = LINES[scheme][0], place_on(scheme)
    with unit_one(url, is_gateway=True) as (gateway, _), saying(lan, url) as say:
        for body, unit in itertools.product([*NO_REQUESTS, "03 0001 0001"], (0, 1, 2)):
            say(encode(f"{unit:02X} {body}"))
        units = [unit for line in gateway.traffic.lines.values() for unit in line.units.values()]
        assert [unit.requests for unit in units] == [1]


@each_stream
@pytest.mark.parametrize("unit", [1, 2])
def test_damage_with_a_refused_function_is_counted(lan: Lan, scheme: str, unit: int) -> None:
    """A function of 80h or more and a wrong CRC."""
    encode, url = LINES[scheme][0], place_on(scheme)
    with unit_one(url) as (server, _), saying(lan, url) as say:
        assert say(damaged(encode(f"{unit:02X} 80"))) == b""
        assert say(encode("01 03 0001 0001")) == encode("01 03 02 0000")
        assert server.statistics.bad_frames == 1


def test_a_gateway_ignores_frames_of_other_units_too(lan: Lan) -> None:
    """The gateway is a unit on this line."""
    with unit_one(LINE, is_gateway=True) as (gateway, writes):
        master, other = LineEnd(lan.line("/dev/line")), LineEnd(lan.line("/dev/line"))
        for request, answer in TRAFFIC:
            for end, data in ((master, request), (other, answer)):
                end.write(data)
                lan.pass_time(0.03)
        assert gateway.statistics.bad_frames == 0
        assert writes == []
        master.heard = b""
        master.write(READ)
        lan.pass_time(0.5)
        assert master.heard == rtu("01 03 02 0000")


@pytest.mark.parametrize("head", ["08 0000", "2B 0D", "41"])
def test_a_read_that_contains_a_write_frame_writes_nothing_through_a_gateway(lan: Lan, head: str):
    """Nothing but reads and loopbacks may pass; the units behind are on one line."""
    route = Route("rtu:///dev/line?baudrate=115200&timeout=0.1", read_only=True)
    with (
        unit_one(LINE) as (server, writes),
        Gateway([route]).background("tcp://10.0.0.1:0") as running,
        Client(running.urls[0], unit=2, timeout=5) as context,
    ):
        for unit in (1, 2):
            # Where the CRC fits for the first time, a write begins.
            body = rtu(f"{unit:02X}{head}")[1:] + WRITE * 5
            with lan.client(running.urls[0]) as client:
                client.sendall(bytes([0, 1, 0, 0, 0, len(body) + 1, unit]) + body)
                assert len(client.receive(9)) == 9
        assert context.for_unit(1).read_holding_registers(1, 1) == [0]
        assert writes == []
        assert server.statistics.bad_frames == 0


@each_line
def test_a_loopback_whose_data_contain_a_write_is_returned_unchanged(lan: Lan, scheme: str) -> None:
    encode, url = LINES[scheme][0], place_on(scheme)
    write = encode("01 06 0001 0003")
    with unit_one(url) as (server, writes), saying(lan, url) as say:
        for data in (b"\1\2", write * 2, write * 10):
            frame = encode("01 08 0000" + data.hex())
            assert say(frame) == frame
        assert writes == []
        assert server.statistics.bad_frames == 0


@each_stream
@pytest.mark.parametrize("is_gateway", [False, True])
def test_only_the_last_request_without_a_pause_is_answered(lan: Lan, scheme: str, is_gateway):
    """All arrived before the server read them: only the last can still be awaited."""
    frame, url = LINES[scheme][0], place_on(scheme)
    requests = [frame(f"01 06 0001 {number:04X}") for number in (5, 6, 7)]
    with unit_one(url, is_gateway=is_gateway) as (_, writes), saying(lan, url) as say:
        assert say(b"".join(requests)) == frame("01 06 0001 0007")
        assert writes[-1].values == (7,)


@each_stream
def test_a_request_to_another_unit_cancels_a_delayed_answer(lan: Lan, scheme: str):
    frame, url = LINES[scheme][0], place_on(scheme)
    mine, other = frame("01 03 0001 0001"), frame("02 03 0000 0001")
    with unit_one(url), saying(lan, url) as say:
        assert say(mine + other) == b""
        assert say(mine + other + mine) == frame("01 03 02 0000")
