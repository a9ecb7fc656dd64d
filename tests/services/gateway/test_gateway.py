"""A gateway over time: connections that come and go, routes that change, and its end."""

import socket
from urllib.parse import urlsplit

import pytest

from libmodbus_py import Client, Fault, Gateway, GatewayPathUnavailable, Route, Server, pdu
from libmodbus_py.framing import Framing, make_framer
from libmodbus_py.protocol.framing import Frame
from tests.services.gateway.gates import LINE, READ_ONE, adu, gated, gateway, numbered, small
from tests.simulation.lan import Lan
from tests.simulation.runner import simulated

ONE, SEVEN = bytes.fromhex("03 02 0000"), bytes.fromhex("03 02 0007")


def test_routes_change_and_connections_stay(lan: Lan) -> None:
    lan.missing.add("/dev/nowhere")
    with (
        Server({n: numbered(n) for n in (1, 2)}).background("tcp://10.0.0.9:0") as one,
        Server({n: numbered(10 + n) for n in (1, 2)}).background("tcp://10.0.0.9:0") as other,
        gateway([Route(one.urls[0], "1"), Route(other.urls[0], "2")]) as (gateway_, url),
        Client(url) as context,
    ):

        def ask(unit: int) -> int:
            return context.for_unit(unit).read_holding_registers(0, 1)[0]

        assert (ask(1), ask(2)) == (1, 12)
        connects = gateway_.traffic.lines[one.urls[0]].connection
        gateway_.change_routes([Route(one.urls[0], "1-2"), Route(other.urls[0], "3", "2")])
        assert lan.until(lambda: ask(2) == 2)
        assert (ask(1), ask(3)) == (1, 12)
        assert gateway_.traffic.lines[one.urls[0]].connection is connects
        assert connects.connects == 1
        gateway_.change_routes([Route(one.urls[0], "1")])
        assert lan.until(lambda: list(gateway_.traffic.lines) == [one.urls[0]])
        with pytest.raises(GatewayPathUnavailable):
            ask(3)
        for bad in (
            [Route(one.urls[0], "1"), Route(other.urls[0], "1")],
            [Route(url, "1")],
            [Route("rtu:///dev/nowhere", "1")],
            [],
        ):
            with pytest.raises(ValueError, match=r"route|listens|port"):
                gateway_.change_routes(bad)
        assert ask(1) == 1
        assert context.statistics.connects == 1


@pytest.mark.parametrize("stays", [True, False])
def test_requests_are_answered_if_their_line_stays_and_refused_at_once_if_not(lan: Lan, stays):
    """A line stays if its URL does, whatever else of its routes changes."""
    with gated(lan) as (gate, _, url, gateway_), lan.client(url) as one, lan.client(url) as other:
        one.sendall(adu(READ_ONE, 1) + adu(READ_ONE, 2))
        assert lan.until(lambda: gate.asked)
        to = f"{LINE}?timeout={1000 if stays else 999}"
        gateway_.change_routes([Route(to, "5", "1", cache=1, merge=True)])
        lan.pass_time(1)
        if stays:
            gate.open()
            assert one.receive(22) == adu(ONE, 1) + adu(ONE, 2)
        else:
            answers = one.receive(18)
            refused = {adu(b"\x83\x0b", number) for number in (1, 2)}
            assert {answers[:9], answers[9:]} == refused
        other.sendall(adu(READ_ONE, 3, unit=1) + adu(pdu.ReadHoldingRegisters(7, 1).encode(), 4, 5))
        assert other.receive(9) == adu(b"\x83\x0a", 3)
        lan.pass_time(1)
        gate.open()  # the answer of a line that was replaced comes late
        assert other.receive(11) == adu(SEVEN, 4, unit=5)
        assert gate.asked == ([0, 0, 7] if stays else [0, 7])


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp"])
def test_requests_of_a_client_that_sends_no_more_are_answered(scheme: str) -> None:
    """As of `nc -N`, which half-closes the connection behind its last request."""
    framing: Framing = "tcp" if scheme == "tcp" else "rtu" if scheme == "rtu+tcp" else "ascii"
    framer = make_framer(framing, "client")
    with (
        Server(small()).background("tcp://127.0.0.1:0") as behind,
        Gateway([Route(behind.urls[0])]).background(f"{scheme}://127.0.0.1:0") as running,
        socket.create_connection(("127.0.0.1", urlsplit(running.urls[0]).port)) as one,
    ):
        count = 5 if scheme == "tcp" else 1  # without ids, a request takes the place of another
        writes = [Frame(1, pdu.WriteRegister(at, 7).encode(), at) for at in range(count)]
        one.sendall(b"".join(framer.encode(write) for write in writes))
        one.shutdown(socket.SHUT_WR)
        one.settimeout(10)
        answers = b"".join(iter(lambda: one.recv(4096), b""))
        assert answers == b"".join(framer.encode(write) for write in writes)


def test_closing_a_gateway_during_requests_leaves_nothing(lan: Lan) -> None:
    """The LAN fails the test for a task or an exception that is left."""
    slow = {1: [Fault("delay", seconds=500)]}
    server = Server({1: small()}, faults=slow)
    with server.background("tcp://10.0.0.9:0") as behind:
        for _ in range(3):
            with gateway([Route(behind.urls[0])]) as (_, url):
                client = lan.client(url)
                client.sendall(adu(READ_ONE) * 8)
                lan.pass_time(0.05)
            assert client.is_closed()
        lan.pass_time(501)
        assert server.statistics.connections == 0


@simulated
async def test_routes_changed_while_it_stops_apply_to_the_next_run() -> None:
    gateway_ = Gateway([Route("tcp://10.0.0.9", [1])])
    async with gateway_.serving("tcp://10.0.0.1:502"):
        gateway_.change_routes([Route("tcp://10.0.0.8", [1])])
    async with gateway_.serving("tcp://10.0.0.1:502"):
        assert list(gateway_.traffic.lines) == ["tcp://10.0.0.8:502"]


def test_a_gateway_can_serve_again_but_not_twice_at_once() -> None:
    with Server({1: small()}).background("tcp://127.0.0.1:0") as behind:
        gateway_ = Gateway([Route(behind.urls[0])])
        for _ in range(2):
            with gateway_.background("tcp://127.0.0.1:0") as running:
                with Client(running.urls[0], unit=1) as context:
                    assert context.read_holding_registers(0, 1) == [0]
                with pytest.raises(RuntimeError), gateway_.background("tcp://127.0.0.1:0"):
                    pass
