"""The server on UDP: one request in a datagram, its answer in another to whoever asked."""

import contextlib
import gc
from collections.abc import Callable, Iterator

import pytest

from libmodbus_py import Device, Fault, Mapping, Server, framing
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.schemes import SCHEMES, TRANSPORTS
from libmodbus_py.server import limits
from libmodbus_py.server import udp as source_module
from libmodbus_py.server.limits import Address, Allowance, Limits, ServerStatistics
from libmodbus_py.server.udp import Sources
from tests.simulation.lan import Lan, LanClient
from tests.support import attacks, vectors
from tests.support.attacks import READ_MOST, READ_ONE, UNIT, adu, connect
from tests.support.cases import each_case
from tests.support.driver import ascii_frame, rtu, tcp
from tests.support.lan_server import ANSWER_MOST, ANSWER_ONE, NEVER, OTHER, ask, server_on, unit_one
from tests.support.names import NEEDS_IPV6

READ, ANSWER = bytes.fromhex("03 0064 0002"), bytes.fromhex("03 04 03e8 03e9")

OTHER_MACHINES = ("192.0.2.1", "2001:db8::1", "::ffff:192.0.2.1")


@pytest.mark.parametrize(
    "url", ["udp://127.0.0.1:0", pytest.param("udp://[::1]:0", marks=NEEDS_IPV6)]
)
def test_answers_go_to_the_sender_and_have_the_id_of_the_request(url, device: Device) -> None:
    other, other_answer = bytes.fromhex("03 0066 0002"), bytes.fromhex("03 04 03ea 03eb")
    server = Server({UNIT: device})
    with (
        server.background(url) as running,
        connect(running.urls[0]) as first,
        connect(running.urls[0]) as second,
    ):
        for transaction in (0, 1, 0x1234, 0xFFFF):
            attacks.ask(first, adu(READ, transaction), adu(ANSWER, transaction))
        # All under way at once; loopback keeps the order.
        for transaction in range(50):
            first.send(adu(READ, transaction))
        answers = [first.recv(1000) for _ in range(50)]
        assert answers == [adu(ANSWER, transaction) for transaction in range(50)]
        # With the same transaction, at the same time, for other values.
        for _ in range(100):
            first.send(adu(READ))
            second.send(adu(other))
            assert second.recv(1000) == adu(other_answer)
            assert first.recv(1000) == adu(ANSWER)
        assert server.statistics.requests == 254
        assert server.statistics.connections == server.statistics.accepted == 0


def answer(client: LanClient, pdu: bytes, transaction: int = 1) -> bytes:
    client.send(adu(pdu, transaction))
    return client.recv(1000)


WORKED = [vector.values[0] for vector in vectors.rows(vectors.REQUESTS)]

LONGEST = bytes.fromhex("10 0000 007b f6") + bytes(246)


def test_the_longest_request_and_the_longest_answer_fit_into_datagrams(lan: Lan) -> None:
    with server_on(lan, scheme="udp") as server, server.connect() as client:
        assert answer(client, LONGEST) == adu(LONGEST[:5])
        assert answer(client, READ_MOST) == adu(ANSWER_MOST)


@pytest.mark.parametrize("faulty", [False, True])
def test_worked_requests_are_answered_as_on_tcp(lan: Lan, subtests: pytest.Subtests, faulty):
    """The same device as on TCP, and that the answer is of this request."""
    faults = {None: [Fault("no_answer", function=100)]} if faulty else None
    for number, vector in enumerate(WORKED):
        with subtests.test(number=number, vector=vector):
            answers = []
            for scheme in ("udp", "tcp"):
                server = Server(Device(Mapping(65536, 65536, 65536, 65536)), faults=faults)
                with server.background(f"{scheme}://127.0.0.1:0") as running:
                    client = lan.client(running.urls[0], "127.0.0.1")
                    client.sendall(vector.tcp)
                    answers.append(client.recv(1000))
            assert answers[0] == answers[1]
            (frame,) = framing.TcpFramer().feed(answers[0])
            assert (frame.unit, frame.transaction) == (vector.unit, vector.transaction)
            assert frame.pdu[0] & 0x7F == vector.function


