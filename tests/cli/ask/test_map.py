"""The command map with files and with devices; and the output of sunspec for a device."""

import os
import signal
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Client, Device, Fault, Mapping, Server, load_map, sunspec
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.cases import each_case
from tests.support.commands import Result, Started, run
from tests.support.peers import FakeServer, mbap, until
from tests.support.sunspec import file_device
from tests.support.sunspec import serving as sunspec_device

EXAMPLES = Path(__file__).parents[3] / "examples"


def run_map(*arguments: object, code: int = 0) -> Result:
    result = run("map", *arguments)
    assert result.code == code, result.err
    return result


@pytest.fixture
def url() -> Iterator[str]:
    mapping = Mapping(coils=2, holding_registers={0: [7, 8], 6: [9]}, input_registers=[range(0)])
    with Server({3: Device(mapping)}).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@pytest.mark.parametrize("suffix", [".toml", ".csv"])
def test_a_skeleton_reads_what_the_device_has(url: str, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"found{suffix}"
    result = run_map("from-device", url.removeprefix("tcp://"), "-u", "3", "-o", file)
    assert result.out == ""
    assert result.err == f"{file}: 5 points; fill in names, types and units\n"
    with Client(url, unit=3, timeout=5) as plc:
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
        result = run_map("from-device", running.urls[0])
    (tmp_path / "found.toml").write_text(result.out)
    skeleton = load_map(tmp_path / "found.toml")
    assert [(entry.name, entry.count) for entry in skeleton.values()] == [
        ("coil_0", 5000),
        ("input_0", 3),
    ]


def test_a_silent_unit_gives_no_map(url: str, tmp_path: Path) -> None:
    file = tmp_path / "found.csv"
    result = run_map("from-device", url, "--unit", "9", "-o", file, code=1)
    assert result.err == "libmodbus-py: no table can be read: the unit does not answer any more\n"
    assert not file.exists()


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
        Started("map", "from-device", server.url, "-o", file) as process,
    ):
        until(lambda: len(server.requests) > 60)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert list(load_map(file)) == [f"coil_{at}" for at in range(10)]
    assert ": ended by the user" in file.read_text()


def test_the_maps_that_come_with_the_package() -> None:
    listed = run_map("list").out.splitlines()
    assert "sdm120       Eastron SDM120-Modbus, a single-phase meter" in listed
    for line in listed:
        assert run_map("check", EXAMPLES / f"{line.split()[0]}.csv").code == 0
        assert len(line.split()) > 2


MAP = "name,table,address,type,access\nvoltage,input,0,uint16,read\nset point,holding,1,,\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "meter.csv").write_text(MAP)
    return tmp_path


def test_map_class_prints_a_class_and_writes_the_same_one_to_a_file(folder: Path) -> None:
    printed = run("map", "class", folder / "meter.csv")
    assert (printed.code, printed.err) == (0, "")
    assert "class Meter(" in printed.out
    assert "def set_point(self) -> int:" in printed.out
    for _ in range(2):  # it takes the place of what the command itself has written
        result = run("map", "class", folder / "meter.csv", "-o", folder / "plant.py")
        assert result == (0, "", f"{folder / 'plant.py'}: 2 points\n")
        assert (folder / "plant.py").read_text() == printed.out
    assert sorted(os.listdir(folder)) == ["meter.csv", "plant.py"]


@pytest.mark.parametrize("suffix", ["toml", "csv"])
def test_map_from_sunspec_writes_the_points_of_the_device(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"inverter.{suffix}"
    with sunspec_device(file_device("device_1547.json")) as url:
        result = run("map", "from-sunspec", url, "-o", str(path))
        assert (result.code, result.err) == (0, f"{path}: 415 points\n")
        with Client(url) as plc:
            points = sunspec.discover(plc).map
            assert plc.read_map(load_map(path)) == plc.read_map(points)
    assert dict(load_map(path)) == dict(points)
    assert run("map", "from-sunspec", url, "-o", str(path)).code == 2


def test_the_values_of_all_models_are_printed() -> None:
    with sunspec_device(file_device("device_1547.json")) as url:
        result = run("sunspec", url)
    assert (result.code, result.err) == (0, "")
    lines = [" ".join(line.split()) for line in result.out.splitlines()]
    assert "40004 common.Mn SunSpecTest" in lines
    assert any(line.endswith("DERMeasureAC.W 9800 W") for line in lines)
    assert not any("InvSt" in line for line in lines)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    lines = [f"p{at},holding_registers,{at},uint16" for at in range(20)]
    (tmp_path / "points.csv").write_text("\n".join(["name,table,address,type", *lines]))
    return tmp_path / "points.csv"


def device(*missing: int) -> Device:
    return Device(Mapping(holding_registers={at: [at] for at in range(20) if at not in missing}))


@each_case(("missing", "most"), [((), 1), ((3, 11, 12), 30), (range(20), 40)])
def test_few_requests_find_what_a_device_lacks(points: Path, missing, most) -> None:
    with ServerMaker() as maker:
        server = maker(devices=device(*missing))
        result = run("map", "check", points, "--device", server.url)
    assert result.code == (1 if missing else 0)
    assert len(server.transactions) <= most


def test_a_device_that_is_silent_or_busy(points: Path) -> None:
    with ServerMaker() as maker:
        silent = maker(faults={None: [Fault("no_answer")]})
        result = run("map", "check", points, "--device", silent.url, "--timeout", "0.1")
        assert result.code == 1
        assert "no answer" in result.err
        busy = maker(faults={None: [Fault("exception", code=6)]})
        result = run("map", "check", points, "--device", busy.url)
        assert result.code == 1
        assert "server device busy" in result.err
        assert len(busy.transactions) == 1
