"""
The file that keeps the values of served devices: what it has, who may use it, and what fails.
"""

import errno
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import device_file, pdu
from libmodbus_py.tools.simulator.values_file import ValuesFile
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


def kept(folder: Path, units: Any, told: list[str] | None = None) -> ValuesFile:
    tell: Callable[[str], object] = pytest.fail if told is None else told.append
    return ValuesFile(str(folder / "state"), lambda: units, tell=tell)


def after_a_write(folder: Path) -> None:
    """Serve the plant once, with values that clients write."""
    units = plant(folder)
    file = kept(folder, units)
    file.start()
    for unit, request in (
        (1, pdu.WriteRegister(0, 215)),
        (1, pdu.WriteRegisters(100, [8] * 100)),
        (1, pdu.WriteRegister(200, 7)),  # as at first
        (1, pdu.WriteFileRecords([(4, 4, [9])])),
        (2, pdu.WriteCoil(5, True)),
    ):
        assert units[unit].answer(request.encode())[0] == request.function
    units[1].answer(pdu.ReadHoldingRegisters(900, 1).encode())  # a moving value
    file.close()


def test_written_values_survive_a_restart_and_nothing_else_is_kept(folder: Path) -> None:
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
    # New first values hold where nothing was written.
    units = plant(folder, PLANT.replace("value = 7", "value = 6"))
    kept(folder, units).close()
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
def test_values_of_another_device_are_refused(
    change: tuple[str, str], message: str, folder: Path
) -> None:
    after_a_write(folder)
    before = (folder / "state").read_bytes()
    assert change[0] in PLANT
    units = plant(folder, PLANT.replace(*change))
    first = {unit: list(device.mapping.holding_registers) for unit, device in units.items()}
    with pytest.raises(ValueError, match=message):
        kept(folder, units)
    assert first == {unit: list(each.mapping.holding_registers) for unit, each in units.items()}
    assert (folder / "state").read_bytes() == before
    kept(folder, plant(folder)).close()  # and the lock is free


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
    file.close()


def test_it_is_written_while_it_is_served(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from libmodbus_py.tools.simulator import values_file

    monkeypatch.setattr(values_file, "WRITE_EVERY", 0.001)
    units = plant(folder)
    file = kept(folder, units)
    file.start()
    units[2].mapping.coils[1] = True
    while '"coils"' not in (folder / "state").read_text():
        pass
    file.close()


# --- who may use it -------------------------------------------------------------------------


def test_a_second_program_is_refused(folder: Path) -> None:
    (folder / "link").symlink_to(folder / "state")
    file = kept(folder, plant(folder))
    file.start()
    for name in ("state", "link"):
        with pytest.raises(ValueError, match=f"{name}: in use by another program"):
            ValuesFile(str(folder / name), lambda: plant(folder), tell=pytest.fail)
    file.close()
    file.close()
    kept(folder, plant(folder)).close()


def test_a_forked_child_neither_writes_nor_holds_the_lock(folder: Path) -> None:
    units = plant(folder)
    file = kept(folder, units)
    file.start()
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            units[2].mapping.coils[1] = True
            file.close()
            code = 0
        finally:
            os.write(write, b"%d" % code)
            signal.pause()
            os._exit(0)
    try:
        assert os.read(read, 1) == b"0"
        with pytest.raises(ValueError, match="in use"):
            kept(folder, plant(folder))
        file.close()
        assert "coils" not in (folder / "state").read_text()
        kept(folder, plant(folder)).close()  # though the child still lives
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)


def test_what_a_killed_process_left_is_removed(folder: Path) -> None:
    (folder / "state.abcd1234.new").write_text("half")
    (folder / "state.mine.new").write_text("another")
    kept(folder, plant(folder)).close()
    assert {path.name for path in folder.iterdir()} == {
        *("map.csv", "state", "state.lock", "state.mine.new")
    }


# --- what fails -----------------------------------------------------------------------------


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
def test_a_file_that_cannot_be_written_is_told_once(
    step: str, number: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "state").unlink(missing_ok=True)
    units, told = plant(folder), list[str]()
    file = kept(folder, units, told)
    file._write()
    before = (folder / "state").read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(os, step, failing(number))
        for number_of_coil in range(3):
            units[2].mapping.coils[number_of_coil] = True
            file._write()
    reason = os.strerror(number)
    path = folder / "state"
    assert told == [f"{path}: {reason}; until it can be written, values are not kept"]
    assert path.read_bytes() == before
    file.close()
    assert told[1:] == [f"{path}: values are kept again"]
    assert '"coils": {"0": [1, 1, 1]}' in path.read_text()


@each_case("number", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_a_folder_that_takes_no_files(
    number: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "state").unlink(missing_ok=True)
    (folder / "state.lock").unlink(missing_ok=True)
    open_ = os.open

    def refusing(path: Any, flags: int, *mode: Any, **more: Any) -> int:
        if flags & os.O_CREAT and str(path).startswith(str(folder)):
            failing(number)()
        return open_(path, flags, *mode, **more)

    units, told = plant(folder), list[str]()
    with monkeypatch.context() as patched:
        patched.setattr(os, "open", refusing)
        file = kept(folder, units, told)
        file._write()
        units[2].mapping.coils[1] = True
        file._write()
        assert len(told) == 1
        assert units[2].answer(pdu.ReadCoils(1, 1).encode()) == b"\1\1\1"
    file.close()
    assert told[1:] == [f"{folder / 'state'}: values are kept again"]
