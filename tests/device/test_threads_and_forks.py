"""Devices that several threads use, or a process and its child."""

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, pdu
from tests.device.devices import new_device, words
from tests.support.cases import each_case

# Over TCP, to unit 1.
READ_ONE = bytes.fromhex("0001 0000 0006 01 03 0000 0001")


@pytest.fixture
def quick_switches() -> Iterator[None]:
    """Let threads take turns within one answer, not only between answers."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


class TestThreads:
    @pytest.mark.parametrize("devices", [1, 4])
    def test_threads_get_their_own_answers(self, devices: int, quick_switches: None) -> None:
        """Requests to one device with a lock, and to the thread's own devices without one."""
        devices_ = [new_device() for _ in range(devices)]
        wrong: list[Any] = []

        def work(number: int) -> None:
            device = devices_[number % devices]
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

    def test_a_reader_never_gets_half_a_write(self, quick_switches: None) -> None:
        """Neither half of a run of registers or of a value, nor one of two pieces of a file."""
        device = new_device()
        table, ones = device.mapping.holding_registers, 0x0001_0001_0001_0001
        stop = threading.Event()
        mixed: list[Any] = []

        def write() -> None:
            turn = 0
            while not stop.is_set():
                turn = (turn + 1) & 0xFFFF
                device.answer(b"\x10" + words(100, 100) + bytes([200]) + words(*[turn] * 100))
                device.answer(two_pieces(turn).encode())
                table.write(300, turn * ones, "uint64")

        def two_pieces(turn: int) -> pdu.WriteFileRecords:
            return pdu.WriteFileRecords([(4, 0, [turn] * 2), (4, 100, [turn] * 2)])

        def read_registers() -> None:
            for _ in range(400):
                values = device.answer(b"\x03" + words(100, 100))[2:]
                if values != values[:2] * 100:
                    mixed.append(values)

        def read_table() -> None:
            for _ in range(400):
                values, value = table[100:200], table.read(300, "uint64")
                if len(set(values)) != 1 or value % ones:
                    mixed.append((values, value))

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


def runs_in_thread(work: Callable[[], object]) -> threading.Event:
    """Start work in another thread; the event says when it is done."""
    end = threading.Event()

    def run() -> None:
        work()
        end.set()

    threading.Thread(target=run, daemon=True).start()
    return end


class TestLock:
    @each_case(
        "work",
        [
            pytest.param(lambda mapping: mapping.coils[0], id="read"),
            pytest.param(lambda mapping: mapping.input_registers[:], id="read all"),
            pytest.param(lambda mapping: mapping.holding_registers.__setitem__(0, 1), id="write"),
            pytest.param(lambda mapping: list(mapping.discrete_inputs), id="iterate"),
            pytest.param(lambda mapping: mapping.input_registers.read(0, "int32"), id="read value"),
            pytest.param(
                lambda mapping: mapping.holding_registers.write(0, 1.0, "float64"), id="write value"
            ),
            pytest.param(lambda mapping: mapping.__enter__(), id="enter"),
            pytest.param(lambda mapping: Device(mapping).answer(b"\3\0\0\0\1"), id="answer"),
            pytest.param(
                lambda mapping: Device(mapping).answer_chunk(READ_ONE, 0, 1), id="answer a chunk"
            ),
        ],
    )
    def test_other_threads_wait_for_the_mapping(self, work: Callable[[Mapping], object]) -> None:
        mapping = Mapping(4, 4, 4, 4)
        with mapping as entered:
            assert entered is mapping
            end = runs_in_thread(lambda: work(mapping))
            assert not end.wait(0.05)
        assert end.wait(10)

    def test_the_thread_that_locked_the_mapping_may_use_it(self) -> None:
        mapping = Mapping(4, 4, 4, 4)
        with mapping, mapping:
            mapping.coils[0] = True
            assert mapping.coils[:] == [True, False, False, False]
            assert Device(mapping).answer(b"\1\0\0\0\4") == b"\1\1\1"

    def test_the_mapping_is_unlocked_after_an_error(self) -> None:
        mapping = Mapping(4)
        with pytest.raises(IndexError), mapping:
            mapping.coils[4]
        assert runs_in_thread(lambda: mapping.coils[0]).wait(10)


