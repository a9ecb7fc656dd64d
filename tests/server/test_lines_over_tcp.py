"""
Serial lines over TCP have many clients, where a line has one: what function 8 does to a
device for one of them must not be felt by the others.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support.attacks import ask, connect
from tests.support.driver import ascii_frame, rtu
from tests.support.peers import until

LISTEN_ONLY = "11 08 0004 0000"
SEMICOLON = "11 08 0003 3B00"
RESTART = "11 08 0001 0000"
READ = "11 03 0000 0001"
ANSWER = "11 03 02 0007"
MESSAGES = "11 08 000B 0000"
COUNTER = "11 0B"
BROADCAST = "00 06 0000 0063"

FRAMES = {"rtu+tcp": rtu, "ascii+tcp": ascii_frame}


@contextmanager
def served(scheme: str, devices: Any = None) -> Iterator[tuple[Server, str]]:
    server = Server(devices or {17: Device(Mapping(holding_registers={0: [7]}))})
    with server.background(f"{scheme}://127.0.0.1:0") as running:
        yield server, running.urls[0]


@pytest.mark.parametrize("all_units", [False, True])
@pytest.mark.parametrize("scheme", FRAMES)
def test_listen_only_mode_applies_to_the_connection_that_asked_for_it(scheme: str, all_units: bool):
    frame = FRAMES[scheme]
    devices = Device(Mapping(holding_registers={0: [7]})) if all_units else None
    with served(scheme, devices) as (server, url), connect(url) as mute, connect(url) as other:
        ask(other, frame(READ), frame(ANSWER))
        mute.sendall(frame(LISTEN_ONLY) + frame(READ))
        until(lambda: server.statistics.requests == 3)
        ask(other, frame(READ), frame(ANSWER))
        with connect(url) as newcomer:
            ask(newcomer, frame(READ), frame(ANSWER))
        # It got no answer, and is told none of the restart either (08/01).
        ask(mute, frame(RESTART) + frame(READ), frame(ANSWER))


def test_broadcasts_of_a_connection_in_listen_only_mode_are_not_executed() -> None:
    devices = {unit: Device(Mapping(holding_registers={0: [7]})) for unit in (17, 18)}
    with served("rtu+tcp", devices) as (_, url), connect(url) as mute, connect(url) as other:
        mute.sendall(rtu(LISTEN_ONLY) + rtu(BROADCAST))
        ask(mute, rtu("12 03 0000 0001"), rtu("12 03 02 0063"))
        ask(other, rtu(READ), rtu(ANSWER))
        other.sendall(rtu(BROADCAST))
        ask(other, rtu(READ), rtu("11 03 02 0063"))


def test_a_delimiter_applies_to_the_connection_that_asked_for_it() -> None:
    with served("ascii+tcp") as (_, url), connect(url) as odd, connect(url) as other:
        ask(odd, ascii_frame(SEMICOLON), ascii_frame(SEMICOLON))
        ask(odd, ascii_frame(READ, b"\r;"), ascii_frame(ANSWER, b"\r;"))
        ask(other, ascii_frame(READ), ascii_frame(ANSWER))
        with connect(url) as newcomer:
            ask(newcomer, ascii_frame(READ), ascii_frame(ANSWER))
        ask(odd, ascii_frame(READ, b"\r;"), ascii_frame(ANSWER, b"\r;"))


def test_counters_are_those_of_the_line_for_all_connections() -> None:
    with served("rtu+tcp") as (_, url), connect(url) as first, connect(url) as second:
        ask(first, rtu(READ), rtu(ANSWER))
        ask(second, rtu(MESSAGES), rtu("11 08 000B 0002"))
        ask(first, rtu(MESSAGES), rtu("11 08 000B 0003"))
        ask(second, rtu(COUNTER), rtu("11 0B 0000 0003"))
        ask(first, rtu("11 08 000A 0000"), rtu("11 08 000A 0000"))
        ask(second, rtu(MESSAGES), rtu("11 08 000B 0001"))
        ask(first, rtu("11 0B"), rtu("11 0B 0000 0002"))
