"""Contexts: what follows a failure, late answers, threads, signals, forks, descriptors."""

import contextlib
import errno
import gc
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    RtuContext,
    TcpContext,
)
from libmodbus_py.low_level import lib, loaded_version
from libmodbus_py.ports.endpoint import parse
from tests.support.cases import each_case
from tests.support.contexts import context_at
from tests.support.peers import OnRequest, TcpPeer, Write, answer, ignore, mute_port, peer_at, until
from tests.support.reads import on_read, on_read_at
from tests.support.signals import in_child, interrupt, on_alarm

each_transport = pytest.mark.parametrize("transport", ["tcp", "rtu"])

FORKS = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")


def late_sometimes(transport: str, seconds: float) -> OnRequest:
    """Answer each fortieth request late."""
    count = 0

    def on_request(request: bytes, write: Write) -> None:
        nonlocal count
        count += 1
        write(answer(request, transport), after=0 if count % 40 else seconds)

    return on_request


# On a line an answer may be late by less than one more timeout: the rest is for a busy machine.
@pytest.mark.parametrize(
    ("transport", "timeout", "seconds"),
    [
        *(("tcp", 0.2, late) for late in (0.198, 0.205, 0.4)),
        *(("rtu", 0.5, late) for late in (0.498, 0.505, 0.6)),
    ],
)
def test_no_late_answer_is_taken_for_the_next(transport, timeout, seconds) -> None:
    right = failures = 0
    with (
        peer_at(transport, late_sometimes(transport, seconds)) as peer,
        context_at(peer.url, timeout=timeout) as context,
    ):
        for address in range(60):
            try:
                assert context.read_holding_registers(address, 1) == [address]
                right += 1
            except ModbusError:
                failures += 1
    assert right >= 30
    assert right + failures == 60


def test_after_a_timeout_the_next_call_connects_again() -> None:
    with TcpPeer(ignore) as peer, context_at(peer.url, timeout=0.05) as context:
        with pytest.raises(ModbusTimeoutError, match=r"unit 17, function 3, ReadHold.*timed out"):
            context.read_holding_registers(1, 1)
        assert context.socket == -1
        peer.on_request = on_read
        context.response_timeout = 5.0
        assert context.read_holding_registers(2, 1) == [2]
        assert peer.connections == 2


def test_after_a_timeout_a_line_has_to_be_silent() -> None:
    def chatter(request: bytes, write: Write) -> None:
        write(b"\x55", after=0.6)

    with peer_at("rtu", chatter) as peer, context_at(peer.url, timeout=0.5) as context:
        with pytest.raises(ModbusTimeoutError):
            context.read_holding_registers(1, 1)
        peer.on_request = on_read_at("rtu")
        assert context.read_holding_registers(2, 1) == [2]
        # The byte came 0.6 s after the request, and then 0.5 s have to pass.
        assert peer.times[1] - peer.times[0] >= 1.08


def test_a_new_context_takes_no_late_answer_to_a_request_of_the_last_one() -> None:
    def late(request: bytes, write: Write) -> None:
        write(answer(request, "rtu"), after=0.6)

    with peer_at("rtu", late) as peer:
        with context_at(peer.url, timeout=0.5) as context, pytest.raises(ModbusTimeoutError):
            context.read_holding_registers(1, 1)
        peer.on_request = on_read_at("rtu")
        with context_at(peer.url, timeout=0.5) as context:
            assert context.read_holding_registers(2, 1) == [2]


def test_a_line_that_is_never_silent_is_an_error() -> None:
    def chatter(request: bytes, write: Write) -> None:
        for number in range(250):
            write(b"\x55", after=0.21 + 0.01 * number)

    with peer_at("rtu", chatter) as peer, context_at(peer.url, timeout=0.2) as context:
        with pytest.raises(ModbusError):  # a byte may come in time on a busy machine
            context.read_holding_registers(1, 1)
        with pytest.raises(ModbusTimeoutError, match="never silent"):
            context.read_holding_registers(1, 1)
        assert len(peer.requests) == 1


