"""
The usual mistakes, each said in the one line of the error that it leads to.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Context, ModbusConnectionError, ModbusError
from tests.support.clients import ALL, World, asking, read
from tests.support.peers import FakeServer, FakeUnit, answer, answering, mbap

NOISE = bytes(range(0x70, 0xF0))

# What is spoken -> the URL's scheme, what comes back, and what the error says.
MISTAKES: dict[str, tuple[str, Callable[[bytes], bytes], str]] = {
    "another id": (
        "tcp",
        lambda request: mbap(request, b"\x03\x02\x00\x01", transaction=0x4321),
        r": id 17185, not \d+",
    ),
    "another unit": (
        "tcp",
        lambda request: mbap(request, b"\x03\x02\x00\x01", unit=9),
        r'unit 9 answered; accept_unit="any" would take it',
    ),
    "echo on rtu": ("rtu", lambda request: request, r"the request itself came back; echo=True\?"),
    "echo on ascii": (
        "ascii",
        lambda request: request,
        r"the request itself came back; echo=True\?",
    ),
    "ascii on rtu": ("rtu", lambda request: b":010302000AF0\r\n", "this looks like ascii://"),
    "rtu on ascii": (
        "ascii",
        lambda request: answer(b"\x01\x03\x00\x00\x00\x01\x84\x0a", "rtu"),
        "this looks like rtu://",
    ),
    "ascii over tcp": (
        "rtu+tcp",
        lambda request: b":010302000AF0\r\n",
        r"this looks like ascii\+tcp://",
    ),
    "mbap on rtu over tcp": (
        "rtu+tcp",
        lambda request: bytes.fromhex("00010000000501030200AA"),
        "this looks like tcp://",
    ),
    "rtu over tcp on tcp": (
        "tcp",
        lambda request: answer(b"\x01\x03\x00\x00\x00\x01\x84\x0a", "rtu"),
        r"this looks like rtu\+tcp://",
    ),
    "noise": ("rtu", lambda request: NOISE, "only noise; baud rate, parity, A and B swapped"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_recognised_in_one_line(mistake: str, world: World) -> None:
    scheme, came, said = MISTAKES[mistake]
    peer = world.peer(scheme, answering(lambda request: [came(request)]))
    with world.connect(peer.url, timeout=0.15) as client:
        caught = failure(client)
    text = str(caught)
    assert re.search(said, text), text
    assert "\n" not in text
    assert longest_hex(text) <= 32
    assert len(text) < 300
    assert caught.endpoint == peer.url
    assert caught.received


def failure(client: Any) -> ModbusError:
    with pytest.raises(ModbusError) as caught:
        read(client, 1)
    return caught.value


def longest_hex(text: str) -> int:
    runs = re.findall(r"(?:\b[0-9a-f]{2}\b ?)+", text)
    return max((len(run.split()) for run in runs), default=0)


def test_long_noise_is_cut(world: World) -> None:
    unit = world.peer("rtu", answering(lambda request: [b"\x00" * 500]))
    with world.connect(unit.url, timeout=0.15) as client:
        caught = failure(client)
    assert longest_hex(str(caught)) <= 32
    assert len(caught.received) == 500


@pytest.mark.parametrize("kind", ["python", "asyncio"])
def test_a_second_client_on_a_port_is_told_of_handles(kind: str) -> None:
    with FakeUnit(lambda request: []) as unit:
        url = f"rtu://{unit.path}?baudrate=115200"
        for _ in range(2):  # what was refused leaves no trace
            with (
                asking(kind, url),
                pytest.raises(ModbusConnectionError, match=r"by this program itself; for_unit\(\)"),
                asking(kind, url),
            ):
                pass
        with asking(kind, url):
            pass


def test_a_port_without_permission_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may open all, so the system's no is made up here."""

    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    with FakeUnit(lambda request: []) as unit:
        monkeypatch.setattr(os, "open", refuse)
        with pytest.raises(ModbusConnectionError, match="group dialout"):
            Context.from_url(f"rtu://{unit.path}").connect()


def test_a_client_and_its_errors_say_where_they_lead() -> None:
    client = AsyncClient("tcp://192.0.2.1:502?unit=7")
    assert repr(client) == "<AsyncClient tcp://192.0.2.1:502, unit 7, disconnected>"


# --- TLS at one end only ---------------------------------------------------------------------

ALERT = bytes.fromhex("15 0303 0002 0246")  # RFC 8446, 5.1 and 6: protocol_version, fatal


@ALL
def test_an_alert_is_named(kind: str) -> None:
    with FakeServer(lambda _: [ALERT]) as server:
        url = f"tcp://127.0.0.1:{server.port}"
        with asking(kind, url, timeout=5) as plc, pytest.raises(ModbusError, match="like tls://"):
            plc.read_coils(0, 1)


@ALL
def test_a_server_that_closes_at_the_first_request(kind: str) -> None:
    with FakeServer(None) as server:
        url = f"tcp://127.0.0.1:{server.port}"
        with (
            asking(kind, url, timeout=5) as plc,
            pytest.raises(ModbusConnectionError, match=r"nothing was answered yet; .* tls://"),
        ):
            plc.read_coils(0, 1)
