"""Wrong names of arguments, tables, types and orders: the error names the one meant."""

import copy
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import pytest

import libmodbus_py
from libmodbus_py import (
    Client,
    Device,
    IllegalDataAddress,
    Limits,
    Mapping,
    Read,
    Route,
    Server,
    TcpContext,
)
from libmodbus_py.listen import listen
from libmodbus_py.protocol.mistakes import named_arguments
from libmodbus_py.scan import scan, search
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.golden import Refused

URL = "tcp://192.0.2.10"
DEVICE = Device(Mapping(holding_registers=9, input_registers=9, discrete_inputs=9))


def test_a_wrong_argument_has_a_suggestion(refused: Refused) -> None:
    names: dict[str, Any] = {}
    exec("from libmodbus_py import *; from libmodbus_py.fleet import *", names)
    exec("from libmodbus_py.serve import *", names)
    refused("wrong_arguments.txt", lambda call: eval(call, names))


@each_case(
    ("function", "name", "close"),
    [
        (listen, "stopbits", "rtu:///dev/ttyUSB0?stop_bits=..."),
        (listen, "captures", "did you mean capture?"),
        (scan, "bytesize", "rtu:///dev/ttyUSB0?data_bits=..."),
        (scan, "baud_rates", "did you mean baudrates?"),
        (search, "read_timeout", "did you mean timeout?"),
        (search, "stopbits", "rtu:///dev/ttyUSB0?stop_bits=..."),
    ],
)
def test_a_wrong_argument_of_a_function_has_a_suggestion(function, name, close) -> None:
    with pytest.raises(TypeError) as raised:
        function(URL, **{name: 1})
    assert str(raised.value).startswith(f"'{name}' must be one of ")
    assert close in str(raised.value)
    assert "url" in inspect.signature(function).parameters


def test_other_errors_of_calls_are_those_of_python() -> None:
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        Route()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="positional argument"):
        Limits(*range(100))
    with pytest.raises(TypeError, match="multiple values for argument 'url'"):
        Route(URL, url=URL)  # type: ignore[misc]


def test_errors_inside_a_function_are_passed_on() -> None:
    @named_arguments
    class Raising:
        def __init__(self, **options: int) -> None:
            raise TypeError("from within")

    with pytest.raises(TypeError, match="from within"):
        Raising(other=1)

    @named_arguments
    class Calling:
        def __init__(self, argument: int = 0) -> None:
            Route(nonsense=argument)  # type: ignore[call-arg]

    with pytest.raises(TypeError, match="'nonsense' must be one of url, "):
        Calling()


def test_subclasses_keep_their_own_arguments() -> None:
    class Mine(Device):
        def __init__(self, mapping: Mapping, *, mine: int, **others: Any) -> None:
            super().__init__(mapping, **others)
            self.mine = mine

    assert Mine(Mapping(), mine=3, exception_status=1).mine == 3
    with pytest.raises(TypeError, match="did you mean identification"):
        Mine(Mapping(), mine=3, identity={})


def test_decorated_classes_keep_their_signatures_and_can_be_copied() -> None:
    route = Route(URL, units="1-9")
    assert copy.copy(route) == pickle.loads(pickle.dumps(route)) == route
    assert [*inspect.signature(Read).parameters][:2] == ["table", "address"]
    assert Read.__init__.__name__ == "__init__"


@each_case(
    ("name", "named"),
    [
        ("ModbusTcpClient", 'Client("tcp://HOST:PORT", unit=1)'),
        ("AsyncModbusTcpClient", "AsyncClient("),
        ("StartTcpServer", "Server(device)"),
        ("modbus_new_tcp", "TcpContext(host, port)"),
        ("modbus_new_rtu", "RtuContext(device, baudrate, "),
        ("modbus_set_slave", "low_level.lib.modbus_set_slave"),
    ],
)
def test_a_name_of_another_package_is_answered_with_that_of_this_one(name: str, named: str) -> None:
    with pytest.raises(AttributeError) as raised:
        getattr(libmodbus_py, name)
    with pytest.raises(ImportError) as imported:
        exec(f"from libmodbus_py import {name}", {})
    for text in (str(raised.value), str(imported.value)):
        assert named in text
    with pytest.raises(ImportError, match="cannot import name 'nonsense'"):
        exec("from libmodbus_py import nonsense", {})


@each_case(
    ("ask", "address"),
    [
        (lambda plc: plc.read_holding_registers(40001, 2), 0),
        (lambda plc: plc.read_input_registers(30123, 2), 122),
        (lambda plc: plc.read_discrete_inputs(10002, 2), 1),
        (lambda plc: plc.write_register(40101, 2), 100),
    ],
)
def test_a_reference_in_place_of_an_address_is_answered_with_its_address(
    ask: Callable[[Any], object], address: int
) -> None:
    with Server(DEVICE).background("tcp://127.0.0.1:0") as running:
        url = running.urls[0]
        host, port = url.removeprefix("tcp://").split(":")
        for plc in (Client(url), TcpContext(host, int(port))):
            with plc, pytest.raises(IllegalDataAddress, match=rf"its address is {address}$"):
                ask(plc)


@each_case(("address", "hint"), [(400001, "; if 400001 .* address is 0"), (499999, "not 499999")])
def test_a_reference_of_six_digits_is_no_address(address: int, hint: str) -> None:
    with pytest.raises(ValueError, match=f"{hint}$"):
        Client(URL).read_holding_registers(address, 2)


@each_case(
    ("words", "close"),
    [
        ("hrr 0", "did you mean hr?"),
        ("holdng 0", "did you mean holding"),
        ("inputt 0", "did you mean input"),
        ("hr 0 --type flot32", "did you mean float32"),
        ("hr 0 --type dwrd", "did you mean dword"),
        ("hr 0 2 --type float32 --order ABDC", "did you mean "),
        ("hr 0 2 --type float32 --order word-swaped", "did you mean word swapped"),
        ("hr 0 2 --type float32 --order little-endian", "DCBA to some, and CDAB"),
    ],
)
def test_a_wrong_word_on_the_command_line_has_a_suggestion(words: str, close: str):
    result = run("read", "127.0.0.1:1", *words.split())
    assert (result.code, result.out) == (2, "")
    assert close in result.err


@each_case(
    ("ask", "close"),
    [
        (lambda plc: plc.read_values("hrr", 0, "uint16"), "did you mean hr"),
        (
            lambda plc: plc.read_values("holdin_registers", 0, "uint16"),
            "did you mean holding_registers",
        ),
        (lambda plc: plc.read_many([("coill", 0, 1)]), "did you mean coils"),
        (lambda plc: plc.read_values("hr", 0, "flaot32"), "did you mean float32"),
        (lambda plc: plc.read_values("hr", 0, "float32", order="ABDC"), "did you mean "),
    ],
)
def test_a_wrong_word_in_a_program_has_a_suggestion(ask: Callable[[Client], Any], close: str):
    plc = Client("tcp://127.0.0.1:1")
    try:
        with pytest.raises(ValueError, match=close):
            ask(plc)
    finally:
        plc.close()
