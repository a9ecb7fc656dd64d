"""Handshakes that are slow, many, or never end: others are served, and wait for none of them."""

import contextlib
import ssl

import pytest

from libmodbus_py import Limits
from libmodbus_py.server import tls as server_tls
from tests.simulation.lan import Lan, LanClient
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.tls import (
    ONE,
    VERSION,
    TlsClient,
    closed,
    connected,
    context,
    hello,
    is_served,
    nothing_loud,
    reset,
    serving,
)


@pytest.mark.parametrize("how", ["connects only", "greets only", "trickles"])
def test_a_handshake_must_end_in_time(lan: Lan, pki: Pki, how, caplog) -> None:
    first, limits = hello(pki), Limits(handshake_timeout=100)
    with nothing_loud(caplog), serving(pki, limits=limits) as (server, port):
        start = lan.now
        slow = lan.client(port)
        if how == "greets only":
            slow.sendall(first)
        elif how == "trickles":
            for byte in first * 10:
                slow.send(bytes([byte]))
                lan.pass_time(0.5)
                if slow.has_input():
                    break
        closed(slow)
        assert lan.now - start == pytest.approx(100, abs=0.6)
        assert lan.until(lambda: server.statistics.connections == 0)
        assert server.statistics.closed_slow == 1
        assert server.statistics.handshakes_refused == 0
        assert is_served(pki, port, lan)


@VERSION
def test_a_slow_handshake_has_its_own_timeout(lan: Lan, pki: Pki, version: ssl.TLSVersion) -> None:
    """The time of a frame begins when the handshake is over."""
    limits = Limits(handshake_timeout=1000, frame_timeout=0.2)
    context_ = context(pki, certificates.client(), version)
    with (
        serving(pki, limits=limits) as (server, port),
        TlsClient(port, context_, lan=lan) as client,
    ):
        first = client.hello()
        for start in range(0, len(first), 40):
            client.socket.sendall(first[start : start + 40])
            lan.pass_time(10)
        client.handshake()
        assert client.is_answered()
        assert server.statistics.closed_slow == 0


def test_the_oldest_half_open_connection_is_closed_for_a_new_one(lan: Lan, pki: Pki, monkeypatch):
    monkeypatch.setattr(server_tls, "HALF_OPEN", 5)
    first = hello(pki)
    with serving(pki) as (server, port), contextlib.ExitStack() as stack:
        clients = []
        for _ in range(8):
            clients.append(stack.enter_context(lan.client(port)))
            clients[-1].sendall(first)
            assert clients[-1].recv(100)  # in their order
        assert [bool(still_open(client)) for client in clients] == [False] * 3 + [True] * 5
        assert server.statistics.closed_for_others == 3
        # Connected is not half open: it has no state of TLS.
        silent = [stack.enter_context(lan.client(port)) for _ in range(8)]
        assert all(map(still_open, silent + clients[3:]))
        # And those that are through do not count.
        assert is_served(pki, port, lan)
        assert not still_open(clients[3])
        assert still_open(clients[4])


def still_open(connection: LanClient) -> bool:
    connection.settimeout(0.1)
    try:
        while connection.recv(65536):
            pass
    except TimeoutError:
        return True
    except ConnectionError:
        return False
    return False


def test_handshakes_closed_in_the_queue_do_not_affect_others(lan: Lan, pki: Pki) -> None:
    """By their client, by the sweep, and to make room."""
    first = hello(pki)
    limits = Limits(handshake_timeout=0.2, max_connections=40)
    with serving(pki, limits=limits) as (server, port):
        with connected(lan, pki, port) as innocent:
            assert innocent.is_answered()
            for _ in range(5):
                with contextlib.ExitStack() as stack:
                    for number in range(60):
                        each = stack.enter_context(lan.client(port))
                        with contextlib.suppress(ConnectionError):
                            each.sendall(first[: 100 if number % 3 else None])
                            if number % 7 == 0:
                                reset(each)
                    lan.pass_time(0.4)
                assert innocent.is_answered()
            assert lan.until(lambda: server.statistics.connections == 1)
        assert is_served(pki, port, lan)
        assert server.statistics.closed_for_others > 0


def test_an_address_over_its_rate_does_not_delay_handshakes_of_others(lan: Lan, pki: Pki) -> None:
    limits, first = Limits(requests_per_second=1), hello(pki)
    context_ = context(pki, certificates.client())
    with (
        serving(pki, limits=limits) as (server, port),
        TlsClient(port, context_, source="127.0.0.2", lan=lan).handshake() as greedy,
        contextlib.ExitStack() as stack,
    ):
        others = [stack.enter_context(lan.client(port, source="127.0.0.2")) for _ in range(60)]
        for other in others:
            other.sendall(first)
        # While they wait for their turns, it gets to owe some seconds.
        greedy.send(ONE * 200)
        assert lan.until(lambda: server.statistics.requests > 15, 3)
        start = lan.now
        assert is_served(pki, port, lan)
        assert lan.now - start < 0.1
