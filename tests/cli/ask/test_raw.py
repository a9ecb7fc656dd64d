"""
The command raw, and which text it takes.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Mapping
from libmodbus_py.tools.testing.recording import RecordingServer, ServerMaker
from tests.support.cases import each_case
from tests.support.commands import run


@each_case(
    ("words", "code", "said"),
    [
        ("3 0000 0002", 0, "03 04 00 01 00 02\n"),
        ("03 00 00 00 02", 0, "03 04 00 01 00 02\n"),
        ("0x10 00 05 00 01 02 00 07", 0, "10 00 05"),
        ("3 0000 0002", 0, "ReadHoldingRegisters(address=0, count=2): [1, 2]\n"),
        ("0x2B 0E0100", 0, "2b 0e 01"),
        ("7", 0, "07 00\n"),
        ("43 0D0102", 1, "illegal function (exception 1)"),
        ("100 00", 1, "illegal function (exception 1)"),
        ("3 1388 0001", 1, "illegal data address (exception 2)"),
    ],
)
def test_raw(url: str, words: str, code: int, said: str) -> None:
    done = run("raw", url, *words.split())
    assert done.code == code
    assert said in (done.out if code == 0 else done.err)
    assert done.err.count("\n") == (code != 0)


@pytest.fixture
def server() -> Iterator[RecordingServer]:
    with ServerMaker() as maker:
        yield maker(devices=Device(Mapping(holding_registers={0: [1, 2, 3]})))


@each_case(
    "words",
    [
        ["0000", "0002"],
        ["00", "00", "00", "02"],
        ["00 00 00 02"],
        ["00000002"],
        ["0x00000002"],
        ["0x00,0x00, 0x00,02"],
        ["00:00", "0X0002"],
        ["0000,0002,"],
    ],
)
@each_case("function", ["3", "0x03"])
def test_words_of_whole_bytes_are_taken(
    server: RecordingServer, function: str, words: list[str]
) -> None:
    assert run("raw", server.url, function, *words).out.startswith("03 04 00 01 00 02\n")
