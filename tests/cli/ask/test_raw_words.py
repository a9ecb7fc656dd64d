"""
The command raw: which hexadecimal text it takes.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Mapping
from libmodbus_py.tools.testing.recording import RecordingServer, ServerMaker
from tests.support.cases import each_case
from tests.support.commands import run


@pytest.fixture
def server() -> Iterator[RecordingServer]:
    with ServerMaker() as maker:
        yield maker(devices=Device(Mapping(holding_registers={0: [1, 2, 3]})))


@each_case("words", ["0 0 0 2", "000 0002", "0000 000 2", "0000 2", "00 0 0 02", "0x00000002", ""])
def test_words_that_are_no_whole_bytes_are_refused(server: RecordingServer, words: str) -> None:
    done = run("raw", server.url, 3, *(words.split() or ["0"]))
    assert done.code == 2
    assert "HEX must be pairs of hex digits, not '" in done.err
    assert not server.transactions


@each_case("words", [["0000", "0002"], ["00", "00", "00", "02"], ["00 00 00 02"], ["00000002"]])
def test_words_of_whole_bytes_are_taken(server: RecordingServer, words: list[str]) -> None:
    assert run("raw", server.url, 3, *words).out.startswith("03 04 00 01 00 02\n")
