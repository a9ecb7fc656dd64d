"""
Values of mappings in files: saved, loaded again, and refused with their place.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Mapping
from tests.support.cases import each_case


def plant() -> Mapping:
    return Mapping(
        coils=range(3, 20),
        discrete_inputs=4,
        holding_registers=[range(10), range(1000, 1600)],
        input_registers={7: [1, 2]},
    )


def contents(mapping: Mapping) -> list[list[int]]:
    tables = (
        mapping.coils,
        mapping.discrete_inputs,
        mapping.holding_registers,
        mapping.input_registers,
    )
    return [list(map(int, table)) for table in tables]


def test_values_come_back(tmp_path: Path) -> None:
    path = tmp_path / "values"
    saved = plant()
    saved.coils[5] = True
    saved.discrete_inputs[3] = True
    saved.holding_registers[9] = 65535
    saved.holding_registers[1000:1600] = range(600)
    saved.save(path)
    loaded = plant()
    loaded.holding_registers[3] = 4  # which the file does not have
    loaded.load(path)
    assert contents(loaded) == contents(saved)
    saved.load(path)
    assert contents(loaded) == contents(saved)
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    assert os.listdir(tmp_path) == ["values"]


def test_the_text_of_a_file(tmp_path: Path) -> None:
    mapping = Mapping(coils=4, holding_registers=range(100, 110))
    mapping.coils[1:3] = [True, True]
    mapping.holding_registers[107:109] = [1, 65535]
    mapping.save(tmp_path / "values")
    assert (tmp_path / "values").read_text() == (
        '{"libmodbus-py": "state", "version": 1}\n'
        '{"unit": null, "table": "coils", "address": 1, "values": [1, 1]}\n'
        '{"unit": null, "table": "holding_registers", "address": 107, "values": [1, 65535]}\n'
        '{"end": 3}\n'
    )


@given(st.dictionaries(st.integers(0, 599), st.integers(0, 65535)))
def test_any_values_come_back(values: dict[int, int]) -> None:
    saved, loaded = Mapping(holding_registers=600), Mapping(holding_registers=600)
    for address, value in values.items():
        saved.holding_registers[address] = value
    path = Path("/dev/shm") / f"libmodbus-py-{os.getpid()}"
    try:
        saved.save(path)
        loaded.load(path)
    finally:
        path.unlink(missing_ok=True)
    assert loaded.holding_registers[:] == saved.holding_registers[:]


HEAD = '{"libmodbus-py": "state", "version": 1}\n'
RUN = '{"unit": null, "table": "holding_registers", "address": 0, "values": [1]}\n'

DAMAGED = [
    ("", "line 1: column 1: not JSON"),
    ("\n", "line 1: column 1: not JSON"),
    ("meter = 1\n", "line 1: column 1: not JSON"),
    ("{}\n", 'line 1: libmodbus-py must be "state"'),
    ("[]\n", r"line 1: must be an object, not \[\]"),
    (HEAD, "line 1: end is missing: the file is cut off"),
    (HEAD.rstrip(), "line 1: end is missing: the file is cut off"),
    (HEAD + RUN, "line 2: end is missing"),
    (HEAD + RUN[:-20], "line 2: end is missing"),
    (HEAD + RUN + RUN[:30], "line 3: "),
    (HEAD + RUN + '{"end": 1}\n', "line 3: end must be 2, the number of lines before it"),
    (HEAD + RUN + '{"end": 2}\n{"end": 3}\n', "line 3: unit is missing"),
    (HEAD + RUN + '{"end": 2}\nx', "line 4: nothing may follow"),
    (HEAD + "{" * 100_000 + '\n{"end": 2}\n', "line 2: .*not JSON"),
    (HEAD + "\0\0\0\n" + '{"end": 2}\n', "line 2: column 1: not JSON"),
    (HEAD.replace("1", "2") + '{"end": 1}\n', "line 1: version must be 1, not 2: .* newer"),
    (HEAD.replace("1", "true") + '{"end": 1}\n', "line 1: version must be"),
    (HEAD.replace("1", '"1"') + '{"end": 1}\n', "line 1: version must be"),
]


@each_case(("text", "message"), DAMAGED)
def test_damaged_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    refused(tmp_path, text, message)


GOOD = {"unit": None, "table": "holding_registers", "address": 0, "values": [1]}

LINES = [
    ({"unit": 1}, "line 3: unit must be that of a device that is served, not 1"),
    ({"unit": [1]}, r"line 3: unit must be .*, not \[1\]"),
    ({"unit": False}, "line 3: unit must be .*, not False"),
    ({"table": "holding"}, "line 3: table must be one of coils, "),
    ({"table": ["coils"]}, "line 3: table must be one of coils, "),
    ({"address": -1}, r"line 3: address must be in 0\.\.65535, not -1"),
    ({"address": "0"}, "line 3: address must be "),
    ({"address": 9.0}, "line 3: address must be "),
    ({"address": 9, "values": [1, 2]}, "line 3: address: the device lacks holding_registers 9..10"),
    ({"address": 999}, "line 3: address: the device lacks holding_registers 999..999"),
    ({"address": 65535, "values": [1, 2]}, "line 3: address: the device lacks"),
    ({"values": []}, "line 3: values must be a list that is not empty"),
    ({"values": 3}, "line 3: values must be a list"),
    ({"values": [1, 65536]}, r"line 3: values\[1\] must be in 0\.\.65535, not 65536"),
    ({"values": [True]}, r"line 3: values\[0\] must be"),
    ({"values": [1.5]}, r"line 3: values\[0\] must be"),
    ({"values": [None]}, r"line 3: values\[0\] must be"),
    ({"table": "coils", "address": 3, "values": [2]}, r"line 3: values\[0\] must be in 0\.\.1"),
    ({"table": "file", "file": 4}, r"line 3: address: the device lacks file 4 0\.\.0"),
    ({"file": 4}, "line 3: file: no such key"),
    ({"more": 4}, "line 3: more: no such key"),
    ({"table": "coils", "address": 3}, ""),
]


@each_case(("change", "message"), LINES)
def test_wrong_lines_are_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    first = json.dumps(GOOD | {"address": 5})
    text = f'{HEAD}{first}\n{json.dumps(GOOD | change)}\n{{"end": 3}}\n'
    if message:
        refused(tmp_path, text, message)
    else:
        (tmp_path / "values").write_text(text)
        mapping = plant()
        mapping.load(tmp_path / "values")
        assert mapping.coils[3] is True
        assert mapping.holding_registers[5] == 1


def test_no_cell_has_two_values(tmp_path: Path) -> None:
    text = f'{HEAD}{RUN}{RUN}{{"end": 3}}\n'
    refused(tmp_path, text, "line 3: address must be 1 or more, after the lines before, not 0")


def test_every_cut_and_every_changed_byte_is_refused_or_gives_values(tmp_path: Path) -> None:
    saved = plant()
    saved.holding_registers[1000:1003] = [500, 0, 7]
    saved.coils[4] = True
    path = tmp_path / "values"
    saved.save(path)
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        mapping = plant()
        with pytest.raises(ValueError, match="line "):
            mapping.load(path)
        assert contents(mapping) == contents(plant())
    for at in range(len(data)):
        path.write_bytes(data[:at] + b"\xff" + data[at + 1 :])
        with pytest.raises(ValueError, match=r"line \d+: not UTF-8"):
            plant().load(path)


def test_points_are_no_part_of_a_mapping(tmp_path: Path) -> None:
    points = '{"unit": null, "points": {"a": ["coils", 3, 1, null, "ABCD"]}}\n'
    refused(tmp_path, f'{HEAD}{points}{{"end": 2}}\n', "line 2: points.a: the device has no such")


def refused(folder: Path, text: str, message: str) -> None:
    path = folder / "values"
    path.write_text(text)
    mapping = plant()
    mapping.holding_registers[3] = 4
    before = contents(mapping)
    with pytest.raises(ValueError, match=message) as caught:
        mapping.load(path)
    assert str(caught.value).startswith(f"{path}, line ")
    assert "\n" not in str(caught.value)
    assert contents(mapping) == before


# --- files --------------------------------------------------------------------------------


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="pipe: not a regular file"):
        plant().load(tmp_path / "pipe")
    with pytest.raises(IsADirectoryError):
        plant().load(tmp_path)
    with pytest.raises(FileNotFoundError):
        plant().load(tmp_path / "missing")
    with pytest.raises(FileNotFoundError):
        plant().save(tmp_path / "missing" / "values")
    with pytest.raises(ValueError, match="not a regular file"):
        plant().load("/dev/zero")


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    target, link = tmp_path / "other" / "values", tmp_path / "link"
    link.symlink_to(target)
    plant().save(link)
    target.chmod(0o640)
    plant().save(link)
    assert link.is_symlink()
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert os.listdir(tmp_path / "other") == ["values"]


@each_case("step", ["fsync", "replace", "fchmod"])
def test_what_fails_leaves_the_file_as_it_was(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / step
    mapping = plant()
    mapping.save(path)
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    mapping.coils[4] = True
    with monkeypatch.context() as patched:
        patched.setattr(os, step, fail)
        with pytest.raises(OSError, match="No space left"):
            mapping.save(path)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob("*.new"))
    mapping.save(path)
    assert path.read_bytes() != before
