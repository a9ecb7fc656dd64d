"""
Options and words of other programs: one line says what is typed in their place.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.foreign import OPTIONS
from tests.docs.test_other_tools import rows
from tests.support.cases import each_case
from tests.support.commands import run


@each_case(
    ("words", "said"),
    [
        ("-m enc h", "-m enc: type HOST, udp://HOST, rtu+tcp://HOST:PORT, /dev/ttyUSB0 or"),
        ("h -a 1:3,17", "-a 1:3,17: type -u 1-3,17"),
        (
            "h -a 1 -r 11 -c 2",
            "-a 1: type -u 1; -r 11: type hr 10, because hr counts from 0;",
        ),
        ("h -r x", "-r x: type hr N, which"),
        ("h -c 2", "-c 2: type hr N 2"),
        (
            "h -t 3",
            "-t 3: type co, di, ir or hr N for 0, 1, 3 or 4; --hex, or --type,",
        ),
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
        (
            "h --function 43",
            "--function 43: type co, di, hr or ir N for 1 to 4, write HOST",
        ),
        ("--host h hr 0", "--host h: type h without an option"),
    ],
)
@each_case("command", ["read", "write", "identify"])
def test_an_option_of_another_program_has_its_equivalent(
    command: str, words: str, said: str
) -> None:
    if command == "write" and words.endswith(("-1", "-0")):  # there these are values
        return
    done = run(command, *words.split())
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"libmodbus-py: {said}")
    assert done.err.count("\n") == 1


def test_options_and_values_of_ours_are_none_of_theirs() -> None:
    for words in (
        "read 127.0.0.1:1 hr 0 -p none -s 2 --timeout 1",
        "write 127.0.0.1:1 hr 0 -1 -4",
        "write 127.0.0.1:1 --type string:2 -- hr 0 -m",
        "map check sdm120 -u 3 --device 127.0.0.1:1",
    ):
        assert ": type " not in run(*words.split()).err
    for words in ("hr -1", "hr 0 --timeout -1"):
        assert ": type " not in run("read", "127.0.0.1:1", *words.split()).err


@pytest.mark.parametrize("tool", ["mbpoll", "modpoll"])
def test_every_option_of_the_page_about_them_has_one(tool: str) -> None:
    theirs = {text.split()[0].strip("`,") for text, _ in rows(tool)}
    ours = {"-b", "-u", "-v", "-m"}  # which mean something here, too
    assert {each for each in theirs if each.startswith("-")} - ours <= set(OPTIONS)


# --- a device in place of a command ---------------------------------------------------------


def test_a_command_that_is_left_out_reads() -> None:
    device = Device(Mapping(holding_registers={10: [7, 8]}))
    with Server(device).background("tcp://127.0.0.1:0") as running:
        place = running.urls[0].removeprefix("tcp://")
        assert run(place, "hr", "10", "2") == (0, "   10  7\n   11  8\n", "")
        assert run("-u", "3", running.urls[0], "40011") == (0, "40011  7\n", "")
