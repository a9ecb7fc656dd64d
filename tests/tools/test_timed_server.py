"""TCP connections that are closed after a time, however their clients behave."""

import socket
import socketserver
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from libmodbus_py.tools import timed_server
from libmodbus_py.tools.timed_server import TimedServer

ERRORS = {b"r": ConnectionResetError(), b"e": ZeroDivisionError("of the handler")}


class Reading(socketserver.BaseRequestHandler):
    """Read until the connection ends; "k" keeps it without a limit, "r" and "e" raise errors."""

    server: TimedServer

    def handle(self) -> None:
        while data := self.request.recv(1):
            if data == b"k":
                self.server.keep(self.request)
            if data in ERRORS:
                raise ERRORS[data]
            self.request.sendall(data)


@pytest.fixture(autouse=True)
def short_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timed_server, "SWEEP", 0.01)


@contextmanager
def serving(limit: float = 60.0) -> Iterator[TimedServer]:
    with TimedServer("127.0.0.1", 0, Reading, limit).serving("timed") as server:
        yield server


def connected(server: TimedServer) -> socket.socket:
    return socket.create_connection(server.server_address[:2], 20)  # type: ignore[arg-type]


def is_answered(connection: socket.socket, data: bytes = b"x") -> bool:
    try:
        connection.sendall(data)
        return connection.recv(1) == data
    except OSError:
        return False


def test_a_connection_is_closed_when_its_time_is_over() -> None:
    with serving(limit=0.05) as server, connected(server) as silent, connected(server) as kept:
        assert is_answered(kept, b"k")
        assert silent.recv(1) == b""
        assert is_answered(kept)


def test_the_oldest_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timed_server, "MOST_CONNECTIONS", 2)
    with serving() as server, connected(server) as kept, connected(server) as oldest:
        assert is_answered(kept, b"k")
        assert is_answered(oldest)
        with connected(server) as latest:
            assert is_answered(latest)
            assert oldest.recv(1) == b""
            assert is_answered(kept)
            assert is_answered(latest, b"k")
            with connected(server) as none_makes_room:
                assert not is_answered(none_makes_room)
            assert is_answered(kept)
            assert is_answered(latest)


def test_an_exception_of_a_handler_is_logged_unless_the_client_has_gone(caplog) -> None:
    with serving() as server:
        for data in ERRORS:
            with connected(server) as connection:
                assert not is_answered(connection, data)
    (record,) = caplog.records
    assert record.exc_info is not None
    assert record.exc_info[1] is ERRORS[b"e"]
