"""A capture replayed as a device, and as a master: what pymodbus and a device said at a tap."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import (
    Client,
    Device,
    IllegalDataAddress,
    Mapping,
    Server,
    ServerDeviceFailure,
    pdu,
)
from libmodbus_py.listen import listen
from libmodbus_py.tools.listener.replay import differences, replayed_devices
from tests.tools.listener.test_network_captures import ANSWERED, ASKED, TWO, packet, pcap


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A poll of two requests, one of them three times, with two values; a refusal; no answer."""
    third = ANSWERED[:-2] + b"\0\x65"
    packets = [
        *TWO,
        *(packet(ASKED, 124, asks=True), packet(third, 927, asks=False)),
        *(packet(ASKED, 136, asks=True), packet(third, 942, asks=False)),
        packet(bytes.fromhex("0003 0000 0006 01 03 1000 0001"), 148, asks=True),
        packet(bytes.fromhex("0003 0000 0003 01 83 02"), 957, asks=False),
        packet(bytes.fromhex("0004 0000 0006 02 06 0001 0003"), 160, asks=True),
        packet(bytes.fromhex("0004 0000 0006 02 06 0001 0003"), 966, asks=False),
        packet(bytes.fromhex("0005 0000 0006 02 04 0000 0001"), 172, asks=True),
    ]
    path = tmp_path / "plant.pcap"
    path.write_bytes(pcap(packets))
    return path


@pytest.fixture
def replayed(capture: Path) -> Iterator[Client]:
    with (
        Server(replayed_devices(capture)).background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1) as client,
    ):
        yield client


def test_each_request_gets_its_answers_in_order_and_then_the_last_again(replayed: Client) -> None:
    answers = [replayed.read_holding_registers(107, 3) for _ in range(4)]
    assert answers == [[555, 0, 100], [555, 0, 101], [555, 0, 101], [555, 0, 101]]
    assert replayed.read_coils(19, 19)[:2] == [True, False]
    for _ in range(2):
        with pytest.raises(IllegalDataAddress):
            replayed.read_holding_registers(4096, 1)
    replayed.for_unit(2).write_register(1, 3)


def test_a_request_that_is_not_in_the_capture_gets_exception_4_and_is_logged(
    replayed: Client, caplog: pytest.LogCaptureFixture
) -> None:
    for address in (107, 108):
        with pytest.raises(ServerDeviceFailure):
            replayed.read_holding_registers(address, 2)
    text = "unit 1: request 03 00 6b 00 02 is not in the capture; this is logged once"
    assert caplog.messages == [text]


def test_a_request_without_a_response_in_the_capture_gets_none(capture: Path) -> None:
    device = replayed_devices(capture)[2]
    assert device.answer(pdu.ReadInputRegisters(0, 1).encode()) == b""


def test_a_capture_without_requests_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.pcap").write_bytes(pcap([]))
    with pytest.raises(ValueError, match=r"x.pcap: no request of Modbus is in this capture"):
        replayed_devices(tmp_path / "x.pcap")


def test_a_replay_gives_the_same_answers_to_its_requests(capture: Path, replayed: Client) -> None:
    rows = list(differences(replayed, capture, units=None, writes=True))
    assert rows == [None] * 6


def test_differences_are_named_and_nothing_is_written_unless_wanted(capture: Path) -> None:
    tables = Mapping(holding_registers=4097, coils=100)
    tables.holding_registers[107:110] = [555, 0, 101]
    devices = {1: Device(tables), 2: Device(Mapping(holding_registers=2))}
    with (
        Server(devices).background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], timeout=5) as client,
    ):
        rows = list(differences(client, capture, units=None, writes=False))
        assert [row and row.answer for row in rows[:4:2]] == [[555, 0, 101], None]
        assert [row is None for row in rows] == [False, False, True, True, False]
        assert rows[4] is not None
        assert (rows[4].transaction.request, rows[4].answer) == (
            *(pdu.ReadHoldingRegisters(4096, 1), [0]),
        )
        assert devices[2].mapping.holding_registers[1] == 0
        assert list(differences(client, capture, units=[2], writes=True)) == [None]
        assert devices[2].mapping.holding_registers[1] == 3


def test_requests_of_pymodbus_at_a_tap_are_replayed(tmp_path: Path) -> None:
    pymodbus = pytest.importorskip("pymodbus.client")
    framer = pytest.importorskip("pymodbus.framer").FramerType.RTU
    path = tmp_path / "tap.pcapng"

    async def ask(port: int) -> list[int]:
        client = pymodbus.AsyncModbusTcpClient("127.0.0.1", port=port, framer=framer)
        await client.connect()
        response = await client.read_holding_registers(4, count=3)
        client.close()
        return list(response.registers)

    device = Device(Mapping(holding_registers={4: [7, 8, 9]}))
    with (
        Server({1: device}).background("rtu+tcp://127.0.0.1:0") as running,
        listen("rtu+tcp://127.0.0.1:0", between=running.urls[0], capture=path) as tap,
    ):
        values = asyncio.run(ask(int(tap.url.rpartition(":")[2])))
        next(tap)
    with (
        Server(replayed_devices(path)).background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0]) as client,
    ):
        assert client.read_holding_registers(4, 3) == values == [7, 8, 9]
