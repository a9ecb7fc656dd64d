"""Slaves by hand: what they answer to libmodbus, mbpoll and pymodbus, and what they refuse."""

import contextlib
import itertools
import os
import select
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    FrameError,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    RtuContext,
    ServerDeviceBusy,
    TcpContext,
    framing,
    pdu,
)
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.contexts import AnyContext, Serve, context_at, slave_by_hand
from tests.support.driver import rtu
from tests.support.interop import BAUDRATE, UNIT, cells, check_all, holding_register, make_device
from tests.support.peers import peer_at, until
from tests.support.pymodbus_peers import pymodbus_client

each_transport = pytest.mark.parametrize("transport", ["tcp", "rtu"])


@contextlib.contextmanager
def slave_at(transport: str, answer: Serve | Mapping) -> Iterator[str]:
    """Run a slave by hand, and yield the URL of a master."""
    if transport == "tcp":
        with slave_by_hand(TcpContext("127.0.0.1", 0), answer) as url:
            yield url
        return
    with SerialWire() as wire:
        slave = RtuContext(wire.server, BAUDRATE, unit=UNIT)
        with slave_by_hand(slave, answer):
            yield f"rtu://{wire.client}?baudrate={BAUDRATE}"


def test_a_slave_on_a_line_finds_requests_between_noise() -> None:
    noises = [b"", b"\0", b"\2\3\x10", b"\xf8\0\x7e\x80"]
    mapping = Mapping(holding_registers=10)
    request, answer = rtu(f"{UNIT:02X} 10 0000 0001 02 0007"), rtu(f"{UNIT:02X} 10 0000 0001")
    with (
        SerialWire() as wire,
        slave_by_hand(RtuContext(wire.server, BAUDRATE, "N", unit=UNIT), mapping),
        RtuContext(wire.client, BAUDRATE, "N", unit=UNIT) as master,
    ):
        for behind, before in itertools.product(noises, noises):
            os.write(master.socket, before + request + behind)
            data = b""
            while len(data) < len(answer):
                assert select.select([master.socket], [], [], 5.0)[0], (before, behind)
                data += os.read(master.socket, 100)
            assert data == answer
    assert mapping.holding_registers[0] == 7


@each_transport
def test_all_calls_of_a_context_succeed_at_a_slave_by_hand(transport: str) -> None:
    with slave_at(transport, make_device().mapping) as url, context_at(url) as context:
        check_all(context)  # type: ignore[arg-type]


@each_transport
def test_all_calls_of_libmodbus_succeed_at_a_slave_by_hand(
    compiled: Callable[[str], Path], transport: str
) -> None:
    mapping = make_device().mapping
    with slave_at(transport, mapping) as url:
        where = [url[6:].partition("?")[0], BAUDRATE] if transport == "rtu" else [url[16:]]
        command = [compiled("client"), transport, *where, UNIT]
        process = subprocess.run(
            [str(word) for word in command], capture_output=True, text=True, timeout=60
        )
    lines = process.stdout.splitlines()
    assert len(lines) == 21
    # modbus_reply has an identifier of its own.
    (line,) = (line for line in lines if not line.endswith((" ok", " refused")))
    assert line.startswith("FC 17 failed")
    assert mapping.holding_registers[100:223] == [3 * address for address in range(100, 223)]


@each_transport
@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="apt install mbpoll")
def test_mbpoll_reads_from_a_slave_by_hand(transport: str) -> None:
    with slave_at(transport, make_device().mapping) as url:
        line = ["-m", "tcp", "-p", url[16:], "127.0.0.1"]
        if transport == "rtu":
            path = url[6:].partition("?")[0]
            line = ["-m", "rtu", "-b", str(BAUDRATE), "-P", "even", path]
        options = ["-a", str(UNIT), "-0", "-1", "-o", "5", "-t", "4", "-r", "100", "-c", "3"]
        process = subprocess.run(
            ["mbpoll", *options, *line], capture_output=True, text=True, timeout=20
        )
    for line_ in ("[100]: \t1100", "[101]: \t1101", "[102]: \t1102"):
        assert line_ in process.stdout


