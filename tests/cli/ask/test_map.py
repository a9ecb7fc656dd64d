"""
The command map: what it says of files and makes of devices.
"""

from __future__ import annotations

import signal
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server, TcpContext, load_map
from tests.support.cases import each_case
from tests.support.commands import Done, Started, run
from tests.support.peers import FakeServer, mbap, until

EXAMPLES = Path(__file__).parents[3] / "examples"


def mapped(*arguments: object, code: int = 0) -> Done:
    done = run("map", *arguments)
    assert done.code == code, done.err
    return done


def test_what_a_map_has_and_takes(tmp_path: Path) -> None:
    file = tmp_path / "meter.csv"
    file.write_text(
        "Register;Parameter;Data Type;R/W;Factor;Vendor's\n"
        "40001;volts;U16;R;0.1;x\n"
        "40002;power;S32;RO;1;\n"
        "40003;setpoint;INT16;R/W;0.1;\n"
        "40010;serial;STR10;R;;\n"
        "00001;run;bool;W;;\n"
    )
    assert mapped("check", file).out.splitlines() == [
        f"{file}: 5 points",
        "  coils: 1 point, 1 of them can be written",
        "  holding_registers: 4 points, 1 of them can be written",
        "    read 0 3",
        "    read 9 5",
        "  columns that mean nothing here: Vendor's",
        "  line 4: setpoint overlaps power at holding_registers 2",
    ]


