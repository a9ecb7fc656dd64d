"""Connections through a tap: all end, whoever falls silent; none keeps others out."""

import contextlib
import os
import socket
import threading
from collections.abc import Iterator

import pytest

from libmodbus_py.listen import listen
from libmodbus_py.tools import timed_server
from libmodbus_py.tools.listener import sources
from tests.support.peers import mute_port, until

Ends = tuple[socket.socket, socket.socket]


class Tapped:
    """A tap, its clients, and the device's end of each connection."""

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._device = self._stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        url = f"rtu+tcp://127.0.0.1:{self._device.getsockname()[1]}"
        self.line = self._stack.enter_context(listen("rtu+tcp://127.0.0.1:0", between=url))

    def connected(self) -> Ends:
        """Return both ends of a new connection."""
        port = int(self.line.url.rpartition(":")[2])
        client = self._stack.enter_context(socket.create_connection(("127.0.0.1", port), 30))
        self._device.settimeout(30)
        device = self._stack.enter_context(self._device.accept()[0])
        device.settimeout(30)
        return client, device

    def close(self) -> None:
        self._stack.close()


@pytest.fixture
def tapped() -> Iterator[Tapped]:
    with contextlib.closing(Tapped()) as tap:
        yield tap


def passes(ends: Ends) -> bool:
    client, device = ends
    client.sendall(b"?")
    device.sendall(b"!")
    return (device.recv(9), client.recv(9)) == (b"?", b"!")


def flood(client: socket.socket) -> None:
    while True:
        client.sendall(bytes(1_000_000))


def test_an_idle_link_closes_both_sides(tapped: Tapped, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "IDLE", 0.05)
    client, device = tapped.connected()
    assert (client.recv(1), device.recv(1)) == (b"", b"")


@pytest.mark.parametrize("first", [0, 1])
def test_a_link_with_one_closed_side_has_a_shorter_timeout(first, tapped: Tapped, monkeypatch):
    monkeypatch.setattr(sources, "LEAVING", 0.05)
    ends = tapped.connected()
    assert passes(ends)
    ends[first].shutdown(socket.SHUT_WR)
    assert ends[1 - first].recv(1) == b""
    assert ends[first].recv(1) == b""


def test_a_side_that_never_reads_ends_the_link(tapped: Tapped, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sources, "LEAVING", 0.05)
    client, _ = tapped.connected()
    with pytest.raises(ConnectionError):
        flood(client)


def test_the_longest_idle_connection_is_closed_for_a_new_one(tapped: Tapped, monkeypatch) -> None:
    monkeypatch.setattr(timed_server, "MOST_CONNECTIONS", 2)
    first, second = tapped.connected(), tapped.connected()
    assert passes(second)
    assert passes(first)
    third = tapped.connected()
    assert passes(third)
    assert passes(first)
    assert (second[0].recv(1), second[1].recv(1)) == (b"", b"")


def test_closing_a_tap_ends_an_attempt_to_connect() -> None:
    with mute_port() as port:
        line = listen("rtu+tcp://127.0.0.1:0", between=f"rtu+tcp://127.0.0.1:{port}")
        place = "127.0.0.1", int(line.url.rpartition(":")[2])
        before = threading.active_count()
        with socket.create_connection(place, 30) as client:
            until(lambda: threading.active_count() > before)  # it has a thread
            line.close()
            assert client.recv(1) == b""


def test_keepalive_is_set_on_both_sides(tapped: Tapped, monkeypatch: pytest.MonkeyPatch) -> None:
    probed: list[tuple[socket.socket, float]] = []
    monkeypatch.setattr(sources, "keep_alive", lambda *given: probed.append(given))
    assert passes(tapped.connected())
    assert [seconds for _, seconds in probed] == [sources.KEEPALIVE] * 2


def test_a_forked_child_that_closes_its_copy_closes_no_connection(tapped: Tapped) -> None:
    ends = tapped.connected()
    assert passes(ends)
    child = os.fork()
    if child == 0:
        tapped.line.close()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert passes(ends)
    assert passes(tapped.connected())