BAD_ANSWERS: dict[str, tuple[str, bytes, type[ModbusError]]] = {
    "a wrong CRC": ("rtu", bytes.fromhex("11 03 02 00 07 00 00"), FrameError),
    "another unit": ("rtu", bytes.fromhex("12 03 02 00 07 3c 45"), InvalidResponse),
    "another count": ("rtu", bytes.fromhex("11 03 04 00 07 00 07 1a 30"), ModbusError),
    "another number": ("tcp", bytes.fromhex("77 77 00 00 00 05 11 03 02 00 07"), InvalidResponse),
    "another function": ("tcp", bytes.fromhex("00 01 00 00 00 05 11 04 02 00 07"), InvalidResponse),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_ANSWERS)
def test_bad_answers_are_errors_and_the_next_answer_is_right(name: str) -> None:
    transport, data, kind = BAD_ANSWERS[name]
    with (
        peer_at(transport, lambda request, write: write(data)) as peer,
        context_at(peer.url, timeout=0.5) as context,
    ):
        with pytest.raises(kind) as caught:
            context.read_holding_registers(1, 1)
        assert (caught.value.unit, caught.value.function) == (17, 3)
        peer.on_request = on_read_at(transport)
        assert context.read_holding_registers(2, 1) == [2]


def test_a_connection_that_the_other_side_closes_is_made_again() -> None:
    with TcpPeer(on_read) as peer, context_at(peer.url) as context:
        for _ in range(2):
            assert context.read_holding_registers(1, 1) == [1]
            peer.drop_all()
            until(lambda: not peer._peers)
            with pytest.raises(ModbusConnectionError) as caught:
                context.read_holding_registers(1, 1)
            assert caught.value.errno in (errno.ECONNRESET, errno.EPIPE)
            assert context.socket == -1


def test_a_context_is_refused_where_nothing_listens() -> None:
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        context = TcpContext("127.0.0.1", place.getsockname()[1])
        for act in (context.connect, lambda: context.read_coils(0, 1)):
            with pytest.raises(ModbusConnectionError, match="cannot connect") as caught:
                act()
            assert caught.value.errno == errno.ECONNREFUSED


def test_a_host_that_does_not_answer_takes_one_timeout() -> None:
    with mute_port() as port:
        start = time.monotonic()
        with pytest.raises(ModbusConnectionError) as caught:
            TcpContext("127.0.0.1", port, timeout=0.1).connect()
        assert caught.value.errno == errno.ETIMEDOUT
        assert 0.09 < time.monotonic() - start < 5


def test_an_unknown_host_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(ModbusConnectionError, match="cannot resolve host 'plc'") as caught:
        TcpContext("plc").read_coils(0, 1)
    assert caught.value.errno == socket.EAI_NONAME


def test_a_path_that_is_no_serial_port_is_refused() -> None:
    for path, number in {
        "/dev/null": errno.ENOTTY,
        "/nonexistent": errno.ENOENT,
        "/": errno.EISDIR,
    }.items():
        with pytest.raises(ModbusConnectionError, match="cannot open") as caught:
            RtuContext(path).connect()
        assert caught.value.errno == number


def test_a_port_in_use_is_refused() -> None:
    with (
        peer_at("rtu", ignore) as peer,
        context_at(peer.url),
        pytest.raises(ModbusConnectionError, match="in use"),
    ):
        context_at(peer.url).connect()


def test_an_unplugged_adapter_is_an_error_until_it_is_plugged_in(tmp_path: Path) -> None:
    link = tmp_path / "port"
    with peer_at("rtu", on_read_at("rtu")) as peer:
        link.symlink_to(parse(peer.url).path)
        context = context_at(f"rtu://{link}", timeout=1.0)
        assert context.read_holding_registers(1, 1) == [1]
        link.unlink()  # first, as the number of a pseudo-terminal is given again at once
    for _ in range(2):
        with pytest.raises(ModbusConnectionError):
            context.read_holding_registers(1, 1)
        assert context.socket == -1
    context.close()