@each_transport
def test_pymodbus_reads_and_writes_at_a_slave_by_hand(transport: str) -> None:
    mapping = make_device().mapping
    with slave_at(transport, mapping) as url, pymodbus_client(url) as client:
        response = client.read_holding_registers(100, count=125, device_id=UNIT)
        assert response.registers == cells(holding_register, 100, 125)
        client.write_registers(100, [5, 6], device_id=UNIT)
        assert mapping.holding_registers[100:103] == [5, 6, 1102]
        assert client.read_coils(5000, count=1, device_id=UNIT).exception_code == 2
        assert client.read_fifo_queue(address=100, device_id=UNIT).exception_code == 1


HOLES = Mapping(coils=10, holding_registers=[range(5), range(10, 15)], input_registers=10)

REFUSALS: dict[str, tuple[str, type[Exception]]] = {
    "a hole": ("03 0004 0002", IllegalDataAddress),
    "a write to a hole": ("10 0004 0002 04 00010002", IllegalDataAddress),
    "a mask in a hole": ("16 0005 0000 0000", IllegalDataAddress),
    "no such table": ("02 0000 0001", IllegalDataAddress),
    "quantity 0": ("03 0000 0000", IllegalDataValue),
    "quantity 126": ("04 0000 007e", IllegalDataValue),
    "2001 coils": ("01 0000 07d1", IllegalDataValue),
    "a short read": ("03 0000", IllegalDataValue),
    "a long write of one": ("06 0000 0001 00", IllegalDataValue),
    "fewer bytes than registers": ("10 0000 0002 04 0001", IllegalDataValue),
    "a byte count that does not fit": ("0f 0000 0001 02 01 00", IllegalDataValue),
    "a coil of 0001": ("05 0000 0001", IllegalDataValue),
    "a short mask": ("16 0000 0000", IllegalDataValue),
    "function 7": ("07", IllegalFunction),
    "function 20": ("14 07 06 0004 0001 0002", IllegalFunction),
    "function 43": ("2b 0e 01 00", IllegalFunction),
    "function 65": ("41 01 02", IllegalFunction),
}


def test_a_slave_refuses_requests_of_impossible_lengths() -> None:
    """On TCP, whose header has the length; requests come together, and none is lost."""
    cases = {name: (bytes.fromhex(data), kind) for name, (data, kind) in REFUSALS.items()}
    with (
        slave_at("tcp", HOLES) as url,
        socket.create_connection(("127.0.0.1", int(url[16:]))) as master,
    ):
        good = bytes.fromhex("03 0000 0001")
        for number, (data, _) in enumerate(cases.values()):
            master.sendall(framing.TcpFramer().encode(framing.Frame(9, data, number)))
            master.sendall(framing.TcpFramer().encode(framing.Frame(9, good, 1000 + number)))
        framer, frames = framing.TcpFramer(), list[framing.Frame]()
        while len(frames) < 2 * len(cases):
            frames += framer.feed(master.recv(4096))
    refusals = [frame for frame in frames if frame.transaction < 1000]
    for frame, (data, kind) in zip(refusals, cases.values(), strict=True):
        assert frame.pdu == bytes([data[0] | 0x80, kind.code]), data.hex()  # type: ignore[attr-defined]
    assert HOLES.holding_registers[:5] == [0] * 5


def test_a_slave_ignores_response_codes() -> None:
    with (
        slave_at("tcp", HOLES) as url,
        socket.create_connection(("127.0.0.1", int(url[16:]))) as master,
    ):
        for transaction, data in enumerate((b"\x83\x02", b"\x03\0\0\0\1")):
            master.sendall(framing.TcpFramer().encode(framing.Frame(9, data, transaction)))
        (frame,) = framing.TcpFramer().feed(master.recv(4096))
    assert frame.transaction == 1


def test_a_slave_chooses_its_answers() -> None:
    def answer(slave: AnyContext, request: bytes) -> None:
        assert request[6] == 17
        slave.reply_exception(request, ServerDeviceBusy.code)

    with slave_at("tcp", answer) as url, context_at(url) as master:
        for _ in range(2):
            with pytest.raises(ServerDeviceBusy):
                master.read_coils(0, 1)


