"""
Errors: one line on stderr, an exit code, and what to try.
"""

from __future__ import annotations

import re
from pathlib import Path

from libmodbus_py import Device, Mapping
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.cases import each_case
from tests.support.commands import on_terminal, run
from tests.support.peers import FakeServer, mbap

READ = ["read", "tcp://127.0.0.1:1"]
WRITE = ["write", "tcp://127.0.0.1:1"]


@each_case(
    ("arguments", "code", "named"),
    [
        (["read", "tcp://127.0.0.1:1", "coils", "0"], 1, "refused"),
        (["read", "tcp://no-such-host.invalid", "coils", "0"], 1, "no-such-host"),
        (["read", "rtu:///dev/no-such-port", "coils", "0"], 1, "/dev/no-such-port"),
        (["serve", "rtu:///dev/null"], 1, "not a serial port"),
        (["serve", "tcp://127.0.0.1:99999"], 2, "port"),
        (["serve"], 2, "URL"),
        ([], 2, "COMMAND"),
        (["read", "modbus://127.0.0.1", "coils", "0"], 2, "scheme"),
        (["read", "tcp://127.0.0.1:1", "colis", "0"], 2, "colis"),
        (["read", "tcp://127.0.0.1:1", "coils", "x"], 2, "address"),
        (["read", "tcp://127.0.0.1:1", "file", "0"], 2, "file:4"),
        (["read", "tcp://127.0.0.1:1", "file:0", "0"], 2, "file must be in 1..65535"),
        (["read", "tcp://127.0.0.1:1", "coils:1", "0"], 2, "only a file"),
        (["read", "tcp://127.0.0.1:1", "50001"], 2, "50001"),
        (["read", "tcp://127.0.0.1:1", "600007"], 2, "file:N"),
        (["serve", "tcp://127.0.0.1:0", "--own-unit", "1"], 2, "own_unit cannot be given"),
        (["serve", "tcp://127.0.0.1:0", "--own-unit", "one"], 2, "--own-unit"),
        (["write", "tcp://127.0.0.1:1", "coils", "0"], 2, "no value"),
        (["write", "tcp://127.0.0.1:1", "coils", "0", "2"], 2, "'2'"),
        (["write", "tcp://127.0.0.1:1", "holding", "0", "65536"], 2, "-32768..65535"),
        (["write", "tcp://127.0.0.1:1", "input", "0", "1"], 2, "can only be read"),
        ([*READ, "coils", "0", "--type", "int16"], 2, "only holding, input, file have"),
        ([*READ, "10001", "--type", "int16"], 2, "discrete inputs have no type"),
        ([*READ, "coils", "0", "--type", "all"], 2, "coils have no type"),
        ([*READ, "holding", "0", "--type", "int8"], 2, "int16, int32, int64, uint16,"),
        ([*READ, "holding", "0", "--type", ""], 2, "date96, eui48, string:N, not ''"),
        ([*READ, "holding", "0", "--type", "string:251"], 2, "1..250, not 251"),
        ([*READ, "holding", "0", "--type", "int16", "--order", "X"], 2, "ABCD, CDAB, BADC, DCBA"),
        ([*READ, "holding", "0", "--type", "int32", "--order", "AB"], 2, "order of int32"),
        ([*READ, "holding", "0", "32769", "--type", "int32"], 2, "count must be in 1..32768"),
        ([*READ, "holding", "0", "0", "--type", "int32"], 2, "count must be in 1..32768, not 0"),
        ([*READ, "file:1", "0", "--type", "string:250"], 2, "must be in 1..124, not 125"),
        ([*WRITE, "coils", "0", "1", "--type", "int16"], 2, "coils have no type"),
        ([*WRITE, "input", "0", "1", "--type", "int16"], 2, "can only be read"),
        ([*WRITE, "holding", "0", "1", "--order", "CDAB"], 2, "--order needs --type"),
        ([*WRITE, "holding", "0", "1", "--type", "all"], 2, "string:N, not 'all'"),
        ([*WRITE, "holding", "0", "--type", "int16"], 2, "no value"),
        ([*WRITE, "holding", "0", "1", "65536", "--type", "uint16"], 2, "values[1] must be in 0.."),
        ([*WRITE, "holding", "0", "1.5", "--type", "uint16"], 2, "a number, not '1.5'"),
        ([*WRITE, "holding", "0", "x", "--type", "float32"], 2, "value must be a number, not 'x'"),
        ([*WRITE, "holding", "0", "1e400", "--type", "float32"], 2, "value is too large: '1e400'"),
        ([*WRITE, "holding", "0", "1e39", "--type", "float32"], 2, "values[0] must be in -3.4"),
        ([*WRITE, "holding", "0", "12", "--type", "bits16"], 2, "digits 0 and 1"),
        ([*WRITE, "holding", "0", "101", "--type", "bits16"], 2, "must hold 16 bits"),
        ([*WRITE, "holding", "0", "abc", "--type", "string:2"], 2, "0..2 bytes in ascii"),
        ([*WRITE, "holding", "0", *["1"] * 62, "--type", "int32"], 2, "must hold 1..123 values"),
        ([*WRITE, "file:1", "0", *["1"] * 31, "--type", "int64"], 2, "must hold 1..122 values"),
    ],
)
def test_errors_are_one_line_on_stderr(arguments: list[str], code: int, named: str) -> None:
    done = run(*arguments)
    assert done.code == code
    assert done.out == ""
    assert done.err.startswith("libmodbus-py: ")
    assert done.err.count("\n") == 1
    assert named in done.err


