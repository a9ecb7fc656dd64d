"""
The command read: items, ranges, names, and how they are shown.
"""

from __future__ import annotations

import csv
import io
import json

import pytest

from tests.support.cases import each_case
from tests.support.commands import run


@each_case(
    ("words", "printed"),
    [
        ("holding 0 2", "    0  1\n    1  2\n"),
        (
            "holding 0 2 coils 5 file:4 0 2",
            "holding 0  1\nholding 1  2\ncoils   5  1\nfile:4  0  7\nfile:4  1  8\n",
        ),
        ("40001 40502 2", "40001    1\n40502  501\n40503  502\n"),
        ("holding 0x1F4", "  500  500\n"),
        ("holding 0 4 --hex", "    0  0x0001\n    1  0x0002\n    2  0x0003\n    3  0xFFFC\n"),
        ("coils 5 --hex", "    5  1\n"),
        ("--count-from-1 holding 1 2", "    1  1\n    2  2\n"),
        ("--count-from-1 40001", "40001  1\n"),
        ("holding 0 --type int16 --order BADC 2", "    0  256\n    1  512\n"),
        ("holding 20 --type string:4 --encoding utf-8", "   20  'abcd'\n"),
        ("holding 20 --type string:4 --padding d", "   20  'abc'\n"),
        ("fifo 40", "   40  5\n   41  6\n"),
        # A type for one item, and ranges.
        ("hr 0:int16 3", "    0  1\n    1  2\n    2  3\n"),
        ("HR 3:int16 hr 3", "HR 3     -4\nhr 3  65532\n"),
        ("hr 20:string4", "   20  'abcd'\n"),
        ("hr 0:bits16", "    0  1000000000000000\n"),
        ("hr 2:int32 hr 0 --order CDAB", "hr 2  -262141\nhr 0        1\n"),
        ("hr 0-2", "    0  1\n    1  2\n    2  3\n"),
        (
            "hr 0-3:uint32 40001-40002",
            "hr 0    65538\nhr 2   262140\n40001       1\n40002       2\n",
        ),
        ("40501-40502:int16", "40501  500\n40502  501\n"),
        ("file:4 0 --type uint32", "    0  458760\n"),
    ],
)
def test_what_is_read_is_shown(url: str, words: str, printed: str) -> None:
    assert run("read", url, *words.split()) == (0, printed, "")


def test_ranges_take_as_many_requests_as_they_must(url: str) -> None:
    done = run("read", url, "holding", "0", "600", "coils", "0", "100", "-v")
    assert done.out.count("\n") == 700
    requests = [line for line in done.err.splitlines() if " > " in line]
    assert len(requests) == 6  # 600 registers of 125, and 100 coils of 2000
    assert "holding 500    500\n" in done.out
    done = run("read", url, "file:4", "0", "200", "--type", "uint32", "--json", "-v")
    assert json.loads(done.out)["values"] == [0x70008, 0x90000, *[0] * 198]
    lengths = [int(line[-5:].replace(" ", ""), 16) for line in done.err.splitlines()[::2]]
    assert lengths == [120, 120, 120, 40]


def test_names_of_a_map(url: str, meter: str) -> None:
    done = run("read", url, "--map", meter, "voltage", "pump", "label")
    assert done.out == "voltage  230.5 V\npump         0\nlabel    'abcd'\n"
    done = run("read", "--map", meter, url, "phases", "holding", "0")
    assert done.out.splitlines() == [
        "phases[0]   1 A",
        "phases[1]   2 A",
        "phases[2]  -1 A",
        "holding 0   1",
    ]
    whole = json.loads(run("read", url, "--map", meter, "--json").out)
    assert whole["values"] == {
        "voltage": 230.5, "phases": [1, 2, -1], "label": "abcd", "setpoint": 0, "pump": 0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "values"),
    [
        ("holding 0 3", {"address": 0, "table": "holding_registers", "values": [1, 2, 3]}),
        ("coils 5", {"address": 5, "table": "coils", "values": [1]}),
        (
            "coils 5 fifo 40",
            {
                "items": [
                    {"table": "coils", "address": 5, "values": [1]},
                    {"table": "fifo_queue", "address": 40, "values": [5, 6]},
                ]
            },
        ),
    ],
)
def test_json(url: str, words: str, values: dict[str, object]) -> None:
    assert json.loads(run("read", url, *words.split(), "--json").out) == {"unit": 1, **values}


def test_csv(url: str, meter: str) -> None:
    out = run("read", url, "--map", meter, "--csv").out
    header, row = csv.reader(io.StringIO(out))
    assert header == [
        "time", "voltage (V)", "phases[0] (A)", "phases[1] (A)", "phases[2] (A)", "label",
        "setpoint (C)", "pump", "error",
    ]  # fmt: skip
    assert row[1:] == ["230.5", "1", "2", "-1", "abcd", "0.0", "0", ""]
    out = run("read", url, "holding", "0", "2", "coils", "5", "--csv").out
    assert out.startswith("time,holding 0,holding 1,coils 5,error\n")


def test_one_item_that_is_refused_does_not_hinder_the_others(url: str) -> None:
    done = run("read", url, "holding", "0", "holding", "5000", "input", "0")
    assert done.code == 1
    assert done.out == "holding 0     1\ninput   0  2305\n"
    assert done.err.count("\n") == 1
    assert "illegal data address (exception 2)" in done.err
    done = run("read", url, "holding", "0", "holding", "5000", "--json")
    first, second = json.loads(done.out)["items"]
    assert first["values"] == [1]
    assert "exception 2" in second["error"]
    header, row = csv.reader(
        io.StringIO(run("read", url, "holding", "0", "coils", "900", "--csv").out)
    )
    assert header == ["time", "holding 0", "coils 900", "error"]
    assert row[1:3] == ["1", ""]
    assert "exception 2" in row[3]


@each_case(
    ("words", "hint"),
    [
        ("holding 40101", "(holding 40101 counts from 0; the reference 40101 is typed without"),
        ("holding 40101 input 0", "the reference 40101 is typed without holding"),
        ("holding 400101", "not 400101 (holding 400101 counts from 0; the reference 400101"),
        ("coils 00012", "not '00012' (coils 00012 counts from 0; the reference 00012"),
        ("holding 5000", ""),
        ("coils 40101", ""),
    ],
)
def test_references_typed_as_addresses_are_explained(url: str, words: str, hint: str) -> None:
    done = run("read", url, *words.split())
    assert done.code in (1, 2)
    assert hint in done.err
    assert ("reference" in done.err) == bool(hint)
