"""
Options: those of URLs have the same names, and apply to clients, servers and gateways; those of
other programs have equivalents.
"""

import json
import re

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.cli.arguments import endpoint_of
from libmodbus_py.cli.commands import parse_arguments
from libmodbus_py.cli.foreign import OPTIONS
from libmodbus_py.ports.options import CLIENT_OPTIONS, SERIAL_OPTIONS
from libmodbus_py.ports.schemes import SECURITY_OPTIONS
from tests.cli.serving import serving
from tests.docs.test_other_tools import rows
from tests.support.cases import each_case
from tests.support.commands import run

CLIENTS = ["read", "write", "identify", "diagnose", "raw", "map from-device"]

# Command -> the options of clients that it has not.
WITHOUT: dict[str, set[str]] = {"scan": {"unit"}, "gateway": {"unit"}}

TAKING = [*CLIENTS, *WITHOUT]


@each_case("command", [*TAKING, "serve"])
def test_options_of_urls_are_those_of_the_command_line(command: str) -> None:
    text = run(*command.split(), "--help-all").out
    has = {name.replace("-", "_") for name in re.findall("--([a-z][a-z0-9-]*)", text)}
    names = {*SERIAL_OPTIONS, *SECURITY_OPTIONS}
    if command != "serve":
        names |= CLIENT_OPTIONS.keys() - WITHOUT.get(command, set())
    assert names - has == set()


def test_a_gateway_has_options_for_its_devices_and_prints_frames(device: str) -> None:
    arguments = ["tcp://127.0.0.1:0", "--to", f"7={device}", "--timeout", "5", "-v"]
    with serving("gateway", *arguments) as (process, url):
        with Client(url, unit=7) as context:
            context.write_register(0, 555)
        request, answer = process.stderr.readline(), process.stderr.readline()
    assert " <   7  WriteRegister " in request
    assert " >   7  WriteRegister " in answer
    assert answer.endswith("07 06 00 00 02 2b\n")


@each_case(
    ("query", "options", "unit"),
    [("?unit=7&timeout=5", [], 7), ("?unit=7", ["--unit", "9"], 9), ("", [], 1)],
)
def test_the_unit_is_that_of_the_url_by_default(query, options, unit) -> None:
    devices = {number: Device(Mapping(coils=number)) for number in (1, 7, 9)}
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        where = [running.urls[0] + query, "coils", str(unit - 1)]
        result = run("read", *where, "--json", "-v", *options)
        assert json.loads(result.out)["unit"] == unit
        assert run("write", *where, "1", *options).code == 0
    assert devices[unit].mapping.coils[unit - 1]


@each_case(("flag", "echo"), [("--echo", True), ("--no-echo", False)])
def test_an_echo_is_set_for_lines_behind_a_converter_too(flag: str, echo: bool) -> None:
    options = parse_arguments(["read", "rtu+tcp://h:4001", "coils", "0", flag])
    assert endpoint_of(options).options == {"echo": echo}


@each_case(
    ("words", "message"),
    [
        ("-m enc h", "-m enc: type HOST, udp://HOST, rtu+tcp://HOST:PORT, /dev/ttyUSB0 or"),
        ("h -a 1:3,17", "-a 1:3,17: type -u 1-3,17"),
        ("h -a 1 -r 11 -c 2", "-a 1: type -u 1; -r 11: type hr 10, because hr counts from 0;"),
        ("h -r x", "-r x: type hr N, which"),
        ("h -c 2", "-c 2: type hr N 2"),
        ("h -t 3", "-t 3: type co, di, ir or hr N for 0, 1, 3 or 4; --hex, or --type,"),
        ("h hr 0 -B", "-B: type no --order"),
        ("h hr 0 -1", "-1: type nothing, because a read without --watch polls once"),
        ("h hr 0 -0", "-0: type hr 0, which counts from 0"),
        ("h hr 0 -l 500", "-l 500: type --watch 500ms"),
        ("h hr 0 -p 1502", "-p 1502: type HOST:1502"),
        ("h hr 0 -s 17", "-s 17: type -u 17"),
        ("h --port 1502", "--port 1502: type HOST:1502"),
        ("h --port=1502", "--port 1502: type HOST:1502"),
        ("h --slave 3", "--slave 3: type -u 3"),
        ("h --id", "--id: type -u N"),
        ("h --function 43", "--function 43: type co, di, hr or ir N for 1 to 4, write HOST"),
        ("--host h hr 0", "--host h: type h without an option"),
    ],
)
@each_case("command", ["read", "write", "identify"])
def test_an_option_of_another_program_has_its_equivalent(command, words, message) -> None:
    if command == "write" and words.endswith(("-1", "-0")):  # there these are values
        return
    result = run(command, *words.split())
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith(f"libmodbus-py: {message}")
    assert result.err.count("\n") == 1


def test_options_and_values_of_this_package_differ_from_those_of_others() -> None:
    for words in (
        "read 127.0.0.1:1 hr 0 -p none -s 2 --timeout 1",
        "write 127.0.0.1:1 hr 0 -1 -4",
        "write 127.0.0.1:1 --type string:2 -- hr 0 -m",
        "map check sdm120 -u 3 --device 127.0.0.1:1",
    ):
        assert ": type " not in run(*words.split()).err
    for words in ("hr -1", "hr 0 --timeout -1"):
        assert ": type " not in run("read", "127.0.0.1:1", *words.split()).err


@each_case("tool", ["mbpoll", "modpoll"])
def test_each_option_in_the_table_of_another_program_is_an_option_here(tool: str) -> None:
    theirs = {text.split()[0].strip("`,") for text, _ in rows(tool)}
    ours = {"-b", "-u", "-v", "-m"}  # which mean something here, too
    assert {their for their in theirs if their.startswith("-")} - ours <= set(OPTIONS)


def test_a_command_that_is_left_out_reads() -> None:
    device = Device(Mapping(holding_registers={10: [7, 8]}))
    with Server(device).background("tcp://127.0.0.1:0") as running:
        place = running.urls[0].removeprefix("tcp://")
        assert run(place, "hr", "10", "2") == (0, "   10  7\n   11  8\n", "")
        assert run("-u", "3", running.urls[0], "40011") == (0, "40011  7\n", "")
