"""
Text from devices with quotes, line ends and control characters: each reader of a file gets the
same text back, and a terminal obeys none of it.
"""

import asyncio
import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping
from libmodbus_py.files.csv_text import csv_rows
from libmodbus_py.fleet import Reading
from libmodbus_py.protocol.plain import without_controls
from libmodbus_py.services.fleet.outputs.line_file import CsvOutput, JsonOutput, LineFile
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.cases import each_case
from tests.support.commands import on_terminal, run
from tests.support.outputs import write

CHARACTERS = [chr(code) for code in range(0xA0)] + ["\u2028", "\u2029", "\u202e", "é"]

TEXTS = [
    *CHARACTERS,
    *(f"a{character}b" for character in CHARACTERS),
    'a,"b"\r\nc',
    "\x1b[31mred\x1b[0m",
    "\x9b2J",
]

OBEYED = {chr(code) for code in [*range(0x20), *range(0x7F, 0xA0)]} - {"\n"}
"""What a terminal obeys."""


def reading(value: str) -> Reading:
    return Reading(100.0, "a", "name", value, "m", "good")


def written(output: LineFile, *readings: Reading) -> None:
    asyncio.run(write(output, readings))


@each_case("text", TEXTS)
def test_readers_of_csv_get_the_text_back(text: str) -> None:
    for rows in ([[text]], [["a", text, 1, None, 2.5]], [["x"], [text, text], ["y"]]):
        written_text = csv_rows(rows)
        cells = [["" if cell is None else str(cell) for cell in row] for row in rows]
        if any(row != [""] for row in cells):
            assert list(csv.reader(io.StringIO(written_text, newline=""), strict=True)) == cells
        # Control characters are in quotes, whatever a reader takes for the end of a row.
        outside = "".join(written_text.split('"')[::2])
        assert not OBEYED & set(outside)


def test_rows_from_an_iterator_are_all_written() -> None:
    assert csv_rows(iter(row) for row in [["a", 1], ["\x06", 2]]) == '"a",1\n"\x06",2\n'


def test_csv_and_json_files_contain_the_text_unchanged(tmp_path: Path) -> None:
    written(CsvOutput(str(tmp_path / "csv")), *map(reading, TEXTS))
    with (tmp_path / "csv").open(newline="") as file:
        assert [row[3] for row in csv.reader(file, strict=True)][1:] == TEXTS
    written(JsonOutput(str(tmp_path / "json")), *map(reading, TEXTS))
    data = (tmp_path / "json").read_bytes()
    lines = data.decode().split("\n")[:-1]
    assert [json.loads(line)["value"] for line in lines] == TEXTS
    assert not OBEYED & set(data.decode())


def test_text_for_a_terminal_has_no_control_characters() -> None:
    assert not OBEYED & set(without_controls("".join(CHARACTERS)))
    assert without_controls("\x1b[31m\x9b\r\n") == "\\x1b[31m\\x9b\\x0d\n"


HOSTILE = "\x1b[5m\r\x07\x9b"


@pytest.fixture
def url() -> Iterator[str]:
    text = HOSTILE.encode("latin-1") + b"x"
    registers = [int.from_bytes(text[at : at + 2], "big") for at in range(0, len(text), 2)]
    with ServerMaker() as maker:
        yield maker(devices=Device(Mapping(holding_registers={0: registers}))).url


WORDS = ["holding", "0", "--type", "string:8", "--encoding", "latin-1"]

FLEET = """
[[device]]
name = "one"
url = "{url}"
[[device.point]]
name = "text"
table = "holding_registers"
address = 0
type = "string:8"
encoding = "latin-1"
"""


@each_case(
    "words",
    [
        ["read", "{url}", *WORDS],
        ["read", "{url}", *WORDS, "--csv"],
        ["read", "{url}", *WORDS, "--json"],
        ["poll", "{fleet}", "--once", "--csv", "-"],
        ["poll", "{fleet}", "--once", "--json", "-"],
    ],
)
def test_commands_print_no_control_characters(url: str, tmp_path: Path, words: list[str]) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(FLEET.format(url=url))
    with on_terminal(*(word.format(url=url, fleet=fleet) for word in words)) as terminal:
        text = terminal.read_to_end()
    assert "5m" in text
    assert not OBEYED & set(text.replace("\r\n", "\n"))


def test_read_writes_csv_that_readers_understand(url: str) -> None:
    rows = list(csv.reader(io.StringIO(run("read", url, *WORDS, "--csv").out, newline="")))
    assert rows[1][1] == f"{HOSTILE}x"


def test_messages_print_hostile_text_without_control_characters(tmp_path: Path) -> None:
    result = run("read", "127.0.0.1:1", "holding", "0", "--map", tmp_path / "\x1b[31m")
    assert result.code != 0
    assert not OBEYED & set(result.err)
