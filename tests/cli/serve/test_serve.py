"""
The command serve: what it serves, and what it says when it starts.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from libmodbus_py.cli.serve.running import announce
from libmodbus_py.tools.testing.wires import SerialWire
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import Started, run


def test_serve_has_all_tables_and_files_for_every_unit(url: str) -> None:
    for unit, *where in (
        ("1", "coils", "0", "2000"),
        ("247", "discrete", "65535"),
        ("0", "holding", "65411", "125"),
        ("255", "input", "65535", "1"),
        ("9", "file:1", "0"),
        ("9", "file:10", "9900", "100"),
    ):
        done = run("read", url, *where, "--unit", unit, "--json")
        assert done.code == 0, done.err
        assert set(json.loads(done.out)["values"]) == {0}


@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_serial_ports_are_served_and_read(kind: str) -> None:
    with SerialWire() as wire, serving(f"{kind}://{wire.server}?baudrate=115200"):
        client = f"{kind}://{wire.client}?baudrate=115200"
        assert run("write", client, "holding", "5", "42").code == 0
        assert run("read", client, "holding", "5").out == "    5  42\n"


def test_a_server_has_no_options_of_clients() -> None:
    done = run("serve", "tcp://127.0.0.1:0?unit=7")
    assert done.code == 2
    assert "unit is for clients" in done.err


def test_serve_says_when_a_port_is_taken(url: str) -> None:
    done = run("serve", url)
    assert done.code == 1
    assert done.err == f"libmodbus-py: cannot listen on {url}: Address already in use\n"


@each_case(
    ("arguments", "named"),
    [
        (["tcp://0.0.0.0:0"], 1),
        (["tcp://[::]:0"], 1),
        (["rtu+tcp://0.0.0.0:0", "udp://0.0.0.0:0", "tcp://127.0.0.1:0"], 2),
        (["tcp://127.0.0.1:0", "tcp://[::1]:0", "udp://127.0.0.1:0", "tcp://127.1.2.3:0"], 0),
        (["tcp://0.0.0.0:0", "--allow", "192.0.2.0/24"], 0),
    ],
)
def test_serve_says_in_one_line_that_anybody_may_write(arguments: list[str], named: int) -> None:
    urls = [each for each in arguments if "://" in each]
    with Started("serve", *arguments) as process:
        listening = [process.stdout.readline().split()[-1] for _ in urls]
        process.terminate()
        _, said = process.communicate()
    assert said.count("\n") == (named > 0)
    assert [url for url in listening if url in said] == listening[:named]
    assert ("anyone" in said) == ("--allow" in said) == (named > 0)


# --- what it says when it listens -------------------------------------------------


def test_localhost_is_open_to_nobody_else(capsys: pytest.CaptureFixture[str]) -> None:
    announce(["udp://localhost:502", "tcp://plc.example:502"], is_guarded=False)
    warning = capsys.readouterr().err
    assert "tcp://plc.example:502 can read and write" in warning
    assert "localhost" not in warning


# --- wrong device files -----------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read {}: No such file or directory"),
        ("[[unit]]\nid = 999", "{}, line 2: unit[0].id must be in 0..255, not 999"),
        ("[[unit]", "{}: Expected ']]' at the end of an array declaration (at line 1, column 7)"),
    ],
)
def test_a_wrong_file_is_one_line_and_exit_code_2(
    content: str | None, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "device.toml"
    if content is not None:
        path.write_text(content)
    done = run("serve", "tcp://127.0.0.1:0", "--device", path)
    assert done.code == 2
    assert done.out == ""
    assert done.err.startswith(f"libmodbus-py: {message.format(path)}")
    assert done.err.count("\n") == 1
