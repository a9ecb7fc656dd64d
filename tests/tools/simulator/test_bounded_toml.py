"""
Device files that cost too much: each is devices or an error, soon and in little memory.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from libmodbus_py.tools.simulator.device_file import DeviceFileError, load, parse
from tests.support.cases import each_case

SIZE = 300_000

# Reads each text in a process of its own, forked after the imports, and prints what came of all of
# them: the outcome, the seconds of processor time, and the kilobytes of memory beside those before.
PROGRAM = """
import json, os, resource, sys, time
from libmodbus_py.tools.simulator.device_file import DeviceFileError, parse

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

def cost(text):
    resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
    before, start = peak(), time.process_time()
    try:
        parse(text)
    except DeviceFileError as error:
        outcome = f"DeviceFileError {error}"
    else:
        outcome = "devices"
    return outcome, time.process_time() - start, peak() - before

found = {}
for name, text in json.load(sys.stdin).items():
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with open(writing, "w") as result:
            json.dump(cost(text), result)
        os._exit(0)
    os.close(writing)
    with open(reading) as result:
        written = result.read()
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    found[name] = json.loads(written) if status == 0 else [f"ended with {status}", 0, 0]
json.dump(found, sys.stdout)
"""

UNIT = "[[unit]]\n"
HOLDING = UNIT + "[[unit.holding_registers]]\naddress = 0\n"
TABLES = ["coils", "discrete_inputs", "holding_registers", "input_registers"]


def filled(part: str, before: str = "", behind: str = "") -> str:
    return before + part * (SIZE // len(part)) + behind


def numbered(part: Callable[[int], str], before: str = "", behind: str = "") -> str:
    parts, size, at = [before], len(before), 0
    while size < SIZE:
        parts.append(part(at))
        size += len(parts[-1])
        at += 1
    return "".join(parts) + behind


def units(content: str, count: int = 248) -> str:
    each = "".join(f"[[unit.{table}]]\naddress = 0\ncount = 65536\n{content}\n" for table in TABLES)
    return "".join(f"[[unit]]\nid = {number}\n{each}" for number in range(count))


def range_of(table: str, count: int, content: str) -> str:
    return f"[[unit.{table}]]\naddress = 0\ncount = {count}\n{content}\n"


CHINESE = "".join(chr(0x4E00 + at) for at in range(20_000))

COPIED = [
    range_of(table, 65536, f"copy = {{ table = '{other}', address = 0 }}")
    for table, other in pairwise(TABLES)
]

# What is in the file, and what comes of it.
HOSTILE = {
    "arrays in arrays": (filled("[", "a = "), "more than 10 levels"),
    "tables in tables": (filled("{a=", "a = "), "more than 10 levels"),
    "a long dotted key": (filled("a.", "", "a = 1"), "more than 10 levels: 'a.a.*line 1"),
    "below a long header": (
        numbered(lambda at: f"k{at} = 1\n", "\n[" + "a." * (SIZE // 4) + "a]\n"),
        "more than 10 levels: 'a.a.*line 2",
    ),
    "deep headers": (
        numbered(lambda at: f"[k{at}.b.c.d.e.f.g.h]\n"),
        "more than 10000 headers of tables",
    ),
    "deep dotted keys": (numbered(lambda at: f"k{at}.b.c.d.e.f.g = 1\n"), "k0: no such key"),
    "many digits": (
        HOLDING + "value = " + "9" * 5000,
        "a number has too many digits .*line 4",
    ),
    "a hundred thousand hexadecimal digits": (
        HOLDING + "value = 0x" + "f" * 100_000,
        r"unit\[0\].holding_registers\[0\].value must be in .*, not one of 400000 bits",
    ),
    "an interval of many digits": (
        HOLDING + "counter = { interval = 0x" + "f" * 5000 + " }",
        r"unit\[0\].holding_registers\[0\].counter.interval must be in .*, not one of 20000 bits",
    ),
    "an interval of 20 digits": (
        HOLDING + "counter = { interval = 99999999999999999999 }",
        r"counter.interval must be in .*, not 99999999999999999999",
    ),
    "a long text": (filled("a", HOLDING + "type = 'string:9'\nvalue = '", "'"), "0..2000 charac"),
    "a long type": (filled("a", HOLDING + "type = '", "'"), "type must have 0..2000 characters"),
    "a long key": (filled("a", "", " = 1"), "'aaaaaaa.*: no such key"),
    "a slow encoding": (
        HOLDING + f"type = 'string:250'\nencoding = 'punycode'\nvalue = '{CHINESE}'",
        "value must have 0..2000 characters, not 20000",
    ),
    "a slow encoding of short texts": (
        HOLDING
        + f"type = 'string:250'\nencoding = 'punycode'\nvalues = {[CHINESE[:60]] * 500}".replace(
            "'", '"'
        ),
        "encoding must be ascii, latin-1, utf-8, cp1252 or another .*not 'punycode'",
    ),
    "ranges that overlap": (
        UNIT + range_of("holding_registers", 65536, "") * 1000,
        r"holding_registers\[1\] begins at 0, within",
    ),
    "files that end far": (
        numbered(lambda at: f"{{number={at + 1},record=9999}},", UNIT + "file = [", "]"),
        r"unit\[0\].file\[52\]: more than 524288 cells in one file",
    ),
    "long files": (
        numbered(lambda at: f"{{number={at + 1},record=0,count=10000}},", UNIT + "file = [", "]"),
        r"unit\[0\].file\[52\]: more than 524288 cells in one file",
    ),
    "full tables": (units("value = 1"), r"unit\[2\].coils\[0\]: more than 524288 cells"),
    "full tables of zeros": (units(""), "devices"),
    "full tables that walk": (units("random_walk = { low = 0, high = 1, step = 1 }"), "devices"),
    "copies of copies": (
        "".join(
            f"[[unit]]\nid = {number}\n" + "".join(COPIED) + range_of(TABLES[3], 65536, "")
            for number in range(60)
        ),
        "devices",
    ),
    "copies in a circle": (
        UNIT + range_of("coils", 65536, "copy = { table = 'coils', address = 0 }"),
        "more than 8 copies in a row, or a circle of them",
    ),
    "copies of the next": (
        UNIT
        + range_of("coils", 65535, "copy = { table = 'coils', address = 1 }")
        + "[[unit.coils]]\naddress = 65535",
        "more than 8 copies in a row, or a circle of them",
    ),
    "copies of single values": (
        UNIT
        + f"input_registers = [{','.join(f'{{address={at}}}' for at in range(9000))}]\n"
        + range_of("holding_registers", 9000, "copy = { table = 'input_registers', address = 0 }")
        + range_of("coils", 9000, "copy = { table = 'holding_registers', address = 0 }"),
        "devices",
    ),
    "many faults": (
        numbered(lambda _: "{kind='no_answer'},", UNIT + "fault = [", "]"),
        "fault: more than 1000 faults in one file",
    ),
    "many values": (
        filled("1,", HOLDING + "values = [", "]"),
        "count must be in 1..65536",
    ),
    "many units": (filled(UNIT), "more than 10000 headers"),
    "many units without a header": (filled("{},", "unit = [", "]"), "unit.0..id is missing"),
    "many keys": (numbered(lambda at: f"k{at} = 1\n"), "k0: no such key"),
    "many ranges": (
        numbered(lambda at: f"{{address={at % 65536}}},", UNIT + "coils = [", "]"),
        "devices",
    ),
    "many names": (
        numbered(lambda at: f"{{address={at},name='n{at}'}},", UNIT + "coils = [", "]"),
        "more than 10000 points in one file",
    ),
    "ten thousand scaled names": (
        numbered(
            lambda at: (
                f"{{address={at},name='n{at}',scale=0.1,value={at}.3}},{'#' * 12}\n"
                if at < 6000
                else "#" * 70 + "\n"
            ),
            UNIT + "holding_registers = [",
            "]",
        ),
        "devices",
    ),
    "many scaled values": (
        HOLDING + f"scale = 0.1\nvalues = [{','.join(f'{at}.{at % 10}' for at in range(6000))}]",
        "devices",
    ),
    "more scaled values": (
        filled("6553.5,", HOLDING + "scale = 0.1\nvalues = [", "]"),
        "more than 524288 cells in one file|count must be",
    ),
    "scales that cannot be": (
        numbered(lambda at: f"{{address={at},scale=1e31}},", UNIT + "holding_registers = [", "]"),
        r"holding_registers\[0\].scale must be in",
    ),
    "many maps": (
        UNIT + f"map = [{','.join(chr(39) + f'{at}.csv' + chr(39) for at in range(9999))}]",
        r"map\[0\]: cannot read 0.csv",
    ),
    "one map again and again": (
        UNIT + "map = [" + "'/dev/zero.csv', " * 9999 + "]",
        r"map\[0\]: cannot read /dev/zero.csv",
    ),
    "defaults that cannot be": (
        filled("a", "[defaults]\ntype = '", "'"),
        "defaults.type must have 0..2000 characters",
    ),
    "garbage": (
        UNIT + "[[unit.fault]]\nkind = 'garbage'\n" + filled("1,", "data = [", "]"),
        r"fault\[0\].data must have 1..512 bytes, not",
    ),
    "too long": (filled("#" * 80 + "\n") + "#" * 300_000, "more than 524288 characters"),
    "a date": (
        HOLDING + "value = 2024-01-01T00:00:00Z",
        "value must be an integer in 0..65535, not datetime",
    ),
    "no number": (HOLDING + "counter = { step = nan }", "counter.step must be in .*, not nan"),
}


@pytest.mark.parametrize("part", range(3))
def test_hostile_files_cost_little(part: int) -> None:
    files = dict(list(HOSTILE.items())[part::3])
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=json.dumps({name: text for name, (text, _) in files.items()}),
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(run.stdout)
    assert found.keys() == files.keys()
    failed = [name for name, (_, expected) in files.items() if wrong(*found[name], expected)]
    assert not failed, {name: found[name] for name in failed}


def wrong(outcome: str, seconds: float, kilobytes: int, expected: str) -> bool:
    """Return True if a file has another outcome, or costs too much."""
    is_dear = seconds >= 3 or kilobytes >= 100_000  # a tenth of these seconds is usual
    return is_dear or len(outcome) >= 500 or not re.search(expected, outcome)


@each_case(
    ("outcome", "seconds", "kilobytes"),
    [
        ("devices", 3.0, 0),
        ("devices", 0.1, 100_000),
        ("devices" * 100, 0.1, 0),
        ("ended with -9", 0.1, 0),
    ],
)
def test_what_costs_much_is_noticed(outcome: str, seconds: float, kilobytes: int) -> None:
    assert wrong(outcome, seconds, kilobytes, "devices")
    assert not wrong("devices", 0.1, 1000, "devices")


def test_a_file_without_end_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(DeviceFileError, match=r"/long.toml: more than 524288 bytes$"):
        load(path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    for path in (str(pipe), "/dev/zero", "/dev/ptmx"):
        with pytest.raises(DeviceFileError, match=rf"^{path}: not a regular file$"):
            load(path)
    device = tmp_path / "device.toml"
    device.write_text(UNIT + "map = 'pipe.csv'")
    with pytest.raises(DeviceFileError, match=r"unit\[0\].map: .*pipe.csv: not a regular file$"):
        load(device)


def test_as_much_as_is_allowed_is_taken(tmp_path: Path) -> None:
    """A table of 65536 registers, each written out; and text in UTF-8, which has more bytes."""
    path = tmp_path / "full.toml"
    path.write_text(HOLDING + f"values = {[65535 - at for at in range(65536)]}")
    devices, _ = load(path)
    assert not isinstance(devices, dict)
    assert devices.mapping.holding_registers[0:65536] == list(range(65535, -1, -1))
    path.write_text(UNIT + "#" + "ü" * 300_000)
    with pytest.raises(DeviceFileError, match="524288 bytes"):
        load(path)


def test_comments_and_numbers_are_no_deep_keys() -> None:
    text = UNIT + "# see 192.0.2.1, 1.2.3.4.5.6.7.8 and ................ a.b.c\nid = 1"
    devices = parse(text).devices
    assert isinstance(devices, dict)
    assert list(devices) == [1]
    device = parse(HOLDING + f"type = 'float64'\nvalues = [{', '.join(['1.5'] * 50)}]").devices
    assert not isinstance(device, dict)
    assert len(device.mapping.holding_registers) == 200


def test_maps_are_read_within_bounds(tmp_path: Path) -> None:
    """Each is read once, whatever its path is called; and there are not too many of them."""
    head = "name,table,address\n"
    full = head + "".join(f"p{at},holding,{at}\n" for at in range(5000))
    (tmp_path / "full.csv").write_text(full)
    units = "".join(f"[[unit]]\nid = {at}\nmap = './x/../full.csv'\n" for at in range(3))
    path = tmp_path / "plant.toml"
    path.write_text(units)
    with pytest.raises(DeviceFileError, match=r"unit\[2\].map: more than 10000 points in one file"):
        load(path)
    for at in range(51):
        (tmp_path / f"{at}.csv").write_text(head + f"p{at},coil,{at}\n")
    path.write_text(UNIT + f"map = {[f'{at}.csv' for at in range(50)]}")
    load(path)
    path.write_text(UNIT + f"map = {[f'{at}.csv' for at in range(51)]}")
    with pytest.raises(DeviceFileError, match=r"map\[50\]: more than 50 register maps in one file"):
        load(path)


def test_points_that_share_all_cells_cost_little(tmp_path: Path) -> None:
    head = "name,table,address,count\n"
    same = head + "".join(f"p{at},holding,0,65536\n" for at in range(5000))
    (tmp_path / "same.csv").write_text(same)
    path = tmp_path / "plant.toml"
    path.write_text(UNIT + "map = 'same.csv'\n")
    device = load(path).devices
    assert not isinstance(device, dict)
    assert len(device.points) == 5000
