"""Hooks in a file of Python: which are called, and the errors of a file with a mistake."""

import os
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, device_file, pdu
from libmodbus_py.tools.simulator.hooks_file import HooksFile
from tests.support.cases import each_case

HOOKS = """
from __future__ import annotations

from dataclasses import dataclass

from libmodbus_py import Access, Hook, IllegalDataValue


@dataclass
class Limit:
    most: int


LIMIT = Limit(100)


def before_write(access: Access) -> None:
    if max(access.values) > LIMIT.most:
        raise IllegalDataValue


def after_write(access: Access) -> None:
    access.device.mapping.input_registers[0] = access.values[0]


def count(access: Access) -> None:
    access.device.mapping.input_registers[5] += 1


before_read = Hook(count, input_registers=range(5, 6))
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "hooks.py").write_text(HOOKS)
    return tmp_path / "hooks.py"


def write(device: Device, value: int) -> int:
    """Write a register, and return the function code of the response."""
    return device.answer(pdu.WriteRegister(0, value).encode())[0]


def input_register(device: Device, address: int) -> int:
    request = pdu.ReadInputRegisters(address, 1)
    return request.decode_response(device.answer(request.encode()))[0]


def tables() -> Device:
    return Device(Mapping(holding_registers=10, input_registers=10))


def test_the_functions_of_a_file_are_the_hooks_of_all_devices(path: Path) -> None:
    one, other = tables(), tables()
    HooksFile(str(path)).use({1: one, 2: other})
    assert [write(one, 100), write(one, 101), write(other, 7)] == [6, 0x86, 6]
    assert [input_register(one, 0), input_register(other, 0)] == [100, 7]
    assert [input_register(one, 5), input_register(one, 5), input_register(other, 5)] == [1, 2, 1]


def test_a_value_moves_before_the_hook_of_a_read_sees_it(path: Path) -> None:
    path.write_text("def before_read(access):\n    access.device.mapping.coils[0] = seen(access)\n")
    path.write_text(
        path.read_text() + "def seen(access):\n    return access.device['power'] == 7\n"
    )
    text = """
    [[unit]]
    coils = [{ address = 0 }]
    holding_registers = [{ address = 0, value = 7 }]
    [[unit.input_registers]]
    address = 0
    name = "power"
    copy = { table = "holding_registers", address = 0 }
    """
    device = device_file.parse(text).devices
    assert isinstance(device, Device)
    HooksFile(str(path)).use(device)
    assert input_register(device, 0) == 7
    assert device.mapping.coils[0]


def test_an_invalid_file_keeps_the_former_hooks(path: Path) -> None:
    device = tables()
    file = HooksFile(str(path))
    file.use(device)
    assert file.read_again(device) == f"{path}: read again, before_write, after_write, before_read"
    for text in ("def after_write(access):\n    return (\n", "raise SystemExit(3)"):
        path.write_text(text)
        assert file.read_again(device).startswith(f"the former content is used: {path}, line ")
        assert write(device, 101) == 0x86
    path.write_text("def after_write(access):\n    pass\n")
    assert file.read_again(device) == f"{path}: read again, after_write"
    assert write(device, 101) == 6


def test_a_failure_is_logged_again_after_a_change(path: Path, caplog) -> None:
    path.write_text("def after_write(access):\n    1 / 0\n")
    device = tables()
    file = HooksFile(str(path))
    file.use(device)
    for count in (1, 2):
        assert [write(device, 1), write(device, 1)] == [0x86, 0x86]
        assert len(caplog.records) == count
        assert f'File "{path}", line 2, in after_write' in caplog.text
        file.read_again(device)


MISTAKES = [
    ("def before_write(access)\n    pass\n", ", line 1: SyntaxError: expected ':'"),
    ("import no_such_module\n", ", line 1: ModuleNotFoundError: No module named 'no_such_module'"),
    ("def f():\n    return 1 / 0\n\n\nf()\n", ", line 2: ZeroDivisionError: division by zero"),
    ("x = 1\nraise SystemExit('no')\n", ", line 2: SystemExit: no"),
    ("\nasync def before_read(access): ...\n", ", line 2: before_read must be a plain function"),
    ("\ndef after_write(): ...\n", ", line 2: after_write must take one argument, an Access"),
    ("\ndef after_wrote(access): ...\n", ", line 2: after_wrote is no hook; .*mean after_write"),
    ("before_write = 5\n", ": before_write must be a function, not int"),
    ("def on_write(access): ...\n", ": has none of before_write, after_write, before_read"),
    ("x = '\N{LATIN SMALL LETTER E WITH ACUTE}'", ".*: SyntaxError: .*utf-8"),
]


@each_case(("text", "message"), MISTAKES)
def test_a_mistake_is_named_with_its_line(text: str, message: str, path: Path) -> None:
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=f"^{path}{message}"):
        HooksFile(str(path))


@each_case("name", ["missing", "pipe", "folder", "/dev/zero"])
def test_a_path_that_is_no_file_is_refused_at_once(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "pipe":
        os.mkfifo(path)
    if name == "folder":
        path.mkdir()
    with pytest.raises(ValueError, match=f"^cannot read {path}: "):
        HooksFile(str(path))