@pytest.mark.parametrize("allow", ["10.255.0.2/32", "2001:db8::/32"])
def test_hosts_that_are_not_allowed_get_no_answer(lan: Lan, allow: str) -> None:
    with server_on(lan, scheme="udp", allow=[allow]) as server, server.connect() as client:
        client.send(adu(READ_ONE))
        lan.pass_time(60)
        assert not client.has_input()
        assert server.counts(disallowed=1, requests=0)


def test_too_many_requests_are_dropped_for_one_address_only(lan: Lan) -> None:
    with (
        server_on(lan, scheme="udp", requests_per_second=5) as server,
        server.connect() as eager,
        server.connect(OTHER) as other,
    ):
        start = lan.now
        for transaction in range(200):
            eager.send(adu(READ_ONE, transaction))
        assert lan.until(lambda: server.statistics.requests + server.statistics.throttled == 200)
        # Five are free, and the one that overdraws is answered.
        assert lan.now - start < 0.01
        assert server.statistics.requests == 6
        ask(other, 500)
        answers = [eager.recv(1000) for _ in range(6)]
        assert answers == [adu(ANSWER_ONE, transaction) for transaction in range(6)]
        eager.send(adu(READ_ONE, 599))
        lan.pass_time(0.21)  # after a fifth of a second it may ask again
        assert not eager.has_input()
        ask(eager, 600)


WRITE = bytes.fromhex("06 0064 0007")  # its answer has the same bytes
QUERY = bytes.fromhex("08 0000 1234")
MASK = bytes.fromhex("16 0064 00f2 0025")


@pytest.mark.parametrize("pdu", [WRITE, QUERY, MASK], ids=["write", "query", "mask"])
def test_a_server_does_not_answer_itself_for_ever(lan: Lan, pdu: bytes, device: Device) -> None:
    server = Server({UNIT: device})
    with server.background("udp://127.0.0.1:0", "udp://127.0.0.1:0") as running:
        first, second = (("127.0.0.1", parse(url).port) for url in running.urls)
        for source, target in ((first, first), (first, second), (second, first)):
            lan.send_datagram(adu(pdu), source, target)
        assert lan.until(lambda: server.statistics.reflected == 3)
        requests = server.statistics.requests
        lan.pass_time(3600)
        assert server.statistics.reflected == 3
        assert server.statistics.requests == requests <= 3 * 13


def test_two_servers_do_not_answer_each_other_for_ever(lan: Lan) -> None:
    with server_on(lan, scheme="udp") as one, server_on(lan, scheme="udp") as other:
        servers, places = (one, other), (one.place, other.place)
        for transaction in range(10):
            for source, target in (places, places[::-1]):
                lan.send_datagram(adu(WRITE, transaction), source, target)
        lan.pass_time(1)
        assert sum(server.statistics.reflected for server in servers) == 20
        before = [server.statistics.requests for server in servers]
        assert sum(before) <= 20 * 24
        lan.pass_time(3600)
        assert [server.statistics.requests for server in servers] == before


@pytest.mark.parametrize("pdu", [WRITE, QUERY, MASK], ids=["write", "query", "mask"])
def test_a_returned_answer_is_not_answered_without_end(lan: Lan, pdu: bytes) -> None:
    with server_on(lan, scheme="udp") as server, server.connect() as client:
        client.settimeout(500)
        datagram = adu(pdu)
        with contextlib.suppress(TimeoutError):
            for _ in range(1000):
                client.send(datagram)
                datagram = client.recv(1000)
        # One, and ten in a second, and who overdraws.
        assert server.counts(requests=12, reflected=1)
        assert answer(client, pdu, 2) == adu(pdu, 2)


def test_clients_that_write_or_repeat_a_request_are_answered(lan: Lan) -> None:
    with server_on(lan, scheme="udp") as server, server.connect() as client:
        for transaction in range(300):
            assert answer(client, WRITE, transaction) == adu(WRITE, transaction)
        for _ in range(300):  # some never count
            ask(client, 0)
        for _ in range(4):
            assert answer(client, WRITE, 9) == adu(WRITE, 9)
        assert server.counts(requests=604, reflected=0)


