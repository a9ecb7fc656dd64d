"""The option --hooks of serve: functions of a file of Python, read again on SIGHUP."""

import signal
from pathlib import Path

import pytest

from libmodbus_py import Client, IllegalDataAddress
from tests.cli.serving import INFO, reload_line, serving
from tests.support.commands import run

SERVE = ("serve", "tcp://127.0.0.1:0", "--hooks")

REFUSING = """
from libmodbus_py import IllegalDataAddress


def before_write(access):
    raise IllegalDataAddress
"""

PLANT = "[[unit]]\nid = 1\nholding_registers = [{ address = 0, count = 10 }]\n"


def test_hooks_are_read_again_with_and_without_a_device_file(tmp_path: Path) -> None:
    hooks, plant = tmp_path / "hooks.py", tmp_path / "plant.toml"
    plant.write_text(PLANT)
    for options in ([], ["--device", plant]):
        hooks.write_text(REFUSING)
        with serving(*SERVE, hooks, *options, *INFO) as (process, url), Client(url, unit=1) as plc:
            with pytest.raises(IllegalDataAddress):
                plc.write_register(0, 1)
            hooks.write_text("def before_write(access)")
            plant.write_text(PLANT.replace("10", "20"))
            process.send_signal(signal.SIGHUP)
            line = reload_line(process)
            assert f"the former content is used: {hooks}, line 1: SyntaxError: expected ':'" in line
            with pytest.raises(IllegalDataAddress):
                plc.write_register(0, 1)
            hooks.write_text("def before_write(access): pass")
            process.send_signal(signal.SIGHUP)
            assert f"{hooks}: read again, before_write" in reload_line(process)
            plc.write_register(0, 1)
            plant.write_text(PLANT)


def test_a_mistake_ends_the_command_before_it_serves(tmp_path: Path) -> None:
    hooks = tmp_path / "hooks.py"
    hooks.write_text("\ndef before_writing(access): ...\n")
    result = run(*SERVE, hooks)
    assert (result.code, result.out) == (2, "")
    assert f"{hooks}, line 2: before_writing is no hook; hooks are before_write, " in result.err
