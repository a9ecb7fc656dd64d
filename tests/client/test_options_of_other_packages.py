"""
Options by the names of other packages, and hosts that contain a port.
"""

from contextlib import closing
from functools import partial
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, Device, Mapping, Point, RegisterMap, Route, Server
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.ports.options import SERIAL_OPTIONS
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.protocol.mistakes import SERIAL_SETTINGS
from tests.support.cases import each_case


def listening(url: str) -> None:
    with Server(Device(Mapping())).background(url):
        pass


def routed(url: str) -> Route:
    return Route(url, [1])


def polled(url: str) -> DeviceConfig:
    return DeviceConfig("meter", url, RegisterMap([Point("level", "coils", 0)]), interval=1.0)


LINE, HOST = "/dev/ttyUSB0", "192.0.2.1"


@each_case(
    ("place", "option", "meant", "makers"),
    [
        (f"rtu://{LINE}", "stopbits", "stop_bits", [Client, AsyncClient]),
        (f"ascii://{LINE}", "stopbits", "stop_bits", [Client, AsyncClient]),
        (f"ascii://{LINE}", "bytesize", "data_bits", [Client, AsyncClient]),
        (LINE, "stopbit", "stop_bits", [Client, AsyncClient, SerialPort]),
        (LINE, "baud", "baudrate", [SerialPort]),
        (LINE, "baud_rate", "baudrate", [Client, AsyncClient]),
        (LINE, "slave", "unit", [Client, AsyncClient]),
        (LINE, "timout", "timeout", [Client, AsyncClient]),
        (LINE, "handle_local_echo", "echo", [Client, AsyncClient]),
        (HOST, "device_id", "unit", [Client, AsyncClient]),
        (f"udp://{HOST}", "device_id", "unit", [Client, AsyncClient]),
        (HOST, "retry", "retries", [Client, AsyncClient]),
        (HOST, "time_out", "timeout", [Client, AsyncClient]),
    ],
)
def test_options_of_classes(place: str, option: str, meant: str, makers: list[Any]) -> None:
    for make in makers:
        with pytest.raises(TypeError, match=f"'{option}' must be one of .*; did you mean {meant}"):
            make(place, **{option: 1})


def test_an_option_that_nothing_is_like() -> None:
    with pytest.raises(TypeError, match=r"'colour' must be one of .*statistics$"):
        Client(f"tcp://{HOST}", colour=1)  # type: ignore[call-arg]


@each_case(
    ("text", "url"),
    [
        ("192.0.2.1:1502", "192.0.2.1:1502"),
        ("plc.example:1502", "plc.example:1502"),
        ("[::1]:1502", "[::1]:1502"),
        ("plc:7", "plc:7"),
    ],
)
def test_a_host_may_stand_for_a_url(text: str, url: str) -> None:
    with closing(Client(text)) as client:
        assert client.url == f"tcp://{url}"


@each_case(
    ("make", "scheme", "option", "meant"),
    [
        *(
            (make, "rtu", "stopbits", "stop_bits")
            for make in (AsyncClient, Client, listening, routed, polled)
        ),
        (AsyncClient, "ascii", "bytesize", "data_bits"),
        (AsyncClient, "tcp", "slave", "unit"),
        (Client, "udp", "timout", "timeout"),
    ],
)
def test_options_in_urls(make: Any, scheme: str, option: str, meant: str) -> None:
    place = LINE if scheme in ("rtu", "ascii") else HOST
    with pytest.raises(ValueError, match=f"'{option}' must be one of .*; did you mean {meant}"):
        make(f"{scheme}://{place}?{option}=1")


@each_case(
    ("make", "option", "meant"),
    [
        (Server, "stopbits", "stop_bits"),
        (Server, "baud", "baudrate"),
        (partial(Route, units=[1]), "bytesize", "data_bits"),
        (partial(DeviceConfig, "meter"), "parity", "parity"),
    ],
)
def test_settings_that_are_part_of_urls(make: Any, option: str, meant: str) -> None:
    """Classes that take a URL have no arguments for the settings of a serial port."""
    reason = rf"'{option}' must be one of .*; {meant} is part of the URL .*: rtu:.*\?{meant}="
    with pytest.raises(TypeError, match=reason):
        make(f"rtu://{LINE}", **{option: 1})


def test_settings_of_serial_ports_are_known_by_their_names() -> None:
    assert set(SERIAL_OPTIONS) == SERIAL_SETTINGS