@pytest.mark.parametrize("source", [502, 802, None], ids=str)
def test_a_client_may_send_from_the_ports_of_modbus_and_of_the_server(lan: Lan, source) -> None:
    with server_on(lan, scheme="udp") as server:
        for transaction in range(30):
            place = ("10.0.0.9", source or server.place[1])
            lan.send_datagram(adu(WRITE, transaction), place, server.place)
        assert server.counts(requests=30, reflected=0)


def test_a_client_that_repeats_one_write_quickly_is_dropped_once_in_a_while(lan: Lan) -> None:
    with server_on(lan, scheme="udp") as server, server.connect() as client:
        for _ in range(48):
            client.send(adu(WRITE))
        assert server.counts(requests=45, reflected=3)


@each_case(
    ("host", "rate", "at_once", "later"),
    [
        *((host, None, 1001, 100) for host in OTHER_MACHINES),
        *((host, 200, 201, 20) for host in OTHER_MACHINES),
        *((host, 5000, 3000, 2501) for host in OTHER_MACHINES),
        *(
            (host, None, 3000, 3000)
            for host in ("127.0.0.1", "127.9.9.9", "::1", "::ffff:127.0.0.1")
        ),
    ],
)
def test_addresses_of_other_machines_get_no_more_than_a_thousand_answers_a_second(
    lan: Lan, host: str, rate: int | None, at_once: int, later: int
) -> None:
    """None of them is on this machine, so nothing is sent."""

    async def made() -> Sources:
        return Sources(Limits(requests_per_second=rate), ServerStatistics())

    def admitted() -> int:
        return sum(sources.admit(adu(READ, number), (host, 40_000)) for number in range(3000))

    sources = lan.wait(made())
    assert admitted() == at_once
    lan.pass_time(0.1)
    assert admitted() == later


async def test_memory_for_many_forged_sources_is_bounded(monkeypatch) -> None:
    monkeypatch.setattr(source_module, "REMEMBERED_MAX", 300)
    monkeypatch.setattr(limits, "REMEMBERED_MAX", 200)

    def remembered(kind: type) -> int:
        gc.collect()
        return sum(isinstance(get_object, kind) for get_object in gc.get_objects())

    sources = Sources(Limits(), ServerStatistics())
    before = remembered(Address), remembered(Allowance)
    for number in range(2000):
        source = (f"10.0.{number >> 8}.{number & 255}", 40_000)
        datagram = adu(WRITE)
        assert sources.admit(datagram, source)
        sources.note_answer(datagram, datagram[7:], source)
    assert remembered(Address) - before[0] == 200
    assert remembered(Allowance) - before[1] == 200 + 300


def test_a_delayed_answer_does_not_delay_the_others(lan: Lan) -> None:
    faults = {UNIT: [Fault("delay", seconds=300, every=2)]}
    with (
        server_on(lan, scheme="udp", faults=faults) as server,
        server.connect() as client,
        server.connect() as other,
    ):
        ask(client, 1)
        start = lan.now
        client.send(adu(READ_ONE, 2))
        ask(other, 3)
        assert lan.now - start < 0.01
        assert client.recv(1000) == adu(ANSWER_ONE, 2)
        assert lan.now - start == pytest.approx(300, abs=0.01)


@pytest.mark.parametrize(
    ("fault", "response"),
    [
        (Fault("exception", code=6), adu(b"\x83\x06", 7)),
        (Fault("wrong_transaction"), adu(ANSWER_ONE, 6)),
        (Fault("wrong_unit"), adu(ANSWER_ONE, 7, UNIT + 1)),
        (Fault("truncate", length=9), adu(ANSWER_ONE, 7)[:9]),
        (Fault("wrong_check"), adu(ANSWER_ONE, 7, length=0)),
    ],
    ids=lambda value: value.kind if isinstance(value, Fault) else "",
)
def test_faults_change_answers_to_datagrams(lan: Lan, fault: Fault, response: bytes) -> None:
    faults = {None: [fault]}
    with server_on(lan, scheme="udp", faults=faults) as server, server.connect() as client:
        for _ in range(3):
            assert answer(client, READ_ONE, 7) == response


