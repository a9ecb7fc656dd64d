"""
The command serve: what it serves, and what it says when it starts.
"""

from __future__ import annotations

import contextlib
import io
import json

import pytest

from libmodbus_py.cli.serve.running import announce
from libmodbus_py.tools.testing.wires import SerialWire
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import run


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


def test_serve_says_when_a_port_is_taken(url: str) -> None:
    done = run("serve", url)
    assert done.code == 1
    assert done.err == f"libmodbus-py: cannot listen on {url}: Address already in use\n"


@each_case(
    ("urls", "named"),
    [
        (["tcp://0.0.0.0:1"], 1),
        (["tcp://[::]:1"], 1),
        (["rtu+tcp://0.0.0.0:1", "udp://plc.example:502", "tcp://127.0.0.1:1"], 2),
        (["tcp://127.0.0.1:1", "tcp://[::1]:1", "udp://localhost:1", "tcp://127.1.2.3:1"], 0),
        (["tls://0.0.0.0:1", "rtu:///dev/ttyS0", "unix:///run/modbus"], 0),
    ],
)
@each_case("is_guarded", [True, False])
def test_it_says_in_one_line_that_anyone_may_write(
    urls: list[str], named: int, is_guarded: bool
) -> None:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        announce(urls, is_guarded=is_guarded)
    assert out.getvalue().splitlines() == [f"listening on {url}" for url in urls]
    said, named = err.getvalue(), 0 if is_guarded else named
    assert said.count("\n") == (named > 0)
    assert [url for url in urls if url in said] == urls[:named]
    assert ("anyone" in said) == ("--allow" in said) == (named > 0)
