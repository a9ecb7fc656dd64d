"""Hooks and handlers that do what they should not: raise what is not an Exception, take long."""

import asyncio
import logging
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import Access, Device, Hook, Mapping, Server, pdu
from libmodbus_py.device import hooks as hooks_module
from libmodbus_py.protocol import errors
from tests.support.attacks import adu, receive
from tests.support.cases import each_case
from tests.support.golden import Refused

READ, WRITE = b"\3\0\0\0\1", b"\6\0\0\0\7"

# What no answer can carry as the code of an exception.
NO_CODES: tuple[Any, ...] = ("2", 2.0, 0, -1, 256, 1000)

# The hook or handler -> a request that calls it.
KINDS: dict[str, bytes] = {
    "before_read": READ,
    "before_write": WRITE,
    "after_write": WRITE,
    "canopen": b"\x2b\x0d\0",
    "handlers": b"\1\0\0\0\1",
}


def made_device(kind: str, call: Callable[[Any], Any]) -> Device:
    hook = {pdu.ReadCoils: call} if kind == "handlers" else call
    return Device(Mapping(coils=1, holding_registers=1), **{kind: hook})


def raising(make: Callable[[], BaseException]) -> Callable[[Any], Any]:
    """Return a new exception: the traceback of a shared one would keep objects in memory."""

    def fail(_: Any) -> None:
        raise make()

    return fail


def is_free(device: Device) -> bool:
    """Return True if another thread gets the lock of the mapping."""
    results: list[bool] = []
    thread = threading.Thread(target=lambda: results.append(device.mapping.lock.acquire(timeout=5)))
    thread.start()
    thread.join()
    return results == [True]


class Unusual(BaseException):
    """As some frameworks end a task with."""


@each_case("kind", KINDS)
@each_case(
    "make",
    [
        asyncio.CancelledError,
        GeneratorExit,
        Unusual,
        lambda: BaseExceptionGroup("several", [KeyboardInterrupt()]),
        lambda: ZeroDivisionError("a bug of the application"),
        *[lambda code=code: errors.ExceptionResponse(code=code) for code in NO_CODES],
    ],
)
def test_errors_of_hooks_and_handlers_are_answered_4_and_logged_once(kind, make, caplog) -> None:
    caplog.clear()
    device = made_device(kind, raising(make))
    request = KINDS[kind]
    for _ in range(3):
        assert device.answer(request) == bytes([request[0] | 0x80, 4])
    (record,) = caplog.records
    assert record.levelno == logging.ERROR
    assert record.exc_info
    assert record.exc_info[0] is type(make())
    assert is_free(device)


@each_case("kind", KINDS)
@each_case("error", [SystemExit, KeyboardInterrupt])
def test_errors_that_end_a_process_pass_through_hooks(kind, error, caplog) -> None:
    caplog.clear()
    device = made_device(kind, raising(error))
    with pytest.raises(error):
        device.answer(KINDS[kind])
    assert caplog.records == []
    assert is_free(device)


@pytest.mark.parametrize("result", ["text", [1, 2], None, 5])
def test_a_handler_whose_class_encodes_no_bytes_is_a_failure(result, caplog, monkeypatch) -> None:
    monkeypatch.setattr(pdu.ReadCoils, "encode_response", lambda self, result: result)
    device = made_device("handlers", lambda request: result)
    assert device.answer(KINDS["handlers"]) == b"\x81\4"
    assert len(caplog.records) == 1


@pytest.mark.parametrize("error", [asyncio.CancelledError, GeneratorExit, Unusual])
def test_a_failing_hook_costs_no_other_request(error, caplog) -> None:
    """Neither another request of this client nor those of others, alone or read together."""
    server = Server(made_device("before_write", raising(error)))
    ok, failure = b"\3\2\0\0", b"\x86\4"
    requests = [READ, WRITE, READ]
    answers = b"".join(adu(body, at) for at, body in enumerate([ok, failure, ok]))
    with server.background("tcp://127.0.0.1:0") as running:
        port = int(running.urls[0].rpartition(":")[2])
        peers = [socket.create_connection(("127.0.0.1", port), timeout=20) for _ in range(8)]
        for turn in range(20):
            for peer in peers:
                peer.sendall(adu(requests[turn % 3], turn))
            for peer in peers:
                response = adu([ok, failure, ok][turn % 3], turn)
                assert receive(peer, len(response)) == response
        peers[0].sendall(b"".join(adu(body, at) for at, body in enumerate(requests)))
        assert receive(peers[0], len(answers)) == answers
        for peer in peers:
            peer.close()
    assert len(caplog.records) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_slow_hook_is_logged_once_for_each_device(kind, caplog, monkeypatch) -> None:
    monkeypatch.setattr(hooks_module, "SLOW", 0.01)

    def dawdle(argument: Any) -> Any:
        time.sleep(0.02)
        return b"" if kind == "canopen" else [False]

    for _ in range(2):
        device = made_device(kind, dawdle)
        for _ in range(3):
            assert device.answer(KINDS[kind])[0] == KINDS[kind][0]
    assert [record.levelno for record in caplog.records] == [logging.WARNING] * 2
    message = caplog.records[0].getMessage()
    assert ("ReadCoils" if kind == "handlers" else kind) in message
    assert "dawdle" in message
    assert "clients" in message
    assert any(0.02 <= float(word) < 60 for word in message.split() if word[0].isdigit())