@each_transport
def test_a_closed_context_can_be_opened_again(transport: str) -> None:
    with peer_at(transport, on_read_at(transport)) as peer:
        context = context_at(peer.url)
        assert context.read_holding_registers(1, 1) == [1]
        context.close()
        context.close()
        with pytest.raises(ModbusConnectionError, match="closed") as caught:
            context.read_holding_registers(1, 1)
        assert caught.value.errno == errno.EBADF
        with context:
            assert context.read_holding_registers(2, 1) == [2]
        assert context.socket == -1


def test_a_collected_context_closes_its_connection() -> None:
    with TcpPeer(on_read) as peer:
        context = context_at(peer.url)
        context.connect()
        until(lambda: peer.connections == 1)
        del context
        gc.collect()
        until(lambda: not peer._peers)


@each_transport
def test_threads_wait_for_each_other(transport: str) -> None:
    with peer_at(transport, on_read_at(transport)) as peer, context_at(peer.url) as context:

        def ask(address: int) -> list[int]:
            return context.read_holding_registers(address, 1)

        with ThreadPoolExecutor(4) as pool:
            assert [*pool.map(ask, range(400))] == [[address] for address in range(400)]


def ask_in_thread(context: Any) -> tuple[threading.Thread, list[BaseException]]:
    errors: list[BaseException] = []

    def ask() -> None:
        try:
            context.read_holding_registers(1, 1)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    return thread, errors


def test_closing_ends_a_call_in_another_thread() -> None:
    with TcpPeer(ignore) as peer:
        context = context_at(peer.url, timeout=60.0)
        thread, errors = ask_in_thread(context)
        until(lambda: peer.requests)
        context.close()
        thread.join(30)
        assert not thread.is_alive()
        assert isinstance(errors[0], ModbusConnectionError)
        assert peer.connections == 1


def test_closing_ends_an_attempt_to_connect() -> None:
    with mute_port() as port:
        context = TcpContext("127.0.0.1", port, timeout=60.0)
        thread, errors = ask_in_thread(context)
        until(lambda: context._waker is not None)
        context.close()
        thread.join(30)
        assert isinstance(errors[0], ModbusConnectionError)


def test_closing_a_port_waits_for_a_call() -> None:
    with peer_at("rtu", ignore) as peer:
        context = context_at(peer.url, timeout=0.2)
        thread, errors = ask_in_thread(context)
        until(lambda: peer.requests)
        context.close()
        thread.join()
        assert isinstance(errors[0], ModbusTimeoutError)
        assert context.socket == -1


@each_transport
def test_ctrl_c_is_raised_when_the_call_ends_and_closes_the_context(transport: str) -> None:
    def late(request: bytes, write: Write) -> None:
        write(answer(request, transport), after=0.35)

    with peer_at(transport, late) as peer, context_at(peer.url, timeout=0.3) as context:
        start = time.monotonic()
        with pytest.raises(KeyboardInterrupt), on_alarm(interrupt, 0.1):
            context.read_holding_registers(1, 1)
        assert 0.28 < time.monotonic() - start < 5
        peer.on_request = on_read_at(transport)
        assert context.read_holding_registers(2, 1) == [2]


def test_a_signal_handler_cannot_ask_during_a_call_of_its_thread() -> None:
    errors: list[BaseException] = []

    def handler() -> None:
        try:
            context.read_holding_registers(9, 1)
        except RuntimeError as error:
            errors.append(error)

    with TcpPeer(on_read_at("tcp", after=0.2)) as peer, context_at(peer.url) as context:
        with on_alarm(handler, 0.1):
            assert context.read_holding_registers(3, 1) == [3]
        assert context.read_holding_registers(4, 1) == [4]
        assert len(peer.requests) == 2
    (error,) = errors
    assert "signal handler" in str(error)


