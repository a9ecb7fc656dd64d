"""The options of a client, and how those of other packages are called here."""

from contextlib import closing
from functools import partial
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Mapping,
    Point,
    RegisterMap,
    Route,
    Server,
    pdu,
)
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.ports.options import SERIAL_OPTIONS
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.protocol.mistakes import SERIAL_SETTINGS
from tests.support.cases import each_case
from tests.support.clients import World
from tests.support.golden import Refused
from tests.support.reads import on_read

REQUEST = pdu.ReadHoldingRegisters(5, 1)


TABLES, HELD = "holding_registers, input_registers", "holding_registers"

VALUES = [
    (lambda plc: plc.read_value("coils", 0, "uint16"), f"table must be one of {TABLES}"),
    (lambda plc: plc.read_value(HELD, 0, "flaot32"), "flaot32"),
    (lambda plc: plc.read_value(HELD, -1, "float32"), "address"),
    (lambda plc: plc.read_value(HELD, 65535, "float32"), "65535"),
    (lambda plc: plc.read_value(HELD, 0, "string:252"), "string"),
    (lambda plc: plc.read_values("coils", 0, "int16"), f"table must be one of {TABLES}"),
    (lambda plc: plc.read_values("input_registers", 0, "int17"), "type"),
    (lambda plc: plc.read_values("input_registers", 0, "int32", 63), "count"),
    (lambda plc: plc.read_values("input_registers", 0, "int16", order="ACDB"), "order"),
    (lambda plc: plc.write_value("input_registers", 0, 1, "uint16"), f"table must be {HELD}, not"),
    (lambda plc: plc.write_value("coils", 0, 1, "uint16"), f"table must be {HELD}, not 'coils'"),
    (lambda plc: plc.write_value(HELD, 0, 1, "flaot32"), "flaot32"),
    (lambda plc: plc.write_value(HELD, 65535, 1, "float32"), "65535"),
    (lambda plc: plc.write_value(HELD, 0, 65536, "uint16"), r"^value must be in 0\.\.65535"),
    (lambda plc: plc.write_value(HELD, 0, [1], "uint16"), "^value must be an integer"),
    (lambda plc: plc.write_value(HELD, 0, "1.5", "float32"), "^value must be a number"),
    (lambda plc: plc.write_values("coils", 0, [1], "int16"), f"table must be {HELD}"),
    (lambda plc: plc.write_values(HELD, 0, [], "int16"), "values"),
    (lambda plc: plc.write_values(HELD, 0, [1e40], "float32"), "value"),
]


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda plc: plc.read_coils(-1, 1), "address must be in 0..65535"),
        (lambda plc: plc.read_coils(0, 2001), "count must be in 1..2000"),
        (lambda plc: plc.read_holding_registers(65535, 2), "must not pass 65536"),
        (lambda plc: plc.read_input_registers(0, 0), "count must be in 1..125"),
        (lambda plc: plc.write_register(0, 65536), "value must be in 0..65535"),
        (lambda plc: plc.write_registers(0, []), "values must hold 1..123"),
        (lambda plc: plc.write_registers(0, [0, -1]), r"values\[1\]"),
        (lambda plc: plc.write_coils(0, [True] * 1969), "values must hold 1..1968"),
        (lambda plc: plc.write_coil(0, "on"), "value"),
        (lambda plc: plc.read_file_records([(0, 0, 1)]), "file must be in 1..65535"),
        (lambda plc: plc.for_unit(256), "unit must be in 0..255"),
        (lambda plc: plc.for_unit(1, timeout=0), "timeout must be in"),
        (lambda plc: plc.execute(3), "request must be a request object of pdu, not int"),
        (lambda plc: plc.execute(REQUEST, retries=-1), "retries must be in 0..100"),
        *VALUES,
    ],
)
def test_nothing_is_sent_for_bad_arguments(world: World, ask: Any, message: str) -> None:
    peer = world.peer("tcp", on_read)
    with world.connect(peer.url) as plc:
        with pytest.raises((ValueError, TypeError), match=message):
            ask(plc)
        assert plc.read_holding_registers(5, 1) == [5]
        assert len(peer.requests) == 1


def test_a_bad_argument_of_a_client_is_named(world: World, refused: Refused) -> None:
    refused("wrong_options.txt", lambda case: world.connect(case[0], **case[1]))
    for word, hint in (
        ("slave", "did you mean unit"),
        ("unti", "did you mean unit"),
        ("parity", "parity is part of the URL of a serial port: rtu:///dev/ttyUSB0.parity="),
    ):
        with pytest.raises(TypeError, match=f"'{word}' must be one of unit, timeout, .*; {hint}"):
            world.connect("tcp://192.0.2.1", **{word: 1})


@pytest.mark.parametrize(
    ("url", "options", "settings"),
    [
        ("rtu:///dev/ttyS0?baudrate=9600", {"parity": "N"}, "parity=N"),
        ("ascii:///dev/ttyS0?unit=7", {"data_bits": 8, "timeout": 0.5}, "data_bits=8"),
    ],
)
def test_a_client_takes_the_settings_of_serial_ports(url, options, settings) -> None:
    client = Client(url, **options)
    assert settings in client.url


def listening(url: str) -> None:
    with Server(Device(Mapping())).background(url):
        pass


def routed(url: str) -> Route:
    return Route(url, [1])


def polled(url: str) -> DeviceConfig:
    return DeviceConfig("meter", url, RegisterMap([Point("level", "coils", 0)]), interval=1.0)


LINE, HOST = "/dev/ttyUSB0", "192.0.2.1"


@each_case(
    ("place", "option", "name", "makers"),
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
def test_wrong_options_have_a_hint(place: str, option: str, name: str, makers: list[Any]) -> None:
    for make in makers:
        with pytest.raises(TypeError, match=f"'{option}' must be one of .*; did you mean {name}"):
            make(place, **{option: 1})


def test_an_unknown_option_unlike_any_other_is_refused_with_the_list_of_options() -> None:
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
    ("make", "scheme", "option", "name"),
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
def test_wrong_options_in_urls_have_a_hint(make: Any, scheme: str, option: str, name: str) -> None:
    place = LINE if scheme in ("rtu", "ascii") else HOST
    with pytest.raises(ValueError, match=f"'{option}' must be one of .*; did you mean {name}"):
        make(f"{scheme}://{place}?{option}=1")


@each_case(
    ("make", "option", "part"),
    [
        (Server, "stopbits", "stop_bits"),
        (Server, "baud", "baudrate"),
        (partial(Route, units=[1]), "bytesize", "data_bits"),
        (partial(DeviceConfig, "meter"), "parity", "parity"),
    ],
)
def test_settings_that_are_part_of_urls(make: Any, option: str, part: str) -> None:
    """Classes that take a URL have no arguments for the settings of a serial port."""
    reason = rf"'{option}' must be one of .*; {part} is part of the URL .*: rtu:.*\?{part}="
    with pytest.raises(TypeError, match=reason):
        make(f"rtu://{LINE}", **{option: 1})


def test_settings_of_serial_ports_are_known_by_their_names() -> None:
    assert set(SERIAL_OPTIONS) == SERIAL_SETTINGS
