"""
The unit and the settings of URLs with the options that were typed.
"""

from __future__ import annotations

import json

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.commands import parsed
from libmodbus_py.cli.connecting import endpoint_of
from tests.support.cases import each_case
from tests.support.commands import run


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
