"""Wrong names of arguments, tables, types and orders: the error names the one meant."""

import copy
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Fault,
    Gateway,
    Hook,
    Limits,
    Mapping,
    Plan,
    Point,
    Read,
    Route,
    Security,
    Server,
)
from libmodbus_py.fleet import DeviceConfig, Fleet
from libmodbus_py.listen import listen
from libmodbus_py.protocol.mistakes import named_arguments
from libmodbus_py.scan import scan, search
from libmodbus_py.serve import Allow, AuditFile
from tests.support.cases import each_case
from tests.support.commands import run

URL = "tcp://192.0.2.10"


@each_case(
    ("make", "name", "close"),
    [
        (Server, "fault", "faults"),
        (Gateway, "write_first", "writes_first"),
        (Route, "unit", "units"),
        (Device, "identity", "identification"),
        (Device, "befor_write", "before_write"),
        (Mapping, "coil", "coils"),
        (Hook, "holding_register", "holding_registers"),
        (Security, "certfile", "certificate"),
        (Security, "keyfile", "key"),
        (Limits, "max_clients", "max_connections"),
        (Allow, "function", "functions"),
        (Fault, "second", "seconds"),
        (Point, "data_type", "type"),
        (Read, "byteorder", "order"),
        (Plan, "gaps", "gap"),
        (DeviceConfig, "host", "url"),
        (DeviceConfig, "period", "interval"),
        (Fleet, "output", "outputs"),
        (AuditFile, "pth", "path"),
    ],
)
def test_a_wrong_name_of_an_argument(make: Callable[..., Any], name: str, close: str) -> None:
    assert close in inspect.signature(make).parameters, "the case is wrong"
    with pytest.raises(TypeError) as raised:
        make(**{name: 1})
    assert str(raised.value).startswith(f"'{name}' must be one of ")
    assert "did you mean " in str(raised.value)
    assert close in str(raised.value).partition("did you mean ")[2]
    assert raised.value.__cause__ is None


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
def test_a_wrong_name_of_an_argument_of_a_function(function, name, close) -> None:
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


def test_errors_from_within_are_passed_on() -> None:
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


def test_signatures_and_copies_are_as_before() -> None:
    route = Route(URL, units="1-9")
    assert copy.copy(route) == pickle.loads(pickle.dumps(route)) == route
    assert [*inspect.signature(Read).parameters][:2] == ["table", "address"]
    assert Read.__init__.__name__ == "__init__"


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
def test_a_wrong_word_on_the_command_line(words: str, close: str) -> None:
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
def test_a_wrong_word_in_a_program(ask: Callable[[Client], Any], close: str) -> None:
    plc = Client("tcp://127.0.0.1:1")
    try:
        with pytest.raises(ValueError, match=close):
            ask(plc)
    finally:
        plc.close()
