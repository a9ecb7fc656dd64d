"""
Devices that several threads use, or a process and its child.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import pdu
from tests.device.devices import new_device, words


@pytest.fixture
def quick_switches() -> Iterator[None]:
    """Let threads take turns within one answer, not only between answers."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


class TestThreadsAndForks:
    @pytest.mark.parametrize("devices", [1, 4])
    def test_threads_get_their_own_answers(self, devices: int, quick_switches: None) -> None:
        """Of one device, whose lock they share, and of their own, where no lock helps."""
        made = [new_device() for _ in range(devices)]
        wrong: list[Any] = []

        def work(number: int) -> None:
            device = made[number % devices]
            address = 100 + number
            for turn in range(400):
                write = b"\x06" + words(address, turn)
                read = b"\x03" + words(address, 1)
                if device.answer(write) != write:
                    wrong.append(("write", number, turn))
                if device.answer(read) != b"\x03\2" + words(turn):
                    wrong.append(("read", number, turn))
                if device.answer(b"\x03" + words(0, 1)) != b"\x83\2":
                    wrong.append(("refusal", number, turn))

        threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert wrong == []

    def test_no_reader_sees_half_a_write(self, quick_switches: None) -> None:
        """Neither half of a run of registers nor one of two pieces of a file."""
        device = new_device()
        stop = threading.Event()
        mixed: list[Any] = []

        def write() -> None:
            turn = 0
            while not stop.is_set():
                turn = (turn + 1) & 0xFFFF
                device.answer(b"\x10" + words(100, 100) + bytes([200]) + words(*[turn] * 100))
                device.answer(two_pieces(turn).encode())

        def two_pieces(turn: int) -> pdu.WriteFileRecords:
            return pdu.WriteFileRecords([(4, 0, [turn] * 2), (4, 100, [turn] * 2)])

        def read_registers() -> None:
            for _ in range(400):
                values = device.answer(b"\x03" + words(100, 100))[2:]
                if values != values[:2] * 100:
                    mixed.append(values)

        def read_table() -> None:
            for _ in range(400):
                values = device.mapping.holding_registers[100:200]
                if len(set(values)) != 1:
                    mixed.append(values)

        def read_file() -> None:
            request = pdu.ReadFileRecords([(4, 0, 2), (4, 100, 2)])
            for _ in range(400):
                first, second = request.decode_response(device.answer(request.encode()))
                if first != second:
                    mixed.append((first, second))

        device.answer(two_pieces(0).encode())
        writer = threading.Thread(target=write)
        readers = [
            threading.Thread(target=read) for read in (read_registers, read_table, read_file)
        ]
        for thread in (writer, *readers):
            thread.start()
        for thread in readers:
            thread.join()
        stop.set()
        writer.join()
        assert mixed == []

    def test_child_and_parent_answer_after_a_fork(self) -> None:
        script = """
import os, struct
from libmodbus_py import Device, Mapping

device = Device(Mapping(holding_registers=4))
READ = b"\\3\\0\\0\\0\\2"

def write(address, value):
    request = b"\\6" + struct.pack(">HH", address, value)
    assert device.answer(request) == request, request

write(0, 1)
children = []
for number in range(3):
    child = os.fork()
    if not child:
        try:
            for turn in range(200):
                write(1, turn)
                answer = device.answer(READ)
                assert answer[:2] == b"\\3\\4", answer
            os._exit(0)
        finally:
            os._exit(1)
    children.append(child)
for turn in range(200):
    write(0, turn)
    answer = device.answer(READ)
    assert answer[:4] == b"\\3\\4" + struct.pack(">H", turn), answer
assert [os.waitpid(child, 0)[1] for child in children] == [0, 0, 0]
write(0, 7)
assert device.answer(READ)[:4] == b"\\3\\4\\0\\7"
print("good")
"""
        run = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, timeout=50, check=False
        )
        assert (run.stdout, run.stderr) == ("good\n", "")
