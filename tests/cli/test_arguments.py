"""
Options: those of URLs have the same names, and apply to clients, servers and gateways.
"""

from __future__ import annotations

import json
import re

from libmodbus_py import Context, Device, Mapping, Server
from libmodbus_py.cli.arguments import endpoint_of
from libmodbus_py.cli.commands import parsed
from libmodbus_py.ports.schemes import (
    CLIENT_OPTIONS,
    SECURITY_OPTIONS,
    SERIAL_OPTIONS,
)
from libmodbus_py.tools.testing.wires import SerialWire
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import run

CLIENTS = ["read", "write", "identify", "diagnose", "raw", "map from-device"]

# Command -> the options of clients that it has not.
WITHOUT: dict[str, set[str]] = {"scan": {"unit"}, "gateway": {"unit", "native"}}

TAKING = [*CLIENTS, *WITHOUT]


@each_case("command", [*TAKING, "serve"])
def test_options_of_urls_are_those_of_the_command_line(command: str) -> None:
    text = run(*command.split(), "--help-all").out
    has = {name.replace("-", "_") for name in re.findall("--([a-z][a-z0-9-]*)", text)}
    expected = {*SERIAL_OPTIONS, *SECURITY_OPTIONS}
    if command != "serve":
        expected |= CLIENT_OPTIONS.keys() - WITHOUT.get(command, set())
    assert expected - has == set()


def test_a_gateway_has_options_for_its_devices_and_prints_frames(device: str) -> None:
    arguments = ["tcp://127.0.0.1:0", "--to", f"7={device}", "--timeout", "5", "-v"]
    with serving("gateway", *arguments) as (process, url):
        with Context.from_url(url, unit=7) as context:
            context.write_register(0, 555)
        asked, answered = process.stderr.readline(), process.stderr.readline()
    assert " <   7  WriteRegister " in asked
    assert " >   7  WriteRegister " in answered
    assert answered.endswith("07 06 00 00 02 2b\n")


def test_serial_settings_are_those_of_the_server_too() -> None:
    with (
        SerialWire() as wire,
        serving("serve", f"rtu://{wire.server}", "-b", "115200") as (_, url),
    ):
        assert url == f"rtu://{wire.server}?baudrate=115200"
        done = run("read", wire.client, "holding", "5", "-b", "115200", "-p", "even")
        assert (done.code, done.out, done.err) == (0, "    5  0\n", "")


# --- endpoints -----------------------------------------------------------------------


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