def forked(script: str) -> None:
    """Run a program with a mapping that forks once; no thread of pytest is in the child."""
    # On a busy machine a hook takes long, of which the log warns; failures it tells as errors.
    head = """
import logging, os, signal, threading
from libmodbus_py import Device, Mapping

logging.disable(logging.WARNING)
mapping = Mapping(coils=8, holding_registers=70000 // 2)
device = Device(mapping)
assert device.answer(b"\\3\\0\\0\\0\\1") == b"\\3\\2\\0\\0"  # by what only this process uses
registers, view = mapping.holding_registers, mapping.holding_registers.view


def in_child(check):
    child = os.fork()
    if not child:
        status = 1
        try:
            signal.alarm(20)
            check()
            status = 0
        finally:
            os._exit(status)
    return child
"""
    run = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", head + script],
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert (run.stdout, run.stderr) == ("good\n", "")


class TestForks:
    def test_each_process_has_tables_of_its_own(self) -> None:
        """Whichever way they are written: by the table, a view that was kept, or a request."""
        forked("""
registers[0:4] = [1, 2, 3, 4]
go, wait = os.pipe(), os.pipe()

def check():
    assert registers[0:4] == [1, 2, 3, 4]
    registers[0] = 10
    view[1] = 20
    assert device.answer(b"\\6\\0\\2\\0\\x1e")[0] == 6
    mapping.coils[0] = True
    assert registers[0:4] == view[:4].tolist() == [10, 20, 30, 4]
    os.write(wait[1], b"x")
    os.read(go[0], 1)
    assert registers[0:4] == view[:4].tolist() == [10, 20, 30, 4]
    assert device.answer(b"\\3\\0\\0\\0\\4") == b"\\3\\x08\\0\\x0a\\0\\x14\\0\\x1e\\0\\4"

child = in_child(check)
os.read(wait[0], 1)
assert registers[0:4] == view[:4].tolist() == [1, 2, 3, 4]
assert mapping.coils[0] is False
view[3] = 40
assert device.answer(b"\\3\\0\\0\\0\\4") == b"\\3\\x08\\0\\1\\0\\2\\0\\3\\0\\x28"
os.write(go[1], b"x")
assert os.waitpid(child, 0)[1] == 0
assert registers[0:4] == [1, 2, 3, 40]
print("good")
""")

    def test_a_lock_that_another_thread_held_does_not_stop_the_child(self) -> None:
        forked("""
held, done = threading.Event(), threading.Event()

def hold():
    with mapping:
        held.set()
        done.wait()

thread = threading.Thread(target=hold)
thread.start()
held.wait()

def check():
    assert device.answer(b"\\3\\0\\0\\0\\1") == b"\\3\\2\\0\\0"
    registers[0] = 1
    with mapping:
        registers[1] = 2
    answers = []
    other = threading.Thread(target=lambda: answers.append(device.answer(b"\\3\\0\\0\\0\\2")))
    with mapping:  # it is one lock for all of it
        other.start()
        other.join(0.05)
        assert not answers
    other.join()
    assert answers == [b"\\3\\4\\0\\1\\0\\2"]

assert os.waitpid(in_child(check), 0)[1] == 0
assert not mapping.lock.acquire(blocking=False)
done.set()
thread.join()
assert device.answer(b"\\3\\0\\0\\0\\1") == b"\\3\\2\\0\\0"
print("good")
""")

    def test_a_lock_of_the_forking_thread_is_locked_in_both_processes(self) -> None:
        """As in a hook."""
        forked("""
from libmodbus_py.device import hooks
hooks.SLOW = 50  # a fork takes its time on a busy machine, which would be logged

def taken_by_another_thread():
    got = []
    thread = threading.Thread(target=lambda: got.append(mapping.lock.acquire(blocking=False)))
    thread.start()
    thread.join()
    return got == [True]

children = []

def hook(access):
    children.append(os.fork())
    assert not taken_by_another_thread()

hooked = Device(mapping, before_read=hook)
answer = hooked.answer(b"\\3\\0\\0\\0\\1")
status = 0 if answer == b"\\3\\2\\0\\0" and taken_by_another_thread() else 1
if not children[0]:
    os._exit(status)
assert status == 0
assert os.waitpid(children[0], 0)[1] == 0
print("good")
""")

    def test_children_and_parent_answer_at_once(self) -> None:
        forked("""
def use(address):
    for turn in range(200):
        request = bytes([6, 0, address, 0, turn])
        assert device.answer(request) == request
        assert device.answer(bytes([3, 0, address, 0, 1])) == bytes([3, 2, 0, turn])

children = [in_child(lambda: use(1)) for _ in range(3)]
use(0)
assert [os.waitpid(child, 0)[1] for child in children] == [0, 0, 0]
print("good")
""")
