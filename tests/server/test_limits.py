"""What clients may cost a server, limit by limit, and what it counts of them."""

import dataclasses
import errno
import os
import select
import socket
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server, framing
from libmodbus_py.cli.main import main
from libmodbus_py.server.limits import Limits, ServerStatistics
from tests.simulation.lan import Lan, LineEnd
from tests.simulation.sockets import MemoryListener
from tests.support import attacks
from tests.support.attacks import READ_ONE, ServerProcess, adu, connect, descriptor_limit, receive
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.lan_server import ANSWER_ONE, KINDS, NEVER, ONE_ANSWER, ask, rtu, server_on
from tests.support.peers import until

ILLEGAL_COUNT = bytes.fromhex("03 0000 0000")

KIND = pytest.mark.parametrize("kind", KINDS)


SECONDS = ("frame_timeout", "handshake_timeout", "idle_timeout", "certificate_interval")


ENDS: dict[str, tuple[Any, ...]] = {
    "max_connections": (1, 1_000_000),
    "connections_per_address": (1, 1_000_000),
    "max_unsent": (0, 2**30),
    "requests_per_second": (0.001, 1_000_000),
    **dict.fromkeys(SECONDS, (0.001, 1, 86_400)),
}


def test_limits_have_defaults() -> None:
    limits = Limits()
    assert [getattr(limits, name) for name in SECONDS] == [5, 5, 3600, 60]
    assert (limits.when_full, limits.max_unsent, limits.allow) == ("close-idle", 65536, ())
    assert (limits.max_connections, limits.connections_per_address) == (None, None)
    assert limits.requests_per_second is None


@pytest.mark.parametrize(("most", "of_address"), [(1, 8), (80, 8), (89, 8), (90, 9), (1000, 100)])
def test_an_address_may_have_a_tenth_of_all_connections(most: int, of_address: int) -> None:
    assert Limits(max_connections=most).connections_of_address() == of_address
    assert Limits(max_connections=most, connections_per_address=3).connections_of_address() == 3


def test_an_invalid_limit_is_named(refused: Refused) -> None:
    refused("wrong_limits.txt", lambda limit: Limits(**limit))


def test_limits_accept_the_ends_of_their_ranges() -> None:
    for name, values in ENDS.items():
        for value in values:
            assert getattr(Limits(**{name: value}), name) == value
    assert Limits(idle_timeout=None).idle_timeout is None


@each_case(
    ("name", "value"),
    [
        *(("limits", value) for value in (5, {}, {"max_connections": 2}, Limits)),
        *(("unknown_unit", value) for value in ("ignore", "", None, 1, {}, Device(Mapping()))),
    ],
)
def test_a_server_names_an_argument_that_it_refuses(name: str, value: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=name):
        Server({}, **{name: value})


NETWORKS = [
    ([], "203.0.113.9", True),
    (["192.0.2.0/24"], "192.0.2.255", True),
    (["192.0.2.0/24"], "192.0.3.0", False),
    (["192.0.2.7/24"], "192.0.2.1", True),
    (["192.0.2.7"], "192.0.2.7", True),
    (["192.0.2.7"], "192.0.2.8", False),
    (["192.0.2.7", "2001:db8::/32"], "2001:db8:ffff::1", True),
    (["192.0.2.7", "2001:db8::/32"], "2001:db9::1", False),
    (["192.0.2.0/24"], "::ffff:192.0.2.7", True),
    (["192.0.2.0/24"], "::ffff:192.0.3.7", False),
    (["192.0.2.0/24"], "::1", False),
    (["0.0.0.0/0"], "::1", False),
    (["fe80::/10"], "fe80::1%eth0", True),
    (["::1"], "127.0.0.1", False),
]


def test_networks_accept_only_their_hosts() -> None:
    for allow, host, is_allowed in NETWORKS:
        assert Limits(allow=allow).allows(host) is is_allowed, (allow, host)


def test_a_changed_copy_of_limits_has_the_same_networks() -> None:
    limits = dataclasses.replace(Limits(allow=iter(["192.0.2.7"])), max_connections=5)
    assert limits.allows("192.0.2.7")
    assert not limits.allows("192.0.2.8")


