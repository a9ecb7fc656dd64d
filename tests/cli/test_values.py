"""
read and write of bits, registers and text, as tables and as JSON.
"""

from __future__ import annotations

import json

from tests.support.cases import each_case
from tests.support.commands import run


@each_case(
    ("where", "values", "printed"),
    [
        (
            ["holding", "100"],
            ["789", "12345", "-567"],
            "  100    789\n  101  12345\n  102  64969\n",
        ),
        (["40201"], ["0xFFFF"], "40201  65535\n"),
        (["coils", "7"], ["on"], "    7  1\n"),
        (["coils", "10"], ["1", "off", "true"], "   10  1\n   11  0\n   12  1\n"),
        (["file:4", "9998"], ["1", "2"], " 9998  1\n 9999  2\n"),
    ],
)
def test_what_is_written_is_read(
    url: str, where: list[str], values: list[str], printed: str
) -> None:
    written = run("write", url, *where, *values)
    assert (written.code, written.out, written.err) == (0, "", "")
    assert run("read", url, *where, str(len(values))).out == printed


def test_json_says_what_was_read(url: str) -> None:
    assert json.loads(run("read", url, "400401", "2", "--json").out) == {
        "unit": 1,
        "table": "holding_registers",
        "address": 400,
        "values": [0, 0],
    }


def test_text_that_begins_with_a_dash_follows_two(url: str) -> None:
    run("write", url, "--type", "string:4", "--", "holding", "1210", "-abc")
    done = run("read", url, "holding", "1210", "--type", "string:4")
    assert done.out == " 1210  '-abc'\n"


def test_control_characters_of_a_device_do_not_reach_the_terminal(url: str) -> None:
    run("write", url, "holding", "1220", "0x1b5b", "0x0a41")
    for name in ("string:4", "all"):
        done = run("read", url, "holding", "1220", "2", "--type", name)
        assert "\x1b" not in done.out
        assert done.out.count("\n") == len(done.out.splitlines())
    assert "'\\x1b[\\nA'" in run("read", url, "holding", "1220", "2", "--type", "all").out


def test_longest_lists_of_values(url: str) -> None:
    values = [str(number) for number in range(61)]
    assert run("write", url, "holding", "1300", *values, "--type", "float32").code == 0
    done = run("read", url, "holding", "1300", "62", "--type", "float32", "--json")
    assert json.loads(done.out)["values"] == [*range(61), 0]
    assert run("write", url, "file:6", "0", *values, "--type", "int32").code == 0
    done = run("read", url, "file:6", "2", "60", "--type", "int32", "--json")
    assert json.loads(done.out)["values"] == [*range(1, 61)]
    done = run("read", url, "input", "0", "1", "--type", "string:250", "--json")
    assert json.loads(done.out)["values"] == [""]
