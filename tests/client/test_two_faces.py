"""The methods of both clients: written once as coroutines, and made blocking by a generator."""

import asyncio
import importlib
import inspect
import pydoc
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import pytest

from libmodbus_py import AsyncClient, Client
from libmodbus_py.client.options import Options
from tests.support.cases import each, each_case

ROOT = Path(__file__).parents[2]

NOT_AWAITED = {"for_unit", "unreadable", "watch"}
"""Methods of `AsyncClient` that send nothing, or that nothing awaits."""


def methods(client: type) -> dict[str, Any]:
    """Return the public methods of a client by name."""
    functions = inspect.getmembers(client, inspect.isfunction)
    others = ("_", "from_url")  # which is static
    return {name: method for name, method in functions if not name.startswith(others)}


def generated(*arguments: str, root: Path = ROOT) -> tuple[int, str]:
    command = [sys.executable, str(root / "packaging" / "generate_blocking.py"), *arguments]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert process.stderr == ""
    return process.returncode, process.stdout


def test_the_blocking_methods_are_those_of_their_sources() -> None:
    assert generated("--check") == (0, "")


def test_both_clients_have_the_same_methods() -> None:
    blocking, awaited = methods(Client), methods(AsyncClient)
    assert awaited.keys() == blocking.keys()
    for check, (name, method) in each(sorted(awaited.items())):
        with check:
            assert inspect.iscoroutinefunction(method) == (name not in NOT_AWAITED)
            if name != "watch":
                assert not inspect.iscoroutinefunction(blocking[name])
                assert inspect.signature(blocking[name]) == inspect.signature(method)


def test_methods_are_defined_in_the_files_of_their_sources() -> None:
    """Whoever looks for the definition finds the method itself, and what it does."""
    for client, name in ((Client, "functions_blocking"), (AsyncClient, "functions_async")):
        source = importlib.import_module(f"libmodbus_py.client.{name}").__file__
        assert inspect.getsourcefile(client.read_coils) == source
        assert "pdu.ReadCoils(address, count)" in inspect.getsource(client.read_coils)
        assert client.read_coils.__qualname__ == f"{client.__name__}.read_coils"


def test_mocks_are_awaited_and_refuse_what_the_client_refuses() -> None:
    async def main() -> None:
        plc = create_autospec(AsyncClient, instance=True)
        plc.read_coils.return_value = [True]
        assert await plc.read_coils(0, 1) == [True]
        plc.read_coils.assert_awaited_once_with(0, 1)
        with pytest.raises(TypeError, match="device_id"):
            await plc.read_coils(0, 1, device_id=3)

    asyncio.run(main())
    assert create_autospec(Client, instance=True).read_coils.return_value is not None


@each_case("client", [Client, AsyncClient])
def test_help_lists_all_methods_and_options(client: type) -> None:
    # Python 3.13 has a line for each argument of a long signature.
    text = re.sub(r"[|'\s]+", "", pydoc.plain(pydoc.render_doc(client)))
    for name in methods(client):
        assert f"{name}(self" in text
    for option in Options.__annotations__:
        assert f"{option}=" in text
    assert "**wrong" not in text
    assert "read_coils(self,address:int,count:int)->list[bool]" in text


def called(plc: Any, name: str, *arguments: Any, **keywords: Any) -> str:
    """Return the message of the TypeError with which a method refuses its arguments."""

    async def main() -> None:
        result = getattr(plc, name)(*arguments, **keywords)
        if inspect.isawaitable(result):
            await result

    with pytest.raises(TypeError) as caught:
        asyncio.run(main())
    return str(caught.value)


CLIENT = "? it is an argument of the client"


@each_case("make", [Client, AsyncClient])
@each_case(
    ("name", "arguments", "wrong", "close"),
    [
        ("read_holding_registers", (0, 1), "device_id", f"; did you mean unit{CLIENT}"),
        ("read_holding_registers", (0, 1), "unit", "; it is an argument of the client"),
        ("read_holding_registers", (0, 1), "timout", f"; did you mean timeout{CLIENT}"),
        ("read_coils", (), "adress", "; did you mean address?"),
        ("read_coils", (0,), "cuont", "; did you mean count?"),
        ("read_coils", (0, 1), "nonsense", ""),
        ("write_register", (0,), "vaule", "; did you mean value?"),
        ("write_coil", (0, True), "slave", f"; did you mean unit{CLIENT}"),
        ("diagnostics", (0,), "dta", "; did you mean data?"),
        ("report_server_id", (), "device_id", f"; did you mean unit{CLIENT}"),
        ("execute", (), "requst", "; did you mean request?"),
        ("execute_many", ([],), "return_exception", "; did you mean return_exceptions?"),
        ("read_value", ("hr", 0, "float32"), "word_order", "; did you mean order?"),
        ("read_values", ("hr", 0), "data_type", "; did you mean type?"),
        ("write_value", ("hr", 0, 1, "uint16"), "byteorder", "; did you mean order?"),
        ("write_values", ("hr", 0, [1], "string:2"), "pading", "; did you mean padding?"),
        ("read_many", ([],), "gpa", "; did you mean gap?"),
        ("read_map", ({},), "max_register", "; did you mean max_registers or max_bits?"),
        ("write_map", ({}, {}), "multipel", "; did you mean multiple?"),
        ("read_map", (), "mpa", "; did you mean map?"),
        ("watch", ({},), "evry", "; did you mean every?"),
        ("unreadable", (), "waht", "; did you mean what?"),
        ("for_unit", (), "device_id", "; did you mean unit?"),
    ],
)
def test_a_wrong_name_in_a_call(make, name, arguments, wrong, close) -> None:
    plc = make("tcp://127.0.0.1:1")
    message = f"{make.__name__}.{name}() got an unexpected keyword argument {wrong!r}{close}"
    assert called(plc, name, *arguments, **{wrong: 3}) == message
    assert plc.statistics.connects == 0


@each_case("make", [Client, AsyncClient])
def test_methods_refuse_argument_names_of_other_packages(make: Any) -> None:
    plc = make("tcp://127.0.0.1:1")
    for name in methods(make).keys() - {"close"}:
        message = called(plc, name, slave_id=3)
        assert message.startswith(f"{make.__name__}.{name}() got an unexpected keyword")
        assert "did you mean unit?" in message


@each_case("make", [Client, AsyncClient])
def test_a_call_without_an_argument_names_it(make: Any) -> None:
    plc = make("tcp://127.0.0.1:1")
    for name, method in methods(make).items():
        parameters = [
            parameter
            for parameter in inspect.signature(method).parameters.values()
            if parameter.default is parameter.empty and parameter.kind is not parameter.VAR_KEYWORD
        ][1:]
        if parameters:
            assert any(parameter.name in called(plc, name) for parameter in parameters), name
    assert called(plc, "read_coils", 0) == "count must be an integer in 1..2000, not nothing"
    assert called(plc, "read_coils", 0, 1, 2) == (
        f"{make.__name__}.read_coils() takes from 1 to 3 positional arguments but 4 were given"
    )


@each_case("make", [Client, AsyncClient])
def test_a_wrong_name_of_the_url(make: Any) -> None:
    with pytest.raises(TypeError, match="there is no 'host'; did you mean url\\?"):
        make(host="192.0.2.1")
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'url'"):
        make(unit=1)
    with pytest.raises(TypeError, match=r"'device_id' must be one of unit, .*; did you mean unit"):
        make("tcp://192.0.2.1", device_id=1)
