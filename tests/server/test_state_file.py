"""The file that keeps the values of served devices: what it has, who may use it, and what fails."""

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, Server, device_file, pdu
from libmodbus_py.server import state_file
from libmodbus_py.server.state_file import StateFile
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import Clock

PLANT = """
[[unit]]
id = 1
map = "map.csv"
values = { setpoint = 20 }
holding_registers = [
    { address = 100, count = 600, value = 7 },
    { address = 900, counter = { interval = 1 } },
]
file = [{ number = 4, record = 3, values = [1, 2, 3] }]
[[unit]]
id = 2
coils = [{ address = 0, count = 8 }]
"""

MAP = "name,table,address,type,scale\nsetpoint,holding,0,uint16,0.1\nlimit,holding,1,uint32,1\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "map.csv").write_text(MAP)
    return tmp_path


Units = dict[int, Any]


def plant(folder: Path, text: str = PLANT) -> Units:
    devices = device_file.parse(text, clock=Clock(), folder=folder).devices
    assert isinstance(devices, dict)
    return devices


@pytest.fixture(autouse=True)
def _only_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the thread write nothing, so that the test decides when the file is written."""
    monkeypatch.setattr(state_file, "WRITE_EVERY", 1e6)


def kept(folder: Path, units: Any, name: str = "state") -> StateFile:
    """Return the file of units, which is open."""
    file = StateFile(str(folder / name), lambda: units)
    file.__enter__()
    return file


def close(file: StateFile) -> None:
    file.__exit__()


def after_a_write(folder: Path) -> None:
    """Serve the plant once, with values that clients write."""
    units = plant(folder)
    file = kept(folder, units)
    for unit, request in (
        (1, pdu.WriteRegister(0, 215)),
        (1, pdu.WriteRegisters(100, [8] * 100)),
        (1, pdu.WriteRegister(200, 7)),  # as at first
        (1, pdu.WriteFileRecords([(4, 4, [9])])),
        (2, pdu.WriteCoil(5, True)),
    ):
        assert units[unit].answer(request.encode())[0] == request.function
    units[1].answer(pdu.ReadHoldingRegisters(900, 1).encode())  # a moving value
    close(file)


def test_only_written_values_are_kept_after_a_restart(folder: Path) -> None:
    after_a_write(folder)
    assert json.loads((folder / "state").read_text()) == {
        "libmodbus-py": "state",
        "version": 1,
        "units": {
            "1": {
                "points": {
                    "holding_registers_100": ["holding_registers", 100, 600, "uint16", "ABCD"],
                    "setpoint": ["holding_registers", 0, 1, "uint16", "ABCD"],
                },
                "holding_registers": {"0": [215], "100": [8] * 100},
                "files": {"4": {"4": [9]}},
            },
            "2": {"points": {"coils_0": ["coils", 0, 8, None, "ABCD"]}, "coils": {"5": [1]}},
        },
    }
    # New initial values apply to values that were not written.
    units = plant(folder, PLANT.replace("value = 7", "value = 6"))
    close(kept(folder, units))
    assert units[1]["setpoint"] == 21.5
    assert units[1].mapping.holding_registers[100:202] == [8] * 100 + [6, 6]
    assert list(units[1].files[4]) == [1, 9, 3]
    assert units[2].mapping.coils[:] == [False] * 5 + [True] + [False] * 2


OTHERS = [
    (("id = 2", "id = 3"), "units.2: no such unit is served, only 1, 3"),
    (("address = 100", "address = 101"), "units.1.points.holding_registers_100: .* no such point"),
    (("count = 600", "count = 601"), r"units.1.points.holding_registers_100 must be .*601"),
    (("number = 4", "number = 5"), "units.1.files.4.4: the device lacks file 4 4..4"),
    (("record = 3", "record = 5"), "units.1.files.4.4: the device lacks file 4 4..4"),
    (('map = "map.csv"\nvalues = { setpoint = 20 }', ""), "units.1.points.setpoint: .* no such"),
]


@each_case(("change", "message"), OTHERS)
def test_values_of_another_device_are_refused(change, message, folder: Path) -> None:
    after_a_write(folder)
    before = (folder / "state").read_bytes()
    assert change[0] in PLANT
    units = plant(folder, PLANT.replace(*change))
    first = {unit: list(device.mapping.holding_registers) for unit, device in units.items()}
    with pytest.raises(ValueError, match=message):
        kept(folder, units)
    assert first == {unit: list(entry.mapping.holding_registers) for unit, entry in units.items()}
    assert (folder / "state").read_bytes() == before
    close(kept(folder, plant(folder)))  # and the lock is free


def test_only_changes_are_written(folder: Path) -> None:
    units = plant(folder)
    file = kept(folder, units)
    file._write()
    first = os.stat(folder / "state").st_ino
    file._write()
    units[1].answer(pdu.ReadHoldingRegisters(900, 1).encode())
    file._write()
    assert os.stat(folder / "state").st_ino == first
    units[2].mapping.coils[1] = True
    file._write()
    assert os.stat(folder / "state").st_ino != first
    close(file)


def test_a_slow_write_is_followed_by_a_pause_four_times_as_long(folder: Path, monkeypatch) -> None:
    pauses: list[float] = []
    clock = SimpleNamespace(monotonic=iter([0, 2, 10, 10.01]).__next__)
    monkeypatch.setattr(state_file, "time", clock)
    monkeypatch.setattr(state_file, "WRITE_EVERY", 0.1)
    file: Any = StateFile(str(folder / "state"), dict)
    file._is_closed.wait = lambda pause: pauses.append(pause) or len(pauses) > 2
    file._run()
    assert pauses == [0.1, 8, 0.1]


def test_the_state_is_written_while_the_server_runs(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(state_file, "WRITE_EVERY", 0.001)
    units = plant(folder)
    file = kept(folder, units)
    units[2].mapping.coils[1] = True
    while '"coils"' not in (folder / "state").read_text():
        pass
    close(file)


def test_a_second_program_with_the_same_file_is_refused(folder: Path) -> None:
    (folder / "link").symlink_to(folder / "state")
    file = kept(folder, plant(folder))
    for name in ("state", "link"):
        with pytest.raises(ValueError, match=f"{name}: in use by another program"):
            kept(folder, plant(folder), name)
    close(file)
    close(kept(folder, plant(folder)))


def test_a_forked_child_neither_writes_nor_holds_the_lock(folder: Path) -> None:
    units = plant(folder)
    file = kept(folder, units)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            units[2].mapping.coils[1] = True
            close(file)
            code = 0
        finally:
            os.write(write, b"%d" % code)
            signal.pause()
            os._exit(0)
    try:
        assert os.read(read, 1) == b"0"
        with pytest.raises(ValueError, match="in use"):
            kept(folder, plant(folder))
        close(file)
        assert "coils" not in (folder / "state").read_text()
        close(kept(folder, plant(folder)))  # though the child still lives
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)


def test_files_of_a_killed_process_are_removed(folder: Path) -> None:
    (folder / "state.abcd1234.new").write_text("half")
    (folder / "state.mine.new").write_text("another")
    close(kept(folder, plant(folder)))
    assert {path.name for path in folder.iterdir()} == {
        *("map.csv", "state", "state.lock", "state.mine.new")
    }


def failing(number: int) -> Callable[..., Any]:
    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


@each_case(
    ("step", "number"),
    [
        ("fsync", errno.ENOSPC),
        ("fsync", errno.EIO),
        ("replace", errno.EROFS),
        ("replace", errno.EACCES),
    ],
)
def test_a_file_that_cannot_be_written_is_logged_once(
    step, number, folder: Path, monkeypatch, caplog
) -> None:
    caplog.clear()
    (folder / "state").unlink(missing_ok=True)
    units = plant(folder)
    file = kept(folder, units)
    file._write()
    before = (folder / "state").read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(os, step, failing(number))
        for number_of_coil in range(3):
            units[2].mapping.coils[number_of_coil] = True
            file._write()
    reason = os.strerror(number)
    path = folder / "state"
    assert caplog.messages == [f"{path}: {reason}; until it can be written, values are not kept"]
    assert path.read_bytes() == before
    close(file)
    assert caplog.messages[1:] == [f"{path}: values are kept again"]
    assert '"coils": {"0": [1, 1, 1]}' in path.read_text()


@each_case("number", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_a_folder_without_write_permission_is_an_error(number, folder: Path, monkeypatch, caplog):
    caplog.clear()
    (folder / "state").unlink(missing_ok=True)
    (folder / "state.lock").unlink(missing_ok=True)
    open_ = os.open

    def refusing(path: Any, flags: int, *mode: Any, **more: Any) -> int:
        if flags & os.O_CREAT and str(path).startswith(str(folder)):
            failing(number)()
        return open_(path, flags, *mode, **more)

    units = plant(folder)
    with monkeypatch.context() as patched:
        patched.setattr(os, "open", refusing)
        file = kept(folder, units)
        file._write()
        units[2].mapping.coils[1] = True
        file._write()
        assert len(caplog.messages) == 1
        assert units[2].answer(pdu.ReadCoils(1, 1).encode()) == b"\1\1\1"
    close(file)
    assert caplog.messages[1:] == [f"{folder / 'state'}: values are kept again"]


def registers() -> Device:
    return Device(Mapping(holding_registers=200))


def test_the_values_of_a_server_are_kept(folder: Path) -> None:
    path = folder / "state"
    for value in (0, 7):
        units = {1: registers(), 2: registers()}
        with Server(units, state=path).background("tcp://127.0.0.1:0") as running:
            assert units[2].mapping.holding_registers[5] == value
            with Client(running.urls[0], unit=2) as client:
                client.write_register(5, 7)


def test_a_server_that_starts_again_keeps_values_set_in_between(folder: Path) -> None:
    device = registers()
    server = Server(device, state=folder / "state")
    for value in range(3):
        assert device.mapping.holding_registers[0] == value
        with (
            server.background("tcp://127.0.0.1:0"),
            server.background("tcp://127.0.0.1:0"),  # in two loops at once
            pytest.raises(ValueError, match=r"state: .*state: in use by another program"),
            Server(registers(), state=folder / "state").background("tcp://127.0.0.1:0"),
        ):
            pytest.fail("two servers keep the same file")
        device.mapping.holding_registers[0] = value + 1


@pytest.fixture
def wrong_files(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "binary").write_bytes(b"\xff")
    (tmp_path / "half").write_text("{")
    return tmp_path


@each_case(
    ("name", "message"),
    [
        ("missing/state", "No such file or directory"),
        ("pipe", "not a regular file"),
        ("folder", "Is a directory"),
        ("binary", "not UTF-8 at byte 0"),
        ("half", r"line 1, column 2: not JSON: .* \(is the file cut off\?\); no value was loaded"),
    ],
)
def test_a_wrong_file_is_refused_before_the_server_starts(name, message, wrong_files: Path) -> None:
    path = wrong_files / name
    with (
        pytest.raises(ValueError, match=f"^state: {path}: {message}"),
        Server(registers(), state=path).background("tcp://127.0.0.1:0"),
    ):
        pytest.fail("it serves")


def test_a_deleted_folder_is_logged_and_the_server_continues(folder: Path, caplog) -> None:
    place = folder / "place"
    place.mkdir()
    device = registers()
    with Server(device, state=place / "state").background("tcp://127.0.0.1:0") as running:
        shutil.rmtree(place)
        with Client(running.urls[0]) as client:
            client.write_register(5, 7)
            assert client.read_holding_registers(5, 1) == [7]
    (line,) = caplog.messages
    assert line.startswith(f"{place}/state: No such file or directory; until it can be written")


SERVING = """
import sys
from libmodbus_py import Device, Mapping, Server

server = Server(Device(Mapping(holding_registers=200)), state=sys.argv[1])
on_listening = lambda running: print(*running.urls, flush=True)
server.serve_forever("tcp://127.0.0.1:0", on_listening=on_listening)
"""


@pytest.mark.slow
def test_a_killed_server_leaves_one_whole_state(tmp_path: Path) -> None:
    path, value = tmp_path / "state", 0
    for seed in range(8):
        command = [sys.executable, "-c", SERVING, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            with Client(process.stdout.readline().strip()) as client:
                for _ in range(random.Random(seed).randrange(2000)):
                    value += 1
                    client.write_registers(0, [value] * 100)
                process.kill()
        device = registers()
        device.load(path)
        (kept_value,) = set(device.mapping.holding_registers[:100])
        assert kept_value <= value