@FORKS
@each_transport
def test_a_child_can_neither_use_a_context_nor_harm_its_parent(transport: str) -> None:
    with peer_at(transport, on_read_at(transport)) as peer, context_at(peer.url) as context:
        assert context.read_holding_registers(1, 1) == [1]
        before = termios.tcgetattr(context.socket) if transport == "rtu" else None

        def use() -> None:
            assert context.socket == -1
            for act in (lambda: context.read_coils(0, 1), context.connect, context.receive):
                with contextlib.suppress(RuntimeError):
                    act()
                    raise AssertionError
            context.close()

        assert in_child(use) == 0
        if before is not None:
            assert termios.tcgetattr(context.socket) == before
        assert context.read_holding_registers(2, 1) == [2]
        assert in_child(lambda: None) == 0
        assert context.read_holding_registers(3, 1) == [3]
        if transport == "tcp":
            assert peer.connections == 1


MANY = """
import os, resource, sys
from libmodbus_py import ModbusConnectionError
from libmodbus_py import RtuContext, TcpContext

resource.setrlimit(resource.RLIMIT_NOFILE, (2048, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
kind, place = sys.argv[1:]
context = TcpContext("127.0.0.1", int(place)) if kind == "tcp" else RtuContext(place, 115200)
before = context.read_holding_registers(7, 1) if kind == "tcp" else []
files = [os.open("/dev/null", os.O_RDONLY) for _ in range(1100)]
print(before, context.read_holding_registers(8, 1) if kind == "tcp" else [])
context.close()
for _ in range(4):
    files.append(os.open("/dev/null", os.O_RDONLY))
for act in (context.connect, lambda: context.read_coils(0, 1)):
    try:
        act()
    except ModbusConnectionError as error:
        print(error.errno, error)
for file in files:
    os.close(file)
context.connect()
print(context.read_holding_registers(9, 1))
"""


@each_transport
def test_descriptors_too_large_for_libmodbus_are_refused(transport: str) -> None:
    with peer_at(transport, on_read_at(transport)) as peer:
        place = peer.url.rpartition(":")[2] if transport == "tcp" else peer.path  # type: ignore[attr-defined]
        process = subprocess.run(
            [sys.executable, "-c", MANY, transport, place], capture_output=True, text=True
        )
    assert process.returncode == 0, process.stderr
    first, *refusals, last = process.stdout.splitlines()
    assert first == ("[7] [8]" if transport == "tcp" else "[] []")
    assert last == "[9]"
    assert len(refusals) == 2
    for line in refusals:
        assert line.startswith(f"{errno.EMFILE} ")
        assert "libmodbus takes those below 1024; Client takes all" in line


def test_a_line_is_opened_with_the_settings_of_its_arguments() -> None:
    with peer_at("rtu", ignore) as peer:
        path = peer.path  # type: ignore[attr-defined]
        with RtuContext(path, 2400, "N", 8, 2) as context:
            settings = termios.tcgetattr(context.socket)
            assert settings[4:6] == [termios.B2400, termios.B2400]
            assert settings[2] & termios.CSTOPB
        with RtuContext(path, 250_000, "N") as context:  # libmodbus would take 9600
            assert termios.tcgetattr(context.socket)[4] not in (termios.B9600, termios.B2400)


# Any, so that arguments of wrong types can be passed.
tcp: Any = TcpContext
rtu: Any = RtuContext

