"""
The command demo.
"""

import sys
from pathlib import Path

import pytest

from tests.cli.serving import serving
from tests.support.commands import run


def test_demo_shows_every_example_on_every_line() -> None:
    done = run("demo")
    assert done.code == 0
    assert done.err == ""
    assert "\x1b" not in done.out
    examples = done.out.partition("To try next")[0]
    assert max(map(len, examples.splitlines())) <= 80
    for line in (
        "00 01 00 00 00 06 06 03 00 7A 00 03",
        "06 03 06 03 15 30 39 FD C9 55 7E",
        r":0603007A00037A\r\n",
        r":11140C05060DFE0020050633CD00404E\r\n",
        r":0D86026B\r\n",
    ):
        assert line in done.out
    assert done.out.count("[789, 12345, 64969]") == 3
    assert done.out.count("[[3582, 32], [13261, 64]]") == 3
    assert done.out.count("refused: illegal data address (exception 2)") == 3


@pytest.mark.parametrize("is_found", [True, False])
def test_the_commands_that_demo_prints_at_its_end_work_in_any_folder(
    is_found: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shutil.which", lambda name: name if is_found else None)
    program = ["libmodbus-py"] if is_found else [sys.executable, "-m", "libmodbus_py"]
    lines = [line.split() for line in run("demo").out.partition("To try next")[2].splitlines()]
    assert [words[: len(program)] for words in lines[1:]] == [program] * 3
    serve, read, identify = [words[len(program) :] for words in lines[1:]]
    assert {words[1] for words in (serve, read, identify)} == {"127.0.0.1:1502"}
    with serving("serve", "127.0.0.1:0", *serve[2:]) as (_, url):
        done = run("read", url, *read[2:])
        assert (done.code, done.err) == (0, "")
        assert "voltage" in done.out
        done = run("identify", url, *identify[2:])
        assert (done.code, done.err) == (0, "")
        assert "METER" in done.out
    assert [*tmp_path.iterdir()] == []