def test_wrong_arguments_of_hooks_are_refused_by_name(refused: Refused) -> None:
    refused("wrong_hooks.txt", lambda places: Hook(**{"call": print, **places}))
    with pytest.raises(TypeError, match="call must be a function"):
        Hook(Hook(print))  # type: ignore[arg-type]


@each_case("name", ["before_write", "after_write", "before_read"])
def test_hooks_of_devices_are_functions_or_hooks(name: str) -> None:
    with pytest.raises(TypeError, match=f"{name} must be a function or a Hook, not 5"):
        Device(Mapping(), **{name: 5})  # type: ignore[arg-type]


def test_ranges_may_overlap_and_touch_in_any_order() -> None:
    hook = Hook(print, coils=[range(9, 12), range(0), range(3), range(2, 5), range(12, 13)])
    assert hook.places == {"coils": (range(5), range(9, 13))}


def test_a_slow_hook_with_places_is_logged_even_if_it_fails(caplog, monkeypatch) -> None:
    monkeypatch.setattr(hooks_module, "SLOW", 0)
    hook = Hook(raising(errors.IllegalDataAddress), holding_registers=range(1))
    device = Device(Mapping(holding_registers=2), before_read=hook)
    assert device.answer(b"\3\0\1\0\1") == b"\3\2\0\0"
    assert caplog.records == []
    assert device.answer(READ) == b"\x83\2"
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_a_hook_gets_the_whole_range_of_a_read() -> None:
    """Not only the range of the hook: the hook can refresh, or refuse, the whole."""
    accesses: list[Access] = []
    hook = Hook(accesses.append, holding_registers=range(5, 6))
    device = Device(Mapping(holding_registers=20), before_read=hook)
    device.answer(b"\3\0\0\0\x14")
    device.answer(b"\3\0\6\0\4")
    assert [(access.address, access.count) for access in accesses] == [(0, 20)]


def test_refresh_calls_before_read_of_the_hook() -> None:
    mapping = Mapping(holding_registers=8, input_registers=8)
    accesses: list[Access] = []

    def compute(access: Access) -> None:
        accesses.append(access)
        mapping.input_registers[access.address] = 7

    device = Device(mapping, before_read=Hook(compute, input_registers=range(4)))
    device.refresh("input_registers", 2, 3)
    device.refresh("holding_registers", 2, 3)
    device.refresh("input_registers", 4, 3)
    assert mapping.input_registers[:] == [0, 0, 7, 0, 0, 0, 0, 0]
    assert accesses == [Access("input_registers", 2, 3)]
    Device(mapping).refresh("coils", 0, 1)


def test_a_hook_may_ask_its_own_device() -> None:
    """In the middle of a request that libmodbus answers, and of a chunk of them."""
    answers: list[object] = []

    def ask(access: Access) -> None:
        if access.address == 5:
            answers.append(device.answer(b"\3\0\1\0\1"))
            frame = bytes.fromhex("0001 0000 0006 01 03 0002 0001")
            answers.append(device.answer_chunk(frame, 0, 1)[1][7:])

    hook = Hook(ask, holding_registers=range(5, 6))
    mapping = Mapping(holding_registers={0: range(10)})
    device = Device(mapping, before_read=hook, before_write=hook, after_write=hook)
    assert device.answer(b"\3\0\5\0\1") == b"\3\2\0\5"
    assert device.answer(b"\x17\0\5\0\1\0\5\0\1\2\0\7") == b"\x17\2\0\7"
    assert answers == [b"\3\2\0\1", b"\3\2\0\2"] * 4


def test_a_hook_with_endless_recursion_leaves_the_mapping_unlocked() -> None:
    device = Device(Mapping(holding_registers=1), before_read=lambda access: device.answer(READ))
    assert device.answer(READ) in (b"\x83\4", b"\3\2\0\0")
    assert is_free(device)