WRONG: dict[str, Callable[[Any], object]] = {
    "address must be in 0..65535, not 65536": lambda c: c.read_coils(65536, 1),
    "address must be in 0..65535, not -1": lambda c: c.read_holding_registers(-1, 1),
    "address + count must not pass 65536": lambda c: c.read_input_registers(65535, 2),
    "count must be in 1..2000, not 2001": lambda c: c.read_discrete_inputs(0, 2001),
    "count must be in 1..125, not 126": lambda c: c.read_holding_registers(0, 126),
    "count must be in 1..125, not 0": lambda c: c.read_holding_registers(0, 0),
    "count must be an integer in 1..125, not float": lambda c: c.read_holding_registers(0, 1.0),
    "count must be an integer in 1..125, not True": lambda c: c.read_holding_registers(0, True),
    "value must be an integer in 0..65535, not str": lambda c: c.write_register(0, "1"),
    "value must be in 0..65535, not 65536": lambda c: c.write_register(0, 65536),
    "value must be in 0..1, not 2": lambda c: c.write_coil(0, 2),
    "values must hold 1..123 values": lambda c: c.write_registers(0, [0] * 124),
    "values must hold 1..1968 values, not 0": lambda c: c.write_coils(0, []),
    "values[1] must be in 0..65535, not -1": lambda c: c.write_registers(0, [0, -1]),
    "and_mask must be in 0..65535": lambda c: c.mask_write_register(0, 65536, 0),
    "read_count must be in 1..125": lambda c: c.read_write_registers(0, 126, 0, [1]),
    "request must be a Request of pdu, not bytes": lambda c: c.execute(b"\x07"),
    "unit must be in 0..247 or 255, not 248": lambda c: setattr(c, "unit", 248),
    "unit must be in 0..255, not 256": lambda c: setattr(c, "unit", 256),
    "response_timeout must be in 1e-06..86400 seconds, not 0": lambda c: setattr(
        c, "response_timeout", 0
    ),
    "byte_timeout must be a number of seconds, not str": lambda c: setattr(c, "byte_timeout", ""),
    'error_recovery must be "none" or "protocol", not \'link\'': lambda c: setattr(
        c, "error_recovery", "link"
    ),
    "debug must be True or False, not 1": lambda c: setattr(c, "debug", 1),
    "host must be a string, not int": lambda _: tcp(1),
    "host must be a name or an address, not ''": lambda _: tcp(""),
    "port must be in 0..65535, not 65536": lambda _: tcp("a", 65536),
    "unit must be in 0..247, not 255": lambda _: rtu("/dev/ttyUSB0", unit=255),
    "parity must be": lambda _: rtu("/dev/ttyUSB0", 9600, "X"),
    "baudrate must be in 1..4000000, not 0": lambda _: rtu("/dev/ttyUSB0", 0),
    "data_bits must be in 5..8, not 9": lambda _: rtu("/dev/ttyUSB0", 9600, "N", 9),
    "stop_bits must be in 1..2, not 3": lambda _: rtu("/dev/ttyUSB0", 9600, "N", 8, 3),
    "timeout must be": lambda _: tcp("a", timeout="1"),
}  # fmt: skip
"""Message -> what raises it."""


def test_wrong_arguments_are_named_and_nothing_is_sent() -> None:
    with TcpPeer(on_read) as peer, context_at(peer.url) as context:
        assert isinstance(context, TcpContext)
        for message, act in WRONG.items():
            with pytest.raises((TypeError, ValueError)) as caught:
                act(context)
            assert message in str(caught.value)
        assert context.read_holding_registers(5, 1) == [5]
        assert len(peer.requests) == 1


def test_settings_are_those_of_libmodbus() -> None:
    context = TcpContext("127.0.0.1", timeout=0.9999999)
    assert context.response_timeout == 1.0
    assert (context.byte_timeout, context.indication_timeout) == (0.0, 0.0)
    context.response_timeout = 2.25
    context.byte_timeout, context.indication_timeout = 0.0000004, 3.5
    assert context.response_timeout == 2.25
    assert (context.byte_timeout, context.indication_timeout) == (0.000001, 3.5)
    context.unit = 255
    assert context.unit == 255
    context.error_recovery = "protocol"
    assert (context.error_recovery, context.debug) == ("protocol", False)
    assert (context.header_length, context.socket) == (7, -1)
    assert repr(context) == "<TcpContext tcp://127.0.0.1:502, unit 255>"
    assert RtuContext("/dev/ttyUSB0").header_length == 1


