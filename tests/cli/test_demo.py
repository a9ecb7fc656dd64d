"""
The command demo.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.serving import serving
from tests.support.commands import on_terminal, run


def test_demo_shows_every_example_on_every_line() -> None:
    done = run("demo")
    assert done.code == 0
    assert done.err == ""
    assert "\x1b" not in done.out
    assert max(map(len, done.out.splitlines())) <= 80
    for line in (
        "00 01 00 00 00 06 06 03 00 7A 00 03",
        "06 03 06 03 15 30 39 FD C9 55 7E",
        r":0603007A00037A\r\n",
        r":11140C05060DFE0020050633CD00404E\r\n",
        r":0D86026B\r\n",
    ):
        assert line in done.out
    assert done.out.count("789  12345  -567") == 3
    assert done.out.count("0DFE 0020   33CD 0040") == 3
    assert done.out.count("refused: illegal data address (exception 2)") == 3


def test_the_commands_that_demo_prints_at_its_end_work_in_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line.split() for line in run("demo").out.splitlines() if "libmodbus-py " in line]
    serve, read, identify = [words[1:] for words in lines if words[0] == "libmodbus-py"]
    assert {words[1] for words in (serve, read, identify)} == {"127.0.0.1:1502"}
    with serving("127.0.0.1:0", options=serve[2:]) as (url,):
        done = run("read", url, *read[2:])
        assert (done.code, done.err) == (0, "")
        assert "voltage" in done.out
        done = run("identify", url, *identify[2:])
        assert (done.code, done.err) == (0, "")
        assert "METER" in done.out
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(("environment", "colour"), [({}, True), ({"NO_COLOR": "1"}, False)])
def test_demo_has_colour_on_a_terminal_only(environment: dict[str, str], colour: bool) -> None:
    with on_terminal("demo", environment=environment) as terminal:
        shown = terminal.read_to_end()
        assert terminal.process.wait() == 0
    assert ("\x1b[32m" in shown) == colour