STRANGER = 99
REFUSED = bytes.fromhex("83 0b")


@pytest.mark.parametrize("scheme", ["tcp", "udp"])
@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize(("policy", "answer"), [("refuse", REFUSED), ("silent", None)])
def test_a_unit_without_a_device_gets_the_chosen_answer(lan: Lan, scheme, faulty, policy, answer):
    faults = {None: [NEVER]} if faulty else None
    device = Device(Mapping(holding_registers=1))
    server = Server({17: device}, faults=faults, unknown_unit=policy)
    with server.background(f"{scheme}://10.0.0.1:0") as running:
        client = lan.client(running.urls[0])
        client.sendall(adu(READ_ONE, 1, STRANGER))
        if answer is not None:
            assert client.recv(300) == adu(answer, 1, STRANGER)
        client.sendall(adu(READ_ONE, 2))
        assert client.recv(300) == adu(ANSWER_ONE, 2)
    assert server.statistics.requests == 2
    assert server.statistics.refused == (answer == REFUSED)


@pytest.mark.parametrize("policy", ["refuse", "silent"])
@pytest.mark.parametrize("scheme", ["rtu+tcp", "ascii+tcp", "rtu", "ascii"])
def test_serial_lines_are_silent_for_a_unit_without_a_device(lan: Lan, scheme, policy) -> None:
    framer: framing.Framer = framing.AsciiFramer()
    if scheme.startswith("rtu"):
        framer = framing.RtuFramer("server")
    server = Server({17: Device(Mapping(holding_registers=1))}, unknown_unit=policy)
    requests = [framer.encode(framing.Frame(unit, READ_ONE)) for unit in (STRANGER, 17)]
    answer = framer.encode(framing.Frame(17, ANSWER_ONE))
    if scheme.endswith("tcp"):
        with server.background(f"{scheme}://10.0.0.1:0") as running:
            client = lan.client(running.urls[0])
            client.sendall(b"".join(requests))
            assert client.receive(len(answer)) == answer
    else:
        with server.background(f"{scheme}:///dev/line?baudrate=115200"):
            master = LineEnd(lan.line("/dev/line"))
            for request in requests:
                master.write(request)
                lan.pass_time(60)
            assert master.heard == answer
    assert server.statistics.requests == 2


def test_serve_has_an_option_for_each_limit(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["serve", "--help-all"])
    assert stop.value.code == 0
    output = capsys.readouterr().out
    limits = [
        f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(Limits) if field.init
    ]
    assert [name for name in limits if name not in output] == []


def ask_system(connection: socket.socket) -> None:
    attacks.ask(connection, adu(READ_ONE), adu(ANSWER_ONE))


def is_closed(connection: socket.socket) -> bool:
    """Return True if no more bytes come, because the server has closed."""
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def test_serve_applies_its_limits_to_clients() -> None:
    options = ["--max-connections", "2", "--frame-timeout", "0.3", "--idle-timeout", "inf"]
    with (
        ServerProcess(*options, "--max-unsent", "0", "--requests-per-second", "1000") as server,
        connect(server.port) as first,
        connect(server.port) as slow,
    ):
        ask_system(first)
        slow.sendall(b"\0")
        assert is_closed(slow)
        with connect(server.port) as second, connect(server.port) as third:
            assert is_closed(second)  # it never asked
            ask_system(third)
            ask_system(first)


def test_serve_accepts_options_of_other_kinds() -> None:
    networks = ["--allow", "192.0.2.0/24", "--allow", "127.0.0.1"]
    room = ["--max-connections", "1", "--when-full", "refuse"]
    with (
        ServerProcess(*networks, *room, "--unknown-unit", "silent") as server,
        connect(server.port) as first,
    ):
        ask_system(first)
        with connect(server.port, source="127.0.0.2") as stranger:
            assert is_closed(stranger)
        with connect(server.port) as second:
            assert is_closed(second)
        ask_system(first)