def test_quirks_are_enabled_where_the_library_has_them() -> None:
    context = TcpContext("127.0.0.1")
    if loaded_version() < (3, 1, 9):
        for act in (context.enable_quirks, context.disable_quirks):
            with pytest.raises(NotImplementedError, match=r"3\.1\.9"):
                act(lib.MODBUS_QUIRK_MAX_SLAVE)
        return
    context.enable_quirks(lib.MODBUS_QUIRK_MAX_SLAVE)
    context.unit = 250
    assert context.unit == 250
    context.disable_quirks(lib.MODBUS_QUIRK_MAX_SLAVE)
    with pytest.raises(ValueError, match="unit"):
        context.unit = 251


def test_a_process_without_descriptors_gets_emfile() -> None:
    source = """
import resource
from libmodbus_py import ModbusConnectionError
from libmodbus_py import TcpContext

context = TcpContext("127.0.0.1", 1)
resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))
try:
    context.read_coils(0, 1)
except ModbusConnectionError as error:
    print(error.errno)
"""
    process = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True)
    assert process.stdout == f"{errno.EMFILE}\n", process.stderr


def test_hosts_are_given_by_name_or_address() -> None:
    for host in ("m\xfchle.example", "plc_1", "::1", "127.0.0.1"):
        assert TcpContext(host).host == host
    for host in ("m\xfchle" * 30, "a" * 2000):
        with pytest.raises(ValueError, match="host must be a name"):
            TcpContext(host)


def test_a_broadcast_waits_for_no_answer_and_reads_are_refused() -> None:
    with peer_at("rtu", ignore) as peer, context_at(peer.url, unit=0) as context:
        for write in (lambda: context.write_register(1, 2), lambda: context.write_coils(0, [True])):
            start = time.monotonic()
            write()
            assert 0.09 < time.monotonic() - start < 2
        for ask in (lambda: context.read_coils(0, 1), context.read_exception_status):
            with pytest.raises(ValueError, match="broadcast"):
                ask()
        until(lambda: len(peer.requests) == 2)
        assert peer.requests[0].hex() == "000600010002581a"


@pytest.mark.parametrize("failing", [True, False])
@each_case(
    "ask",
    [
        lambda line: line.read_holding_registers(7, 1),
        lambda line: line.write_register(7, 1),
        lambda line: line.diagnostics(0, 5),
    ],
)
def test_what_custom_rts_raises_is_the_cause_of_the_error_of_the_call(failing, ask) -> None:
    calls: list[bool] = []

    def turn(is_sending: bool) -> None:
        calls.append(is_sending)
        if is_sending is failing and calls == [True, False][: len(calls)]:
            raise LookupError("no line 17")

    with peer_at("rtu", on_read_at("rtu")) as peer, context_at(peer.url, timeout=0.5) as context:
        assert isinstance(context, RtuContext)
        context.set_custom_rts(turn)
        calls.append(False)  # nothing fails yet
        context.rts = "up"
        calls.clear()
        with pytest.raises(ModbusConnectionError, match=r"LookupError\('no line 17'\)") as caught:
            ask(context)
        assert isinstance(caught.value.__cause__, LookupError)
        assert calls == [True, False]  # the line receives again
        assert context.read_holding_registers(7, 1) == [7]
        assert calls == [True, False] * 2


def test_custom_rts_is_called_before_and_after_a_frame() -> None:
    calls: list[bool] = []
    with peer_at("rtu", on_read_at("rtu")) as peer, context_at(peer.url) as context:
        assert isinstance(context, RtuContext)
        assert (context.serial_mode, context.rts) == ("rs232", "none")
        context.set_custom_rts(calls.append)
        context.rts = "up"
        context.rts_delay = 0.001
        assert (context.rts, context.rts_delay) == ("up", 0.001)
        calls.clear()
        assert context.read_holding_registers(7, 1) == [7]
        assert calls == [True, False]
        with pytest.raises(ModbusConnectionError) as caught:
            context.serial_mode = "rs485"  # a pseudo-terminal has no such mode
        assert caught.value.errno == errno.ENOTTY
        for name in ("rts", "serial_mode"):
            with pytest.raises(ValueError, match=name):
                setattr(context, name, "x")
