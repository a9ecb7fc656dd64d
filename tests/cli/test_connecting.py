"""
Endpoints and clients of the command line.
"""

from __future__ import annotations

import json

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.commands import parsed
from libmodbus_py.cli.connecting import endpoint_of
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.names import resolve


@each_case(
    ("query", "options", "unit"),
    [("?unit=7&timeout=5", [], 7), ("?unit=7", ["--unit", "9"], 9), ("", [], 1)],
)
def test_the_unit_is_that_of_the_url_unless_it_is_told(
    query: str, options: list[str], unit: int
) -> None:
    devices = {each: Device(Mapping(coils=each)) for each in (1, 7, 9)}
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        where = [running.urls[0] + query, "coils", str(unit - 1)]
        done = run("read", *where, "--json", "-v", *options)
        assert json.loads(done.out)["unit"] == unit
        assert run("write", *where, "1", *options).code == 0
    assert devices[unit].mapping.coils[unit - 1]


@each_case(("flag", "echo"), [("--echo", True), ("--no-echo", False)])
def test_an_echo_is_set_for_lines_behind_a_converter_too(flag: str, echo: bool) -> None:
    options = parsed(["read", "rtu+tcp://h:4001", "coils", "0", flag])
    assert endpoint_of(options).options == {"echo": echo}


@each_case(
    ("where", "said"),
    [
        (["127.0.0.1:1"], "cannot connect to 127.0.0.1:1"),
        (["plc.example:1"], "cannot connect to plc.example:1"),
        (["[::1]:1"], "cannot connect to [::1]:1"),
        (["127.0.0.1:1?unit=9"], "unit 9: cannot connect"),
        (["127.0.0.1:1?unit=9", "-u", "8"], "unit 8: cannot connect"),
        (["/dev/no-such", "-b", "9600", "-p", "none", "-s", "2"], "cannot open /dev/no-such"),
        (["./no-such"], "no-such: No such file"),
        (["127.0.0.1:1", "-b", "9600"], "--baudrate applies to serial ports only"),
        (["tcp://127.0.0.1:1", "-s", "2"], "--stop-bits applies to serial ports only"),
        (["/dev/no-such", "-p", "mark"], "must be none, even or odd"),
        (["http://127.0.0.1"], "scheme must be one of"),
        (["a b:c:d"], "'a b:c:d'"),
        (["user@host"], "must be a URL"),
        ([""], "must be a URL"),
    ],
)
def test_endpoints_without_a_scheme(
    monkeypatch: pytest.MonkeyPatch, where: list[str], said: str
) -> None:
    resolve(monkeypatch, "plc.example")
    done = run("read", *where, "holding", "0")
    assert done.code in (1, 2)
    assert said in done.err
    assert done.err.count("\n") == 1