def test_without_descriptors_connected_clients_are_served_and_new_ones_later() -> None:
    with ExitStack() as stack:
        with descriptor_limit(48):
            server = stack.enter_context(ServerProcess("--max-connections", "1000"))
        clients = [stack.enter_context(connect(server.port)) for _ in range(80)]
        for client in clients:
            client.sendall(adu(READ_ONE))
        assert receive(clients[0], ONE_ANSWER) == adu(ANSWER_ONE)
        until(lambda: server.descriptors() == 48)
        for _ in range(20):
            ask_system(clients[0])
        others = [client for client in clients[1:] if not has_answer(client)]
        assert 32 <= len(others) < 79
        for client in clients:
            if client not in others:
                client.close()
        for client in others:
            assert receive(client, ONE_ANSWER) == adu(ANSWER_ONE)
            client.close()


def has_answer(client: socket.socket) -> bool:
    return bool(select.select([client], [], [], 0)[0])


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM])
def test_without_descriptors_a_server_accepts_ten_times_a_second(lan: Lan, monkeypatch, number):
    """Otherwise clients that wait to be accepted would wake the server without end."""
    times: list[float] = []

    def fail(listener: MemoryListener) -> None:
        times.append(lan.now)
        raise OSError(number, os.strerror(number))

    with server_on(lan) as server:
        first = server.connect()
        ask(first)
        with monkeypatch.context() as short:
            short.setattr(MemoryListener, "accept", fail)
            newcomer = server.connect()
            start = lan.now
            newcomer.sendall(adu(READ_ONE))
            lan.pass_time(10)
            assert len(times) == pytest.approx(100, abs=1)
            ask(first)
            assert lan.now - start < 10.01
        assert newcomer.receive(ONE_ANSWER) == adu(ANSWER_ONE)
        assert server.counts(accepted=2)


def assert_counted(statistics: ServerStatistics, **counts: int) -> None:
    nonzero = {name: value for name, value in asdict(statistics).items() if value}
    assert nonzero == counts


@KIND
def test_a_session_over_tcp_is_counted(lan: Lan, kind: str) -> None:
    with server_on(lan, kind) as server:
        first, second = server.connect(), server.connect()
        for number in range(3):
            ask(first, number)
        first.sendall(adu(ILLEGAL_COUNT) + adu(READ_ONE, unit=STRANGER) + adu(b"\x63"))
        first.receive(3 * 9)
        first.sendall(b"\0\1\0\7" + adu(READ_ONE)[4:])
        ask(first)
        second.sendall(adu(READ_ONE) + bytes(8))
        second.receive(ONE_ANSWER)
        assert second.is_closed()
        assert server.counts(connections=1)
        first.close()
        assert server.counts(connections=0)
        assert_counted(
            server.statistics, accepted=2, requests=8, refused=3, bad_frames=2, closed_out_of_step=1
        )


@KIND
def test_a_session_over_rtu_over_tcp_is_counted(lan: Lan, kind: str) -> None:
    answer, refusal = rtu(ANSWER_ONE), rtu(b"\x83\x03")
    with server_on(lan, kind, "rtu+tcp") as server:
        client = server.connect()
        for request, response in ((READ_ONE, answer), (ILLEGAL_COUNT, refusal)):
            client.sendall(rtu(READ_ONE, STRANGER) + rtu(request))
            assert client.receive(len(response)) == response
        frame = bytearray(rtu(READ_ONE))
        frame[-1] ^= 0xFF
        client.sendall(frame)
        lan.pass_time(1)
        assert server.counts(bad_frames=1)
        client.sendall(rtu(READ_ONE))
        assert client.receive(len(answer)) == answer
        client.close()
        assert server.counts(connections=0)
        assert_counted(server.statistics, accepted=1, requests=5, refused=1, bad_frames=1)


@KIND
def test_a_session_over_udp_is_counted(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, "udp") as server:
        client = server.connect()
        for datagram in (adu(READ_ONE)[:-1], adu(READ_ONE), adu(ILLEGAL_COUNT), b"", adu(READ_ONE)):
            client.send(datagram)
        answers = [client.recv(300) for _ in range(3)]
        assert answers == [adu(ANSWER_ONE), adu(b"\x83\x03"), adu(ANSWER_ONE)]
        assert_counted(server.statistics, requests=3, refused=1, bad_frames=1)
