"""
Files of readings that are renamed every day or at a size, and of which the oldest are deleted.
"""

from __future__ import annotations

import asyncio
import errno
import os
import re
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.csv_output import HEADER, CsvOutput
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.json_output import JsonOutput
from tests.support.cases import each_case

KINDS: dict[str, Callable[..., Any]] = {"json": JsonOutput, "csv": CsvOutput, "influx": Influx}

DAY = 86_400

STAMP = re.compile(r"\.([0-9]{8}T[0-9]{6}Z)(?:-([0-9]+))?$")


def reading(value: Any) -> Reading:
    return Reading(100.0, "a", "level", value, "m", "good")


def write(output: Any, *steps: Any) -> None:
    """Open an output, write values and do what stands between them, and close it."""

    async def go() -> None:
        await output.open()
        try:
            for step in steps:
                if callable(step):
                    step()
                else:
                    await output.write([reading(step)])
        finally:
            await output.close()

    asyncio.run(go())


def age(path: Path, days: float) -> Callable[[], None]:
    """Return a function that makes a file look as if it had been written to so many days ago."""

    def go() -> None:
        then = time.time() - days * DAY
        os.utime(path, (then, then))

    return go


def old(path: Path) -> list[Path]:
    """Return the renamed files, the oldest first."""
    found = [(named, each) for each in path.parent.iterdir() if (named := STAMP.search(each.name))]
    return [each for named, each in sorted(found, key=_age)]


def _age(found: tuple[re.Match[str], Path]) -> tuple[str, int]:
    """Return the second in which a file was renamed, and its number among those of that second."""
    second, number = found[0].groups()
    return second, int(number or 1)


