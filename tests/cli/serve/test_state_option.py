"""The option --state of serve: written values survive a restart, however the server ended."""

import re
import signal
from pathlib import Path

import pytest

from libmodbus_py import Client
from tests.cli.serving import INFO, reload_line, serving
from tests.support.cases import each_case
from tests.support.commands import run

PLANT = """
[[unit]]
id = 1
holding_registers = [{ address = 0, count = 10 }]
[[unit]]
id = 2
coils = [{ address = 0, count = 8 }]
"""


SERVE = ("serve", "tcp://127.0.0.1:0")


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    (tmp_path / "plant.toml").write_text(PLANT)
    return tmp_path / "plant.toml"


@each_case("end", [signal.SIGTERM, signal.SIGINT])
def test_values_of_plain_tables_are_kept(end: signal.Signals, tmp_path: Path) -> None:
    state = tmp_path / f"state-{end}"
    with serving(*SERVE, "--state", state, end=end) as (_, url), Client(url, unit=9) as plc:
        plc.write_registers(65534, [7, 8])
        plc.write_coil(3, True)
        plc.write_file_records([(10, 9999, [42])])
    with serving(*SERVE, "--state", state) as (_, url), Client(url) as plc:
        assert plc.read_holding_registers(65533, 3) == [0, 7, 8]
        assert plc.read_coils(2, 3) == [False, True, False]
        assert plc.read_file_records([(10, 9998, 2)]) == [[0, 42]]


def test_values_are_kept_when_a_device_file_is_read_again(plant: Path, tmp_path: Path) -> None:
    state = tmp_path / "state"
    arguments = ("--device", plant, "--state", state, *INFO)
    with serving(*SERVE, *arguments) as (process, url), Client(url, unit=1) as plc:
        plc.write_register(3, 33)
        plc.for_unit(2).write_coil(7, True)
        plant.write_text(PLANT + "[[unit.holding_registers]]\naddress = 5\nvalue = 9\n")
        process.send_signal(signal.SIGHUP)
        assert "read again, 2 units" in reload_line(process)
        plc.write_register(4, 44)
        assert plc.for_unit(2).read_holding_registers(5, 1) == [9]
    with serving(*SERVE, *arguments) as (_, url), Client(url, unit=1) as plc:
        assert plc.read_holding_registers(3, 2) == [33, 44]
        assert plc.for_unit(2).read_coils(7, 1) == [True]
        assert plc.for_unit(2).read_holding_registers(5, 1) == [9]


def test_a_state_of_other_devices_is_refused_before_anything_is_served(plant: Path, tmp_path):
    state = tmp_path / "state"
    with serving(*SERVE, "--state", state) as (_, url), Client(url) as plc:
        plc.write_register(0, 1)
    result = run(*SERVE, "--device", plant, "--state", state)
    assert result.code == 2
    assert result.out == ""
    assert f"state: {state}: units.every: no such unit is served, only 1, 2; no value" in result.err
    assert "rename the file to start without its values" in result.err


def test_a_file_that_cannot_be_created_is_logged_once(plant: Path) -> None:
    with (
        serving(*SERVE, "--device", plant, "--state", "/sys/state") as (process, url),
        Client(url, unit=1) as plc,
    ):
        plc.write_register(3, 33)
        assert plc.read_holding_registers(3, 1) == [33]
        message = process.stderr.readline()
    # As in most containers, /sys may be mounted so that nobody can write.
    text = r"/sys/state: (Permission denied|Read-only file system); until it can be written, values"
    assert re.search(f"{text} are not kept", message)


def test_the_state_is_written_at_the_end_even_if_the_server_failed(tmp_path: Path) -> None:
    with serving(*SERVE, "--state", tmp_path / "first") as (_, url):
        result = run("serve", url, "--state", tmp_path / "state")
    assert result.code == 1
    assert "Address already in use" in result.err
    assert (tmp_path / "state").read_text().endswith("}}\n")