def test_all_mistakes_of_all_files(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.toml", tmp_path / "bad.csv"
    good.write_text('[[point]]\nname = "a"\ntable = "coils"\naddress = 1\n')
    bad.write_text("name,addr\n" + "a,x\n" * 30)
    done = mapped("check", str(bad), "nothing.csv", str(good), code=2)
    assert done.out.splitlines()[0] == f"{good}: 1 point"
    lines = done.err.splitlines()
    assert len(lines) == 22
    assert lines[0].startswith(f"libmodbus-py: {bad}, line 2, column addr: address must be a ")
    assert lines[-2:] == [
        "libmodbus-py: and possibly more",
        "libmodbus-py: cannot read nothing.csv: No such file or directory",
    ]


@pytest.fixture
def url() -> Iterator[str]:
    mapping = Mapping(coils=2, holding_registers={0: [7, 8], 6: [9]}, input_registers=[range(0)])
    with Server({3: Device(mapping)}).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@pytest.mark.parametrize("suffix", [".toml", ".csv"])
def test_a_skeleton_reads_what_the_device_has(url: str, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"found{suffix}"
    done = mapped("from-device", url.removeprefix("tcp://"), "-u", "3", "-o", file)
    assert done.out == ""
    assert done.err == f"{file}: 5 points; fill in names, types and units\n"
    with TcpContext("127.0.0.1", int(url.rpartition(":")[2]), unit=3, timeout=5) as plc:
        assert plc.read_map(load_map(file)) == {
            "coil_0": False,
            "coil_1": False,
            "holding_0": 7,
            "holding_1": 8,
            "holding_6": 9,
        }
    assert {point.access for point in load_map(file).values()} == {"read"}
    assert f"# Addresses of {url} that can be read, found by " in file.read_text()


def test_a_skeleton_of_very_much_has_ranges(tmp_path: Path) -> None:
    device = Device(Mapping(coils=5000, input_registers=3))
    with Server(device).background("tcp://127.0.0.1:0") as running:
        done = mapped("from-device", running.urls[0])
    (tmp_path / "found.toml").write_text(done.out)
    found = load_map(tmp_path / "found.toml")
    assert [(each.name, each.count) for each in found.values()] == [
        ("coil_0", 5000),
        ("input_0", 3),
    ]


# What is typed, and what is said before anything is asked.
WRONG = [
    (["found.xlsx"], "found.xlsx: it must end with one of .toml, .csv"),
    (["{}/there.csv"], "/there.csv exists, and would be overwritten"),
    (["{}/no/found.csv"], "/no/found.csv: the folder does not exist"),
    (["{}/found.csv", "--unit", "300"], "unit must be in 0..255, not 300"),
]


@each_case(("output", "message"), WRONG)
def test_wrong_usage_is_one_line(tmp_path: Path, output: list[str], message: str) -> None:
    (tmp_path / "there.csv").write_text("mine")
    arguments = [each.format(tmp_path) for each in output]
    done = mapped("from-device", "tcp://127.0.0.1:1", "-o", *arguments, code=2)
    (line,) = done.err.splitlines()
    assert message in line
    assert (tmp_path / "there.csv").read_text() == "mine"


def test_nobody_there(url: str, tmp_path: Path) -> None:
    file = tmp_path / "found.csv"
    done = mapped("from-device", url, "--unit", "9", "-o", file, code=1)
    assert done.err == "libmodbus-py: no table can be read: the unit does not answer any more\n"
    done = mapped("from-device", "tcp://127.0.0.1:1", "-o", file, code=1)
    assert len(done.err.splitlines()) == 1
    assert not file.exists()


def test_a_full_disk(url: str, tmp_path: Path) -> None:
    (tmp_path / "meter.toml").write_text('[[point]]\nname = "a"\ntable = "coils"\naddress = 1\n')
    for arguments in (
        ["check", tmp_path / "meter.toml"],
        ["from-device", f"{url}?unit=3"],
    ):
        with open("/dev/full", "w") as full:
            done = run("map", *arguments, out=full)
        assert done.code == 1
        assert done.err == "libmodbus-py: standard output: No space left on device\n"


def test_ctrl_c_keeps_what_was_found(tmp_path: Path) -> None:
    def answer(request: bytes) -> list[bytes]:
        function, first, count = struct.unpack(">BHH", request[7:12])
        time.sleep(0.01)
        if function != 1 or first + count > 10:
            return [mbap(request, bytes([function | 0x80, 2]))]
        return [mbap(request, bytes([1, (count + 7) // 8]) + bytes((count + 7) // 8))]

    file = tmp_path / "found.toml"
    with (
        FakeServer(answer) as server,
        Started("map", "from-device", server.url, "-o", file) as made,
    ):
        until(lambda: len(server.requests) > 60)
        made.send_signal(signal.SIGINT)
        _, errors = made.communicate()
    assert made.returncode == 130
    assert "Traceback" not in errors
    assert list(load_map(file)) == [f"coil_{at}" for at in range(10)]
    assert ": ended by the user" in file.read_text()


def test_the_maps_that_come_with_the_package() -> None:
    listed = mapped("list").out.splitlines()
    assert "sdm120       Eastron SDM120-Modbus, a single-phase meter" in listed
    for line in listed:
        assert mapped("check", EXAMPLES / f"{line.split()[0]}.csv").code == 0
        assert len(line.split()) > 2


@each_case(
    ("words", "names"),
    [
        (["sdm120"], ["sdm120"]),
        (["EASTRON", "single"], ["sdm120", "sdm230"]),
        (["heat", "pumps"], ["nibe_s"]),
    ],
)
def test_maps_are_found_by_words(words: list[str], names: list[str]) -> None:
    lines = mapped("list", "--search", *words).out.splitlines()
    assert [line.split()[0] for line in lines] == names


def test_maps_that_lack_a_word_are_not_found() -> None:
    done = mapped("list", "--search", "eastron", "toaster", code=1)
    assert done.out == ""
    assert done.err.endswith(" has eastron and toaster\n")
    assert done.err.count("\n") == 1


GERMAN = "Zähler;;\nBezeichnung;Register;Datentyp\nSpannung;40001;U16\n".encode("cp1252")


def test_columns_are_named_on_the_command_line(url: str, tmp_path: Path) -> None:
    (tmp_path / "zähler.csv").write_bytes(GERMAN)
    file, named = tmp_path / "zähler.csv", ["--column", "name=Bezeichnung"]
    named += ["--column", "type=Datentyp"]
    assert mapped("check", file, *named).out.splitlines()[0] == f"{file}: 1 point"
    assert "Spannung" in mapped("class", file, *named).out
    assert run("read", url, "-u", 3, "--map", file, *named).out == "Spannung  7\n"
    assert run("write", url, "-u", 3, "--map", file, *named, "Spannung=8").code == 0
    assert "no column name" in mapped("check", file, code=2).err


@each_case(
    ("words", "said"),
    [
        (["read", "127.0.0.1", "hr", "0", "--column", "name=x"], "--column needs --map"),
        (["serve", "127.0.0.1", "--column", "name=x"], "--column needs --map"),
        (["map", "check", "meter", "--column", "name"], "must be KEY=HEADING"),
        (["map", "check", "meter", "--column", "name=x"], "no column x, which is named for name"),
        (["map", "check", "meter", "--column", "nam=x"], "columns must name some of name"),
    ],
)
def test_what_is_wrong_with_columns(words: list[str], said: str) -> None:
    done = run(*words)
    assert done.code == 2
    assert said in done.err