@each_case("code", [10, 11])
def test_an_absent_unit_behind_a_gateway_points_to_scan(code: int) -> None:
    with FakeServer(lambda request: [mbap(request, bytes([request[7] | 0x80, code]))]) as server:
        place = f"127.0.0.1:{server.port}"
        for words in (["read", place, "hr", 0], ["write", place, "hr", 0, 1], ["raw", place, 7]):
            done = run(*words)
            assert done.code == 1
            assert done.err.endswith(f"; libmodbus-py scan {place} finds the units that answer\n")
            assert done.err.count("\n") == 1


@each_case("words", [["hr", 0], ["hr", 0, "co", 1], ["-u", "3,4", "hr", 0]])
def test_silence_points_to_scan(words: list[object]) -> None:
    with FakeServer(lambda _: []) as server:
        place = f"127.0.0.1:{server.port}"
        done = run("read", place, *words, "--timeout", "20ms")
        assert done.code == 1
        for line in done.err.splitlines():
            assert line.endswith(f"no answer within 0.02 s; libmodbus-py scan {place} finds the"
                                 " units that answer")  # fmt: skip


def test_other_failures_do_not() -> None:
    with ServerMaker() as maker:
        url = maker(devices=Device(Mapping(holding_registers=2))).url
        for words in (["read", url, "hr", 7], ["write", url, "hr", 7, 1]):
            assert "scan" not in run(*words).err
    assert "scan" not in run("read", "127.0.0.1:1", "hr", 0).err


def test_tls_at_a_server_without(tmp_path: Path) -> None:
    assert run("certificates", tmp_path).code == 0
    papers = ["--cert", tmp_path / "operator.pem", "--key", tmp_path / "operator-key.pem"]
    with FakeServer(None) as server:
        url = f"tls://127.0.0.1:{server.port}"
        done = run("read", url, "hr", 0, *papers, "--ca", tmp_path / "ca.pem")
        assert done.code == 1
        assert "no TLS handshake" in done.err
        assert "is it tcp://?" in done.err


# --- colour on terminals ----------------------------------------------------------


def shown_on_terminal(*words: str, **environment: str) -> str:
    with on_terminal(*words, environment={"NO_COLOR": "", **environment}) as terminal:
        return terminal.read_to_end().replace("\r\n", "\n")


def without_styles(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@each_case(
    "words",
    [
        ("read", "192.0.2.10", "nonsense"),  # found by the command
        ("read", "--nonsense"),  # by argparse
        ("nonsense",),
        ("read", "127.0.0.1:1", "hr", "0"),  # by the system
    ],
)
def test_an_error_begins_in_red(words: tuple[str, ...]) -> None:
    shown = shown_on_terminal(*words)
    assert shown.startswith("\x1b[1;31mlibmodbus-py:\x1b[0m ")
    assert without_styles(shown) == run(*words).err


@each_case("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_colour_is_left_out_where_it_is_not_wanted(environment: dict[str, str]) -> None:
    assert "\x1b" not in shown_on_terminal("read", "--nonsense", **environment)


def test_colour_of_errors_follows_stderr() -> None:
    assert "\x1b" not in run("read", "--nonsense").err