def values(path: Path) -> list[str]:
    return re.findall(r'(?:"value": |level,|level=)(\d+)', path.read_text())


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_file_begins_every_day(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "readings"
    output = KINDS[kind](str(path), rotate="daily")
    write(output, 1, 2, age(path, 2), 3, 4, age(path, 1), 5)
    first, second = old(path)
    assert [values(each) for each in (first, second, path)] == [["1", "2"], ["3", "4"], ["5"]]
    then = datetime.fromtimestamp(time.time() - 2 * DAY, UTC)
    assert first.name.startswith(f"readings.{then:%Y%m%dT}")
    if kind == "csv":
        assert all(each.read_bytes().startswith(HEADER) for each in (first, second, path))


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_another_day_is_renamed_also_after_a_restart(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "readings"
    for value in (1, 2):
        write(KINDS[kind](str(path), rotate="daily"), value)
        age(path, 1)()
    (first,) = old(path)
    assert (values(first), values(path)) == (["1"], ["2"])


def test_a_clock_that_was_set_back_begins_no_file(tmp_path: Path) -> None:
    path = tmp_path / "readings"
    write(JsonOutput(str(path), rotate="daily"), 1, age(path, -3), 2)
    assert old(path) == []


@pytest.mark.parametrize("kind", KINDS)
def test_no_file_exceeds_the_size(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "readings"
    write(KINDS[kind](str(path), rotate="1 kB"), *range(1000, 1100))
    files = [*old(path), path]
    assert len(files) > 3
    assert all(500 < each.stat().st_size <= 1000 for each in files[:-1])
    told = [value for each in files for value in values(each)]
    assert told == [str(number) for number in range(1000, 1100)]


def test_a_file_that_took_the_place_of_ours_is_not_renamed(tmp_path: Path) -> None:
    """It may be of another program, and is continued."""
    path, theirs = tmp_path / "readings", tmp_path / "theirs"
    theirs.write_text("theirs\n")
    output = JsonOutput(str(path), rotate="1 kB")
    write(output, "x" * 900, lambda: theirs.replace(path), 1)
    assert old(path) == []
    assert path.read_text().startswith("theirs\n")
    assert values(path) == ["1"]


def test_a_batch_larger_than_the_size_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "readings"
    write(JsonOutput(str(path), rotate="1 kB"), "x" * 3000, "y" * 3000)
    (first,) = old(path)
    assert len(first.read_bytes().splitlines()) == len(path.read_bytes().splitlines()) == 1


def test_a_head_alone_is_no_reason_for_a_new_file(tmp_path: Path) -> None:
    path = tmp_path / "readings"
    write(CsvOutput(str(path), rotate="daily"), age(path, 1), 1)
    assert old(path) == []


def test_only_own_old_files_are_deleted(tmp_path: Path) -> None:
    path = tmp_path / "readings"
    foreign = ["readings.bak", "readings.20200101", "readings.20200101T000000Z.gz", "readings-2"]
    foreign += ["other.20200101T000000Z", "xreadings.20200101T000000Z"]
    for name in foreign:
        (tmp_path / name).write_text("")
    (tmp_path / "readings.20200101T000000Z").write_text("")
    (tmp_path / "readings.20200101T000000Z-10").write_text("")
    (tmp_path / "readings.20200101T000000Z-9").write_text("")
    write(JsonOutput(str(path), rotate="daily", keep=2), 1, age(path, 1), 2)
    names = {each.name for each in tmp_path.iterdir()} - {"readings", *foreign}
    assert "readings.20200101T000000Z-10" in names
    assert len(names) == 2


def test_no_old_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "readings"
    write(JsonOutput(str(path), rotate="daily", keep=0), 1, age(path, 1), 2)
    assert [each.name for each in tmp_path.iterdir()] == ["readings"]
    assert values(path) == ["2"]


def test_two_programs_rename_one_file_and_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "readings"

    async def go() -> None:
        outputs = [JsonOutput(str(path), rotate="1 kB") for _ in range(2)]
        for each in outputs:
            await each.open()
        for number in range(1000, 1100):
            await asyncio.gather(*(each.write([reading(number)]) for each in outputs))
        for each in outputs:
            await each.close()

    asyncio.run(go())
    told = sorted(value for each in [*old(path), path] for value in values(each))
    assert told == sorted(2 * [str(number) for number in range(1000, 1100)])


def test_a_full_disk_while_renaming_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "readings"
    opened = os.open
    full = [True]

    def failing(name: Any, flags: int, *rest: Any) -> int:
        if full and flags & os.O_EXCL:
            full.pop()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return opened(name, flags, *rest)

    async def go() -> None:
        output = JsonOutput(str(path), rotate="daily")
        await output.open()
        await output.write([reading(1)])
        age(path, 1)()
        monkeypatch.setattr(os, "open", failing)
        with pytest.raises(OSError, match="No space left"):
            await output.write([reading(2)])
        await output.close()
        await output.open()
        await output.write([reading(2)])
        await output.close()

    asyncio.run(go())
    (first,) = old(path)
    assert (values(first), values(path)) == (["1"], ["2"])


@each_case(
    ("keys", "told"),
    [
        ({"rotate": "weekly"}, "rotate must be .daily. or a size in .* not 'weekly'"),
        ({"rotate": "1 B"}, "rotate must be .* not '1 B'"),
        ({"rotate": 5}, "rotate must be"),
        ({"rotate": "daily", "keep": -1}, "keep must be in 0..100000"),
        ({"keep": 3}, "keep can only be used with rotate"),
        ({"rotate": "daily", "path": "-"}, "rotate needs the path of a file"),
    ],
)
def test_bad_keys_are_refused(keys: dict[str, Any], told: str) -> None:
    for kind in KINDS.values():
        with pytest.raises((TypeError, ValueError), match=told):
            kind(**{"path": "readings", **keys})


def test_a_server_has_no_file_to_rename() -> None:
    with pytest.raises(ValueError, match="rotate cannot be used with url"):
        Influx(url="http://127.0.0.1", database="d", rotate="daily")
