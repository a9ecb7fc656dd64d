"""
Wherever a URL is taken, so are a host, HOST:PORT and the path of a serial port; and parities are
words or letters.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Context,
    Device,
    Mapping,
    Point,
    RegisterMap,
    RtuContext,
    Server,
)
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.scan import scan
from libmodbus_py.services.gateway.routes import Route
from tests.support.cases import each_case


@each_case(
    ("text", "url"),
    [
        ("192.0.2.10", "tcp://192.0.2.10:502"),
        ("192.0.2.10:1502", "tcp://192.0.2.10:1502"),
        ("plc.example", "tcp://plc.example:502"),
        ("[::1]:1502", "tcp://[::1]:1502"),
        ("[::1]", "tcp://[::1]:502"),
        ("::1", "tcp://[::1]:502"),
        ("plc?unit=7", "tcp://plc:502"),
        ("/dev/ttyUSB0", "rtu:///dev/ttyUSB0"),
        ("/dev/ttyUSB0?parity=none", "rtu:///dev/ttyUSB0?parity=N"),
        ("/dev/serial/by-id/usb-x", "rtu:///dev/serial/by-id/usb-x"),
    ],
)
def test_the_endpoint_of_what_was_typed(text: str, url: str) -> None:
    assert str(parse(text)) == url
    assert str(parse(url)) == url


def test_all_that_take_a_url_take_it() -> None:
    points = RegisterMap([Point("a", "coils", 0)])
    for make in (Context.from_url, Client):
        client = make("192.0.2.10:1502")
        assert client.url == "tcp://192.0.2.10:1502"
        client.close()
    assert Route("192.0.2.10").endpoint.host == "192.0.2.10"
    assert DeviceConfig("a", "192.0.2.10:1502", points).endpoint.port == 1502
    with Server(Device(Mapping(coils=8))).background("127.0.0.1:0") as running:
        assert running.urls[0].startswith("tcp://127.0.0.1:")


def test_asyncio_takes_it() -> None:
    asyncio.run(_asks_itself())


async def _asks_itself() -> None:
    async with Server(Device(Mapping(coils=8))).serving("127.0.0.1:0") as running:
        host_and_port = running.urls[0].removeprefix("tcp://")
        async with AsyncClient(host_and_port) as client:
            assert client.url == running.urls[0]
            assert await client.read_coils(0, 1) == [False]


@each_case("word", ["N", "n", "none", "None", "NONE"])
def test_parities_are_words_or_letters(word: Any) -> None:
    port = SerialPort("/dev/ttyUSB0", parity=word)
    assert port.parity == "N"
    assert port.character == SerialPort("/dev/ttyUSB0", parity="N").character
    context = RtuContext("/dev/ttyUSB0", parity=word)
    assert context.url == RtuContext("/dev/ttyUSB0", parity="N").url
    assert scan("/dev/ttyUSB0", parities=[word, "N"], units=[1], baudrates=[9600]).total == 1
    assert (
        Context.from_url(f"rtu:///dev/ttyUSB0?parity={word}").url == "rtu:///dev/ttyUSB0?parity=N"
    )


@each_case("word", ["mark", "", 5, None])
def test_other_parities_are_refused(word: Any) -> None:
    for make in (SerialPort, RtuContext):
        with pytest.raises(ValueError, match='parity must be "N", "E" or "O"'):
            make("/dev/ttyUSB0", parity=word)


def test_a_password_is_not_printed() -> None:
    with pytest.raises(ValueError, match=r"must be a URL") as caught:
        parse("me:secret@h")
    assert "secret" not in str(caught.value)
