"""
Options: those of URLs, their names, their texts, and what is said of wrong ones.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import pytest

from libmodbus_py import Context, Device, Mapping, Server
from libmodbus_py.cli.arguments import endpoint_of
from libmodbus_py.cli.commands import parsed
from libmodbus_py.ports.schemes import (
    CLIENT_OPTIONS,
    SECURITY_OPTIONS,
    SERIAL_OPTIONS,
)
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.cases import each_case
from tests.support.commands import Started, run
from tests.support.names import resolve

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


@each_case(
    ("arguments", "said"),
    [
        ("read h holding 0 --unit 256", "-u/--unit/--units: '256' must be within 0..255"),
        ("read h holding 0 -u x", "'x' must be a unit, or a range such as 1-247"),
        ("read h holding 0 --timeout 0", "timeout must be"),
        ("read h holding 0 --retries 101", "retries must be in 0..100, not 101"),
        ("read h holding 0 --delimiter 300", "delimiter must be in 0..255"),
        ("read h holding 0 --keepalive x", "argument --keepalive: must be a number of seconds, or"),
        ("read /dev/x holding 0 -d 9", "data_bits must be in 5..8, not 9"),
        ("read /dev/x holding 0 -p mark", "argument -p/--parity: must be none, even or odd"),
        ("read /dev/x holding 0 --rs485 up", 'rs485 must be "kernel"'),
        ("read /dev/x holding 0 --max-in-flight 2", "max_in_flight must be 1 on"),
        ("read h holding 0 --echo", "--echo applies to serial ports only, not to tcp://h:502"),
        ("read h?unit=256 holding 0 --timeout 1", "unit must be in 0..255, not 256"),
        ("identify h --cert own.pem", "--cert applies to tls:// URLs only, not to tcp://h:502"),
        ("serve tcp://h -b 9600", "--baudrate applies to serial ports only, not to tcp://h:502"),
        ("serve tcp://h --max-connections 0", "max_connections must be"),
        ("serve tcp://h --frame-timeout 0", "frame_timeout must be"),
        ("gateway tcp://h --to tcp://b --queue 0", "queue must be in 1..1024, not 0"),
        ("gateway tcp://h --to tcp://b -s 1", "--stop-bits applies to serial ports only"),
        ("listen x.pcapng -b 9600", "--baudrate applies to serial ports only, not to x.pcapng"),
    ],
)
def test_what_is_wrong_names_the_option(arguments: str, said: str) -> None:
    done = run(*arguments.split())
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("libmodbus-py: ")
    assert said in done.err
    assert done.err.count("\n") == 1


@pytest.fixture
def behind() -> Iterator[str]:
    device = Device(Mapping(holding_registers={0: [555]}))
    with Server({7: device}).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_a_gateway_has_options_for_its_devices_and_prints_frames(behind: str) -> None:
    arguments = ["tcp://127.0.0.1:0", "--to", f"7={behind}", "--timeout", "5", "-v"]
    with Started("gateway", *arguments) as process:
        url = process.stdout.readline().removeprefix("listening on ").strip()
        with Context.from_url(url, unit=7) as context:
            assert context.read_holding_registers(0, 1) == [555]
        asked, answered = process.stderr.readline(), process.stderr.readline()
        process.terminate()
        assert process.wait() == 0
    assert " <   7  ReadHoldingRegisters " in asked
    assert " >   7  ReadHoldingRegisters " in answered
    assert answered.endswith("07 03 02 02 2b\n")


def test_serial_settings_are_those_of_the_server_too() -> None:
    with SerialWire() as wire, Started("serve", f"rtu://{wire.server}", "-b", "115200") as process:
        assert process.stdout.readline() == f"listening on rtu://{wire.server}?baudrate=115200\n"
        done = run("read", wire.client, "holding", "5", "-b", "115200", "-p", "even")
        assert (done.code, done.out, done.err) == (0, "    5  0\n", "")
        process.terminate()
        assert process.wait() == 0


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
