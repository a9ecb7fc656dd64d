"""
A server in a program without standard input: a client's connection may be descriptor 0.
"""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.attacks import PATIENCE, adu
from tests.support.peers import until

READ, ANSWER = bytes.fromhex("03 0001 0001"), bytes.fromhex("03 02 0000")


@contextmanager
def without_standard_input() -> Iterator[None]:
    """Leave descriptor 0 to whatever is opened next."""
    saved = os.dup(0)
    os.close(0)
    try:
        yield
    finally:
        os.dup2(saved, 0)
        os.close(saved)


@pytest.mark.parametrize("ends_well", [True, False])
def test_the_connection_of_a_client_may_be_the_first_descriptor(ends_well: bool) -> None:
    server = Server(Device(Mapping(holding_registers=4)))
    with server.background("tcp://127.0.0.1:0") as running, socket.socket() as client:
        client.settimeout(PATIENCE)
        with without_standard_input():
            client.connect(("127.0.0.1", int(running.urls[0].rpartition(":")[2])))
            for number in range(3):
                client.sendall(adu(READ, number))
                assert client.recv(100) == adu(ANSWER, number)
            assert stat.S_ISSOCK(os.fstat(0).st_mode)
            if not ends_well:
                client.sendall(b"\xff" * 7)
            else:
                client.shutdown(socket.SHUT_WR)
            assert client.recv(100) == b""
            until(lambda: server.statistics.connections == 0)
