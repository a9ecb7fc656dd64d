"""
Read and write: values with and without a type, as tables and as JSON.
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


@each_case(
    ("where", "options", "values", "printed"),
    [
        (
            ["holding", "1000"],
            ["--type", "float32", "--order", "CDAB"],
            ["3.14", "-1e5", "-inf", "nan", "1e8"],
            " 1000         3.14\n 1002    -100000.0\n 1004         -inf\n"
            " 1006          nan\n 1008  100000000.0\n",
        ),
        (["41101"], ["--type", "int32"], ["-2"], "41101  -2\n"),
        (
            ["holding", "1110"],
            ["--type", "int16"],
            ["-32768", "0x7f"],
            " 1110  -32768\n 1111     127\n",
        ),
        (["401121"], ["--type", "uint64", "--order", "hgfedcba"], ["5"], "401121  5\n"),
        (["holding", "1130"], ["--type", "float16"], ["0.1"], " 1130  0.1\n"),
        (
            ["holding", "1140"],
            ["--type", "float64"],
            ["0.1", "1e22"],
            " 1140    0.1\n 1144  1e+22\n",
        ),
        (["holding", "1150"], ["--type", "float32"], ["3.4028235e38"], " 1150  3.4028235e+38\n"),
        (["holding", "1160"], ["--type", "bcd32", "--order", "BADC"], ["1234"], " 1160  1234\n"),
        (
            ["holding", "1170"],
            ["--type", "bits16"],
            ["1" + "0" * 14 + "1"],
            " 1170  1000000000000001\n",
        ),
        (
            ["holding", "1180"],
            ["--type", "string:5"],
            ["abc", "a b c"],
            " 1180  'abc'\n 1183  'a b c'\n",
        ),
        (["file:4", "9990"], ["--type", "float32"], ["0.5", "2"], " 9990  0.5\n 9992  2.0\n"),
        (["file:5", "0"], ["--type", "int64", "--order", "DCBA"], ["-1"], "    0  -1\n"),
    ],
)
def test_what_is_written_as_a_type_is_read_as_it(
    url: str, where: list[str], options: list[str], values: list[str], printed: str
) -> None:
    written = run("write", url, *where, *values, *options)
    assert (written.code, written.out, written.err) == (0, "", "")
    done = run("read", url, *where, str(len(values)), *options)
    assert (done.code, done.out, done.err) == (0, printed, "")


def test_every_nan_and_the_largest_floats_are_shown(url: str) -> None:
    for registers, name, shown in (
        ("0xffc0 0", "float32", "nan"),
        ("0xffff 0xffff", "float32", "nan"),
        ("0xff7f 0xffff", "float32", "-3.4028235e+38"),
        ("0x7bff", "float16", "65500.0"),
        ("0x7fef 0xffff 0xffff 0xffff", "float64", "1.7976931348623157e+308"),
    ):
        run("write", url, "holding", "1205", *registers.split())
        done = run("read", url, "holding", "1205", "--type", name)
        assert done.out == f" 1205  {shown}\n"


@each_case(
    ("where", "count", "types"),
    [
        ("input 0", 1, {"int16", "uint16", "float16", "bcd16", "bits16", "string:2"}),
        ("30001", 3, {"string:6"}),
        ("holding 9000", 4, {"int64", "uint64", "float64", "bcd64", "bits64", "string:8"}),
        ("file:7 0", 121, {"string:242"}),
        ("holding 9000", 125, {"string:250"}),
    ],
)
def test_json_of_readings(url: str, where: str, count: int, types: set[str]) -> None:
    found = json.loads(run("read", url, *where.split(), str(count), "--type", "all", "--json").out)
    assert found["registers"] == [0] * count
    assert {row["type"] for row in found["readings"]} == types
    assert {row["order"] for row in found["readings"]} == {"ABCD"}
    assert ("file" in found) == where.startswith("file")
    assert set(found) - {"file"} == {"unit", "table", "address", "registers", "readings"}


@each_case(
    ("name", "typed", "value"),
    [
        ("float32", "0.1", 0.10000000149011612),
        ("bits16", "1" + "0" * 15, [1] + [0] * 15),
        ("string:4", 'a"b', 'a"b'),
        ("uint64", "18446744073709551615", 18446744073709551615),
    ],
)
def test_json_says_type_and_order(url: str, name: str, typed: str, value: object) -> None:
    run("write", url, "file:8", "10", typed, "--type", name, "--order", "dcba")
    done = run("read", url, "file:8", "10", "--type", name, "--order", "dcba", "--json")
    assert json.loads(done.out) == {
        "unit": 1,
        "table": "file",
        "address": 10,
        "file": 8,
        "type": name,
        "order": "DCBA",
        "values": [value],
    }


@each_case(("name", "typed"), [("float32", "nan"), ("float64", "-inf")])
def test_json_has_null_for_what_is_no_number(url: str, name: str, typed: str) -> None:
    run("write", url, "file:8", "10", typed, "--type", name)
    found = json.loads(run("read", url, "file:8", "10", "--type", name, "--json").out)
    assert (found["values"], found["no_value"]) == ([None], {"10": typed})


@each_case("form", [[], ["--json"]])
def test_registers_that_hold_no_such_value_are_exit_code_1(url: str, form: list[str]) -> None:
    run("write", url, "holding", "1500", "0x0001", "0xffff", "0xffff")
    for name, count, named in (
        ("bcd16", "2", "holding registers from 1500: registers[1:2] hold no bcd16: FFFF"),
        ("string:6", "1", "holding registers from 1500: registers[0:3] hold no string:6"),
        ("all", "3", "3 registers can only be text"),
    ):
        done = run("read", url, "holding", "1500", count, "--type", name, *form)
        assert (done.code, done.out) == (1, "")
        assert done.err.startswith(f"libmodbus-py: {named}")
        assert done.err.count("\n") == 1
