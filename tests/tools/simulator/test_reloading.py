"""A device file that is read again while its devices are served: what stays, and what is told."""

import asyncio
import gc
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from libmodbus_py import Client, Device, Server, pdu
from libmodbus_py.tools.simulator.device_file import SimulatedDevice, load, parse
from libmodbus_py.tools.simulator.reloading import Reloader
from libmodbus_py.tools.simulator.simulated import Simulation
from tests.support.cases import each_case
from tests.support.peers import until
from tests.tools.simulator.simulated_units import Clock

PLAIN = """
[[unit]]
id = 1
holding_registers = [{ address = 0, values = [1, 2] }, { address = 10, type = "int32", value = 5 }]
coils = [{ address = 0 }]
file = [{ number = 4, record = 0, values = [7, 8] }]
fifo = [{ address = 3, values = [1, 2] }]
input_registers = [
    { address = 0, counter = { interval = 1 } },
    { address = 1, random_walk = { low = 0, high = 60000, step = 500 } },
]
[[unit]]
id = 2
holding_registers = [{ address = 0, value = 3 }]
"""


def after(
    before: str, change: Callable[[SimulatedDevice, Clock], object], text: str
) -> SimulatedDevice:
    """Unit 1, served from one text, changed, and read again from another after ten seconds."""
    clock = Clock()
    old = parse(before, clock=clock)
    assert isinstance(old.devices, dict)
    change(old.devices[1], clock)
    clock.now += 10
    made = parse(text, clock=clock).with_state_of(old)
    assert isinstance(made.devices, dict)
    return made.devices[1]


def write_all(device: SimulatedDevice, _: Clock) -> None:
    for request in (
        pdu.WriteRegisters(0, [11, 12]),
        pdu.WriteRegisters(10, [0, 55]),
        pdu.WriteCoil(0, True),
        pdu.WriteFileRecords([(4, 0, [77, 88])]),
    ):
        device.answer(request.encode())
    device.fifos[3].append(9)


@each_case("text", [PLAIN, "# a comment\n" + PLAIN, PLAIN.replace("id = 2", "id = 9")])
def test_a_unit_whose_entry_did_not_change_keeps_its_device(text: str) -> None:
    devices: list[Device] = []
    assert after(PLAIN, lambda device, _: devices.append(device), text) is devices[0]


def test_values_written_by_clients_are_kept_in_unchanged_ranges() -> None:
    text = PLAIN.replace("id = 1", "id = 1\nname = 'other'")
    device = after(PLAIN, write_all, text)
    assert device.name == "other"
    assert device.mapping.holding_registers[0:2] == [11, 12]
    assert device.mapping.holding_registers[10:12] == [0, 55]
    assert device.mapping.coils[0] is True
    assert list(device.files[4]) == [77, 88]
    assert device.fifos[3] == [1, 2, 9]


@each_case(
    ("old", "new", "cells"),
    [
        ("values = [1, 2]", "values = [1, 3]", [1, 3, 0, 55]),
        ("values = [1, 2]", "values = [1, 2, 3]", [1, 2, 0, 55]),
        ('"int32", value = 5', '"int32", value = 6', [11, 12, 0, 6]),
        ('"int32", value = 5', '"uint32", value = 5', [11, 12, 0, 5]),
        ('"int32", value = 5', '"int32", scale = 0.5, value = 2.5', [11, 12, 0, 5]),
    ],
)
def test_changed_parts_of_the_file_take_effect(old: str, new: str, cells: list[int]) -> None:
    registers = after(PLAIN, write_all, PLAIN.replace(old, new)).mapping.holding_registers
    assert [*registers[0:2], *registers[10:12]] == cells


def test_moving_values_continue_after_a_reload() -> None:
    text = PLAIN.replace("id = 1", "id = 1\nname = 'other'")
    moving = pdu.ReadInputRegisters(0, 2)
    cells: list[list[int]] = []

    def look_ahead(device: SimulatedDevice, clock: Clock) -> None:
        clock.now += 10
        cells.append(moving.decode_response(device.answer(moving.encode())))
        clock.now -= 10

    device = after(PLAIN, look_ahead, text)
    assert moving.decode_response(device.answer(moving.encode())) == cells[0]
    assert cells[0][0] == 10


@contextmanager
def reloading(
    path: Path, *, is_watching: bool = False
) -> Iterator[tuple[Callable[[], object], Client, list[str]]]:
    """Serve the file in a thread; yield what asks for another reading, a client, what is told."""
    messages: list[str] = []
    simulation = load(path)
    server = Server(simulation.devices, faults=simulation.faults)
    reloader = Reloader(
        server,
        str(path),
        simulation,
        is_watching=is_watching,
        tell=lambda lines: messages.append("; ".join(lines)),
    )
    starts: queue.Queue[tuple[asyncio.AbstractEventLoop, asyncio.Event, str]] = queue.Queue()

    async def run() -> None:
        stopped = asyncio.Event()
        async with server.serving("tcp://127.0.0.1:0") as running:
            reloader.start()
            starts.put((asyncio.get_running_loop(), stopped, running.urls[0]))
            await stopped.wait()
            reloader.close()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    loop, stopped, url = starts.get(timeout=20)
    try:
        with Client(url, unit=1, timeout=5) as client:
            yield partial(loop.call_soon_threadsafe, reloader.ask), client, messages
    finally:
        loop.call_soon_threadsafe(stopped.set)
        thread.join()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "device.toml"
    file.write_text(PLAIN)
    return file