def test_a_server_closes_at_once_while_answers_are_delayed(lan: Lan) -> None:
    faults = {None: [Fault("delay", seconds=600)]}
    with server_on(lan, scheme="udp", faults=faults) as server, server.connect() as client:
        client.send(adu(READ_MOST))
        assert server.counts(requests=1)
        start = lan.now
    assert lan.now - start < 0.01


def test_the_number_of_delayed_answers_is_limited(lan: Lan, monkeypatch) -> None:
    """Requests that arrive meanwhile are lost."""
    monkeypatch.setattr(source_module, "REMEMBERED_MAX", 100)
    faults = {None: [Fault("delay", seconds=600)]}
    with server_on(lan, scheme="udp", faults=faults) as server, server.connect() as client:
        for number in range(120):
            client.send(adu(READ_ONE, number))
        assert server.counts(requests=100)
        lan.pass_time(600)
        client.send(adu(READ_ONE, 2000))
        assert server.counts(requests=101)


FRAMES: dict[str, Callable[[str], bytes]] = {
    "rtu": rtu,
    "ascii": ascii_frame,
    "udp": lambda text: tcp(bytes(2), text[2:], unit=int(text[:2], 16)),
}

DATAGRAMS: dict[str, Callable[[str], bytes]] = {
    scheme: FRAMES[framing]
    for scheme, (framing, transport) in SCHEMES.items()
    if TRANSPORTS[transport].is_datagram
}
"""Scheme -> what makes its frames."""

# Requests to the unit that answers and to another, a broadcast, and answers of another unit.
BODIES = ["01 03 0000 0001", "02 03 0000 0001", "00 06 0001 0003", "02 10 0000 0001 02 0007"]
ANSWERS = ["02 80 02", "02 83 02", "02 03 02 0007", "02 11 02 07 FF"]


NO_MBAP = [
    adu(READ) + b"\x00",
    adu(READ, 8) + adu(READ, 9),
    b"\0\1\0\7" + adu(READ)[4:],  # another protocol
    adu(READ)[:4] + b"\0\0" + adu(READ)[6:],  # lengths that cannot be
    adu(READ)[:4] + b"\0\1" + adu(READ)[6:7],
    adu(bytes([3]) + bytes(253)),
    adu(LONGEST) + bytes(253),
    adu(READ) + bytes(60_000),  # longer than is read
    rtu("01 03 0000 0001"),
    adu(READ)[:7],  # the two halves of one request
    adu(READ)[7:],
]


def damaged(scheme: str) -> Iterator[bytes]:
    """Yield what is not a frame: each frame up to each of its bytes, and with a wrong check."""
    encode = DATAGRAMS[scheme]
    if scheme == "udp":
        yield from NO_MBAP
    for body in BODIES + ANSWERS:
        frame = encode(body)
        yield from (frame[:size] for size in range(1, len(frame)))
        if "+" in scheme:
            yield frame[:-3] + bytes([frame[-3] ^ 1]) + frame[-2:]
    yield b"\xff"


@pytest.mark.parametrize(
    "settings",
    [{}, {"faults": {1: [NEVER]}}, {"is_gateway": True}],
    ids=["plain", "faulty", "gateway"],
)
@pytest.mark.parametrize("scheme", DATAGRAMS)
def test_an_invalid_datagram_is_counted_once(lan: Lan, scheme, settings) -> None:
    url, encode = f"{scheme}://10.0.0.1:1502", DATAGRAMS[scheme]
    with unit_one(url, **settings) as (server, _), lan.client(url) as client:
        statistics = server.statistics
        for count, datagram in enumerate(damaged(scheme), 1):
            client.sendall(datagram)
            lan.pass_time(0.01)
            assert statistics.bad_frames == count, datagram
        client.send(b"")  # is nothing
        assert statistics.requests == 0
        client.sendall(encode("01 03 0000 0001"))
        lan.pass_time(1)
        assert client.recv(300) == encode("01 03 02 0000")
        assert statistics.bad_frames == count
