"""
Errors: one line on stderr, an exit code, and what to try.
"""

import re
from pathlib import Path

from libmodbus_py import Device, Mapping
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.cases import each_case
from tests.support.commands import on_terminal, run
from tests.support.peers import FakeServer, mbap


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
