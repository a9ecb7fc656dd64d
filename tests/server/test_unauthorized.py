"""
What a role may not do, over every transport: exception 1, counted, and nothing done.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from fuzz.checks import REQUEST_OBJECTS, examples
from libmodbus_py import Allow, Context, Device, Fault, IllegalFunction, Mapping, Rules, Server, pdu
from libmodbus_py.serve import Asked
from libmodbus_py.tools.testing.wires import SerialWire


def guarded(authorize: Any) -> Device:
    return Device(
        Mapping(65536, 65536, 65536, 65536),
        files={3: [0] * 100, 4: [0] * 100},
        fifos={0x04DE: [1]},
        canopen=lambda data: data,
        authorize=authorize,
    )


@pytest.fixture(params=["tcp", "udp", "rtu+tcp", "ascii+tcp", "rtu", "ascii"])
def line(request: pytest.FixtureRequest) -> Iterator[tuple[str, str]]:
    """The URLs of a server, and of its client."""
    scheme = request.param
    if "tcp" in scheme or scheme == "udp":
        yield f"{scheme}://127.0.0.1:0", ""
    else:
        with SerialWire() as wire:
            yield tuple(f"{scheme}://{end}?baudrate=115200" for end in (wire.server, wire.client))


def test_nothing_is_executed(line: tuple[str, str]) -> None:
    seen: list[Asked] = []

    def authorize(asked: Asked) -> bool:
        seen.append(asked)
        return False

    device = guarded(authorize)
    server = Server({17: device})
    with server.background(line[0]) as running, Context.from_url(line[1] or running.urls[0]) as at:
        plc = at.for_unit(17)
        for request in REQUEST_OBJECTS:
            with pytest.raises(IllegalFunction):
                plc.execute(request)
    assert [asked.function for asked in seen] == [each.function for each in REQUEST_OBJECTS]
    assert {(asked.unit, asked.role) for asked in seen} == {(17, None)}
    assert all(asked.peer for asked in seen)
    assert server.statistics.unauthorized == server.statistics.refused == len(seen)
    assert not any(device.mapping.holding_registers)
    assert not any(device.mapping.coils)


def frames(unit: int) -> list[bytes]:
    return [
        number.to_bytes(2, "big")
        + b"\0\0"
        + (1 + len(data)).to_bytes(2, "big")
        + bytes([unit])
        + data
        for number, data in enumerate(examples("pdu"))
        if data[0] < 0x80
    ]


@pytest.mark.parametrize("many", [1, 8])
def test_neither_alone_nor_in_a_chunk(many: int) -> None:
    """The server answers chunks, and what comes alone, in C where it can."""
    requests = frames(1)
    plain, closed = Device(Mapping(65536, 65536, 65536, 65536)), guarded(lambda asked: False)
    server = Server({1: closed, 2: plain})
    with server.background("tcp://127.0.0.1:0") as running, ExitStack() as stack:
        port = int(running.urls[0].rpartition(":")[2])
        connect = socket.create_connection
        peers = [stack.enter_context(connect(("127.0.0.1", port), 10)) for _ in range(3)]
        for at in range(0, len(requests), many):
            chunk = requests[at : at + many]
            for peer in peers:
                # Between requests to a device that C answers.
                other = b"\0\x99\0\0\0\6\2\3\0\0\0\1"
                peer.sendall(other + b"".join(chunk) + other)
            for peer in peers:
                expected = b"\0\x99\0\0\0\5\2\3\2\0\0"
                for request in chunk:
                    code = bytes([request[7] | 0x80, 1])
                    expected += request[:2] + b"\0\0\0\3\1" + code
                expected += b"\0\x99\0\0\0\5\2\3\2\0\0"
                answer = b""
                while len(answer) < len(expected):
                    part = peer.recv(4096)
                    assert part
                    answer += part
                assert answer == expected
    assert server.statistics.unauthorized == 3 * len(requests)
    assert not any(closed.mapping.holding_registers)


def test_one_rule_closes_the_rest() -> None:
    rules = Rules({None: Allow(read=["input_registers"]), "Engineer": Allow("all", "all", "all")})
    with (
        Server(guarded(rules)).background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0]) as plc,
    ):
        assert plc.read_input_registers(0, 1) == [0]
        for ask in (lambda: plc.read_coils(0, 1), lambda: plc.write_register(0, 1)):
            with pytest.raises(IllegalFunction):
                ask()


def test_broadcasts_are_counted_for_each_device() -> None:
    devices = {unit: guarded(lambda asked, at=unit: at == 2) for unit in (1, 2, 3)}
    server = Server(devices)
    with (
        SerialWire() as wire,
        server.background(f"rtu://{wire.server}?baudrate=115200"),
        Context.from_url(f"rtu://{wire.client}?baudrate=115200") as line,
    ):
        line.for_unit(0).write_register(0, 5)
        assert line.for_unit(2).read_holding_registers(0, 1) == [5]
    values = [device.mapping.holding_registers[0] for device in devices.values()]
    assert values == [0, 5, 0]
    assert server.statistics.unauthorized == 2


def test_a_client_cannot_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    with Server(guarded(Rules({}))).background("tcp://127.0.0.1:0") as running:
        for _ in range(5):
            with Context.from_url(running.urls[0]) as plc:
                for _ in range(20):
                    with pytest.raises(IllegalFunction):
                        plc.execute(pdu.ReadCoils(0, 1))
    (record,) = caplog.records
    assert record.message.startswith("127.0.0.1:")
    assert record.message.endswith(
        ", without a role, may not use function 1 of unit 1, read coils 0..0"
    )


def test_faults_refuse_without_asking() -> None:
    """A fault answers instead of the device: nothing is done, so nothing needs to be allowed."""
    seen: list[Asked] = []
    server = Server({1: guarded(seen.append)}, {1: [Fault("exception", code=6)]})
    with (
        server.background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0]) as plc,
        pytest.raises(Exception, match="exception 6"),
    ):
        plc.execute(pdu.WriteCoil(0, True))
    assert seen == []
