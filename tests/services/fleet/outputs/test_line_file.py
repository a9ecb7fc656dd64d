"""
Files of readings while others rename, delete, empty or break them; and a standard output that
does not block.
"""

import asyncio
import contextlib
import csv
import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.kinds import make_output
from libmodbus_py.services.fleet.outputs.line_file import CsvOutput, JsonOutput, LineFile
from tests.support.cases import each_case

HEADER = b"time,device,name,value,unit,quality,reason\n"

KINDS: dict[str, Callable[[str], LineFile]] = {"json": JsonOutput, "csv": CsvOutput}


def reading(value: Any) -> Reading:
    return Reading(100.0, "a", "level", value, "m", "good")


def write(output: Any, *steps: Reading | Callable[[], object]) -> None:
    """Open an output, write readings and do what stands between them, and close it."""

    async def go() -> None:
        try:
            await output.open_output()
            for step in steps:
                if isinstance(step, Reading):
                    await output.write_readings([step])
                else:
                    step()
        finally:
            await output.close_output()

    asyncio.run(go())


def values(kind: str, path: Path) -> list[str]:
    """Return the values in a file, each as text; every line must be whole."""
    if kind == "json":
        return [str(json.loads(line)["value"]) for line in path.read_bytes().split(b"\n")[:-1]]
    with path.open(newline="") as file:
        rows = list(csv.reader(file, strict=True))
    assert ",".join(rows[0]).encode() + b"\n" == HEADER
    return [row[3] for row in rows[1:]]


@pytest.mark.parametrize("kind", KINDS)
class TestOthers:
    """Other programs change the file while it is open."""

    @pytest.mark.parametrize("way", ["renamed", "created", "deleted", "emptied"])
    def test_a_new_file_begins_with_the_next_reading(self, tmp_path: Path, kind: str, way: str):
        path, old = tmp_path / "now", tmp_path / "old"

        def change() -> None:
            if way in ("renamed", "created"):
                path.rename(old)
            if way == "created":  # by logrotate
                path.touch()
            if way == "deleted":
                path.unlink()
            if way == "emptied":
                os.truncate(path, 0)

        write(KINDS[kind](str(path)), reading(1), change, reading(2), reading(3))
        assert values(kind, path) == ["2", "3"]
        if old.exists():
            assert values(kind, old) == ["1"]

    def test_a_missing_folder_is_a_temporary_error(self, tmp_path: Path, kind: str) -> None:
        folder = tmp_path / "folder"
        folder.mkdir()
        output = KINDS[kind](str(folder / "now"))
        away = lambda: folder.rename(tmp_path / "away")  # noqa: E731
        with pytest.raises(FileNotFoundError):
            write(output, reading(1), away, reading(2))
        folder.mkdir()
        write(output, reading(2))
        assert values(kind, folder / "now") == ["2"]

    def test_a_file_is_continued_after_its_last_line(self, tmp_path: Path, kind: str) -> None:
        path = tmp_path / "now"
        for value in (1, 2, 3):
            write(KINDS[kind](str(path)), reading(value))
        assert values(kind, path) == ["1", "2", "3"]
        assert b"\n\n" not in path.read_bytes()

    def test_a_closed_file_leaves_no_descriptor_open(self, tmp_path: Path, kind: str) -> None:
        path = tmp_path / "now"
        before = len(os.listdir("/proc/self/fd"))
        write(KINDS[kind](str(path)), *[reading(1), path.unlink] * 10)
        assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("kind", KINDS)
@each_case("value", [1, "x", 'a "word"', "two\nlines", 'one",\n"', '"'])
def test_half_a_line_of_a_crash_is_ended_before_the_next_one(tmp_path: Path, kind: str, value: Any):
    path = tmp_path / "now"
    path.unlink(missing_ok=True)
    write(KINDS[kind](str(path)), reading(0))
    size = path.stat().st_size
    write(KINDS[kind](str(path)), reading(value))
    whole = path.read_bytes()
    for cut in range(size + 1, len(whole)):
        if whole[cut - 1 : cut] == b"\n":  # looks like a whole line
            continue
        path.write_bytes(whole[:cut])
        write(KINDS[kind](str(path)), reading(7))
        if kind == "json":
            lines = path.read_bytes().split(b"\n")
            assert [json.loads(lines[at])["value"] for at in (0, -2)] == [0, 7]
        else:
            with path.open(newline="") as file:
                rows = list(csv.reader(file, strict=True))
            assert [rows[at][1:4] for at in (1, -1)] == [["a", "level", "0"], ["a", "level", "7"]]


def test_half_a_line_of_an_unreadable_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "now"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with contextlib.closing(os.fdopen(reader, "rb")) as pipe:
        write(JsonOutput(str(path)), reading(1))
        assert json.loads(pipe.read())["value"] == 1


KEY = b"-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2Vw\n"


@each_case("kind", ["json", "csv", "influx"])
@each_case("content", [KEY, b"#!/bin/sh\nexit 0\n", b"\n", b"secret", b"\xef\xbb\xbf" + HEADER])
def test_a_file_without_readings_is_not_changed(tmp_path, kind, content) -> None:
    path = tmp_path / "theirs"
    path.write_bytes(content)
    with pytest.raises(OSError, match=r"does not begin with .* rename the file") as caught:
        write(make_output(kind, {"path": str(path)}), reading(1))
    assert path.read_bytes() == content
    assert b"BEGIN" not in str(caught.value).encode()


def test_a_file_that_replaces_that_of_the_output_is_not_changed(tmp_path: Path) -> None:
    path, theirs = tmp_path / "now", tmp_path / "theirs"
    theirs.write_bytes(KEY)
    with pytest.raises(OSError, match="does not begin"):
        write(CsvOutput(str(path)), reading(1), lambda: theirs.replace(path), reading(2))
    assert path.read_bytes() == KEY


def test_a_file_with_other_columns_is_not_continued(tmp_path: Path) -> None:
    path = tmp_path / "now"
    write(CsvOutput(str(path)), reading(1))
    before = path.read_bytes()
    with pytest.raises(OSError, match=r"does not begin with 'time,.*,reason,site'"):
        write(CsvOutput(str(path), labels=["site"]), reading(2))
    assert path.read_bytes() == before


def test_a_standard_output_gets_one_header(capfd: pytest.CaptureFixture[str]) -> None:
    write(CsvOutput("-"), reading(1), reading(2))
    header, *lines = capfd.readouterr().out.splitlines(keepends=True)
    assert header.encode() == HEADER
    assert [line.split(",")[3] for line in lines] == ["1", "2"]


def test_a_standard_output_that_does_not_block_is_waited_for(capfd) -> None:
    received = bytearray()
    text = "x" * 300_000  # more than a pipe holds

    def read() -> None:
        while piece := os.read(reading_end, 1000):
            received.extend(piece)

    async def go() -> None:
        output = JsonOutput("-")
        await output.open_output()
        writing = asyncio.ensure_future(output.write_readings([reading(text)]))
        await asyncio.sleep(0)
        thread.start()
        await writing
        await output.close_output()

    with capfd.disabled():
        reading_end, writing_end = os.pipe()
        os.set_blocking(writing_end, False)
        thread = threading.Thread(target=read, daemon=True)
        copy = os.dup(1)
        os.dup2(writing_end, 1)
        os.close(writing_end)
        try:
            asyncio.run(go())
        finally:
            os.dup2(copy, 1)
            os.close(copy)
        thread.join()
        os.close(reading_end)
    assert json.loads(received)["value"] == text