def test_a_slave_on_a_line_ignores_frames_of_others_and_answers_its_own() -> None:
    mapping = Mapping(holding_registers=10)
    requests: list[bytes | None] = []
    with peer_at("rtu", lambda request, write: None) as line:
        slave = context_at(line.url)
        slave.connect()

        def run() -> None:
            while len(requests) < 5:
                with contextlib.suppress(FrameError):
                    request = slave.receive()
                    requests.append(request)
                    if request:
                        slave.reply(request, mapping)

        thread = threading.Thread(target=run)
        thread.start()
        ours = rtu("11 06 0001 0007")
        for frame in (
            rtu("12 03 0000 0001"),  # to another unit, which does not answer
            ours,
            rtu("12 03 0000 0001"),
            rtu("00 06 0002 0009"),  # a broadcast
            ours,
        ):
            before = len(requests)
            line.write(frame)  # type: ignore[attr-defined]
            until(lambda: len(requests) > before)  # noqa: B023
        thread.join()
        slave.close()
        until(lambda: b"".join(line.requests) == 2 * ours)
    assert requests == [None, ours, None, rtu("00 06 0002 0009"), ours]
    assert mapping.holding_registers[:4] == [0, 7, 9, 0]


def test_a_slave_times_out_and_sees_the_end_of_its_master() -> None:
    slave = TcpContext("127.0.0.1", 0)
    with pytest.raises(ModbusConnectionError, match=r"listen\(\) comes first"):
        slave.accept()
    slave.listen(backlog=2)
    with pytest.raises(ModbusConnectionError, match=r"accept\(\) comes first"):
        slave.receive()
    master = TcpContext("127.0.0.1", slave.port)
    master.connect()
    assert slave.accept().startswith("127.0.0.1:")
    slave.indication_timeout = 0.02
    with pytest.raises(ModbusTimeoutError):
        slave.receive()
    assert slave.socket >= 0
    master.close()
    with pytest.raises(ModbusConnectionError, match="closed by the other side"):
        slave.receive()
    assert slave.socket == -1
    slave.close()


def test_an_invalid_header_ends_the_connection() -> None:
    slave = TcpContext("127.0.0.1", 0)
    slave.listen()
    with socket.create_connection(("127.0.0.1", slave.port)) as master:
        slave.accept()
        master.sendall(bytes.fromhex("0001 0000 ffff 01 03"))
        with pytest.raises(FrameError, match="header with length 65535"):
            slave.receive()
        assert slave.socket == -1
    slave.close()


@each_transport
def test_closing_ends_the_wait_of_a_slave(transport: str) -> None:
    with slave_at(transport, Mapping()):
        pass


def test_two_slaves_cannot_listen_on_one_port() -> None:
    slave = TcpContext("127.0.0.1", 0)
    slave.listen()
    with pytest.raises(ModbusConnectionError, match=r"cannot listen on 127\.0\.0\.1:"):
        TcpContext("127.0.0.1", slave.port).listen()
    slave.close()


def test_replies_take_complete_frames_only() -> None:
    slave = TcpContext("127.0.0.1", 0)
    request = framing.TcpFramer().encode(framing.Frame(1, pdu.ReadCoils(0, 1).encode()))
    wrong: dict[str, tuple[Any, Any]] = {
        "request must be bytes, not list": ([1], HOLES),
        "request must be a whole frame": (request[:-1], HOLES),
        "mapping must be a Mapping, not dict": (request, {}),
    }
    for message, arguments in wrong.items():
        with pytest.raises((TypeError, ValueError), match=message):
            slave.reply(*arguments)
    with pytest.raises(ValueError, match=r"code must be in 1\.\.11, not 12"):
        slave.reply_exception(request, 12)
    with pytest.raises(ValueError, match="request must be a whole frame"):
        RtuContext("/dev/ttyUSB0").reply(request, HOLES)