def test_a_mistake_keeps_the_old_devices_and_is_reported(path: Path) -> None:
    with reloading(path) as (ask, client, messages):
        client.write_register(0, 42)
        for text, message in (
            (
                PLAIN.replace("id = 1", "id = 999"),
                "the former content is used: {}, line 3: unit[0].id must",
            ),
            (PLAIN[:40], "the former content is used: {}"),
            (None, "the former content is used: cannot read {}: No such file"),
        ):
            messages.clear()
            if text is None:
                path.unlink()
            else:
                path.write_text(text)
            ask()
            until(lambda: len(messages) == 1)
            assert messages[0].startswith(message.format(path))
            assert "\n" not in messages[0]
            assert client.read_holding_registers(0, 2) == [42, 2]
        path.write_text(PLAIN.replace("values = [1, 2]", "values = [3, 4]"))
        messages.clear()
        ask()
        until(lambda: client.read_holding_registers(0, 2) == [3, 4])
        until(lambda: messages == [f"{path}: read again, 2 units: 1 changed"])
        assert client.read_holding_registers(10, 2) == [0, 5]


def test_a_reload_logs_what_has_changed(path: Path) -> None:
    fault = "[[unit.fault]]\nkind = 'no_answer'\nfunction = 1\n"
    with reloading(path) as (ask, _, messages):
        for text, changes in (
            (PLAIN, "2 units: no change"),
            (PLAIN.replace("id = 2", "id = 9"), "2 units: 1 new, 1 removed"),
            (PLAIN.replace("id = 2", "id = 9") + fault, "2 units: 1 changed; its faults have"),
        ):
            messages.clear()
            path.write_text(text)
            ask()
            until(lambda: len(messages) == 1)
            assert messages[0].startswith(f"{path}: read again, {changes}")


def test_changes_of_maps_and_new_maps_are_noticed(path: Path, monkeypatch) -> None:
    looks = 0

    def signatures(reloader: Reloader) -> object:
        nonlocal looks
        looks += 1
        return look(reloader)

    look = Reloader._signatures
    monkeypatch.setattr(Reloader, "_signatures", signatures)
    monkeypatch.setattr("libmodbus_py.tools.simulator.reloading.LOOK_EVERY_S", 0.02)
    with reloading(path, is_watching=True) as (_, client, messages):
        path.write_text("[[unit]]\nid = 1\nmap = 'meter.csv'\nvalues = { a = 5 }")
        until(lambda: len(messages) == 1)
        assert "meter.csv: No such file" in messages[0]
        path.with_name("meter.csv").write_text("name,table,address\na,holding,7\n")
        until(lambda: len(messages) == 2)
        assert client.read_holding_registers(7, 1) == [5]
        path.with_name("meter.csv").write_text("name,table,address\na,holding,17\n")
        until(lambda: len(messages) == 3)
        assert client.read_holding_registers(17, 1) == [5]
        before = looks
        until(lambda: looks > before + 5)
        assert len(messages) == 3


def test_values_written_during_a_reload_are_kept(path: Path) -> None:
    stopped = threading.Event()

    def storm(ask: Callable[[], object]) -> None:
        number = 0
        while not stopped.is_set():
            number += 1
            path.write_text(PLAIN.replace("id = 1", f"id = 1\nname = 'number {number}'"))
            ask()
            time.sleep(0.002)

    with reloading(path) as (ask, client, messages):
        thread = threading.Thread(target=storm, args=(ask,))
        thread.start()
        try:
            number = 0
            while sum("read again" in message for message in messages) < 50:
                number += 1
                client.write_register(0, number % 65536)
                assert client.read_holding_registers(0, 1) == [number % 65536]
        finally:
            stopped.set()
            thread.join()


def test_a_server_that_ends_during_a_reload_leaves_no_task(path: Path, monkeypatch):
    start, stop = threading.Event(), threading.Event()

    def read(name: str) -> Simulation:
        start.set()
        stop.wait(20)
        return load(name)

    with reloading(path) as (ask, _, messages):
        monkeypatch.setattr("libmodbus_py.tools.simulator.reloading.load", read)
        ask()
        assert start.wait(20)
        end = threading.Timer(0.1, stop.set)
        end.start()
    end.join()
    assert messages == []


def test_replaced_devices_are_freed(path: Path) -> None:
    with reloading(path) as (ask, client, messages):
        for number in range(25):
            path.write_text(PLAIN.replace("id = 1", f"id = 1\nname = 'number {number}'"))
            messages.clear()
            ask()
            until(lambda: bool(messages))
        assert client.read_holding_registers(0, 2) == [1, 2]
        gc.collect()
        until(lambda: sum(isinstance(item, SimulatedDevice) for item in gc.get_objects()) < 10)
