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
        ("3 xyz", 2, "HEX must be pairs of hex digits, not 'xyz'"),
        ("200", 2, "function must be in 1..127"),
        ("three", 2, "function must be a number"),
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


@each_case("words", ["0 0 0 2", "000 0002", "0000 000 2", "0000 2", "00 0 0 02", "0x0000000", ""])
def test_words_that_are_no_whole_bytes_are_refused(server: RecordingServer, words: str) -> None:
    done = run("raw", server.url, 3, *(words.split() or ["0"]))
    assert done.code == 2
    assert "HEX must be pairs of hex digits, not '" in done.err
    assert not server.transactions


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


@each_case(("byte", "other"), [("10", "0x0a"), ("16", "0x10"), ("43", "0x2b")])
def test_a_byte_that_could_be_decimal_is_refused(byte: str, other: str) -> None:
    done = run("raw", "127.0.0.1:1", byte, "00", "01")
    assert done.code == 2
    assert f"FUNCTION {byte} can be 0x{byte} or {other}" in done.err
