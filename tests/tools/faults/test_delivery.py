"""The bytes of each fault, when they are sent, and the order of answers around them."""

from pathlib import Path

import pytest

from libmodbus_py import Client, ModbusConnectionError, Server
from libmodbus_py.protocol.framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer
from libmodbus_py.server.faults import Faults
from libmodbus_py.tools.faults.fault import Fault
from tests.simulation.lan import Lan, LanClient
from tests.support.certificates import Pki, secured
from tests.tools.faults.serving import FOREVER, READ, REQUEST, adu, client_of, make_device, serving

# Address 107 holds 555, 0, 100: section 6.3 of the application protocol; the frames around
# it by hand.
ANSWER = Frame(17, bytes.fromhex("03 06 022B 0000 0064"), 0x1501)
TCP = bytes.fromhex("1501 0000 0009 11 03 06 022B 0000 0064")
RTU = bytes.fromhex("11 03 06 022B 0000 0064")
ASCII = b":1103060"

TCP_FRAMER, RTU_FRAMER, ASCII_FRAMER = TcpFramer(), RtuFramer("client"), AsciiFramer()
WHOLE = TCP.hex()
TRICKLED = [(2 if at else 0, f"{byte:02x}") for at, byte in enumerate(TCP)]

# Fault, framer, and what is sent: hexadecimal bytes, each after some seconds.
BYTES: list[tuple[Fault, Framer, list[tuple[float, str]]]] = [
    (Fault("delay", seconds=2), TCP_FRAMER, [(2, WHOLE)]),
    (Fault("no_answer"), TCP_FRAMER, []),
    (Fault("exception", code=6), TCP_FRAMER, [(0, WHOLE)]),
    (Fault("wrong_check"), TCP_FRAMER, [(0, "150100000000" + WHOLE[12:])]),
    (Fault("wrong_transaction"), TCP_FRAMER, [(0, "1500" + WHOLE[4:])]),
    (Fault("wrong_unit"), TCP_FRAMER, [(0, "15010000000912" + WHOLE[14:])]),
    (Fault("truncate", length=1), TCP_FRAMER, [(0, "15")]),
    (Fault("truncate", length=512), TCP_FRAMER, [(0, WHOLE[:-2])]),
    (Fault("trickle", seconds=2), TCP_FRAMER, TRICKLED),
    # CRC C8BA by the algorithm of appendix B; its complement.
    (Fault("wrong_check"), RTU_FRAMER, [(0, RTU.hex() + "3745")]),
    # LRC: 100h - (11 + 03 + 06 + 02 + 2B + 64) = 55h; its complement is AAh.
    (Fault("wrong_check"), ASCII_FRAMER, [(0, b":110306022B00000064AA\r\n".hex())]),
    (Fault("truncate", length=8), ASCII_FRAMER, [(0, ASCII.hex())]),
    (Fault("disconnect"), TCP_FRAMER, [(0, "")]),
    (Fault("disconnect", length=0), TCP_FRAMER, [(0, "")]),
    (Fault("disconnect", length=8), ASCII_FRAMER, [(0, ASCII.hex())]),
    (Fault("disconnect", length=512), TCP_FRAMER, [(0, WHOLE)]),
    (Fault("garbage", data=b"\xff\0"), TCP_FRAMER, [(0, "ff00" + WHOLE)]),
    (Fault("garbage", data=b"\xff", place="before"), TCP_FRAMER, [(0, "ff" + WHOLE)]),
    (Fault("garbage", data=b"\xff\0", place="instead"), TCP_FRAMER, [(0, "ff00")]),
    (Fault("garbage", data=b"\xff\0", place="behind"), TCP_FRAMER, [(0, WHOLE + "ff00")]),
]  # fmt: skip


@pytest.mark.parametrize(("fault", "framer", "fragments"), BYTES)
def test_each_fault_sends_its_bytes_in_its_intervals(fault, framer, fragments) -> None:
    writes = [(fragment.wait, fragment.data.hex()) for fragment in fault.fragments(ANSWER, framer)]
    assert writes == fragments


def test_random_bytes_are_the_same_with_a_seed() -> None:
    def made(seed: int | None) -> list[bytes | None]:
        faults = Faults({1: [Fault("garbage", length=6, seed=seed)]})
        due = [faults.due(REQUEST, has_transaction=True) for _ in range(3)]
        return [message.data if message else None for message in due]

    first = made(7)
    assert all(data is not None and len(data) == 6 for data in first)
    assert len(set(first)) == 3
    assert made(7) == first
    assert made(None) != first


@pytest.mark.parametrize(("unit", "other"), [(0, 1), (1, 2), (246, 247), (247, 1), (255, 9)])
def test_the_fault_wrong_unit_uses_a_unit_that_a_line_can_have(unit: int, other: int) -> None:
    (fragment,) = Fault("wrong_unit").fragments(ANSWER._replace(unit=unit), TcpFramer())
    assert fragment.data[6] == other


def test_the_transaction_before_0_is_65535() -> None:
    (fragment,) = Fault("wrong_transaction").fragments(ANSWER._replace(transaction=0), TcpFramer())
    assert fragment.data[:2] == b"\xff\xff"


def blocks(client: LanClient, requests: bytes) -> bool:
    """Send more than the network keeps; return whether the server stops to read it."""
    client.settimeout(60)
    count = 0
    try:
        while count < 1 << 21:
            count += client.send(requests[count % len(requests) :])
    except TimeoutError:
        return True
    return False


@pytest.mark.parametrize(
    ("fault", "request_"),
    [
        (Fault("delay", seconds=FOREVER), READ),  # it is not answered
        # Its answers are not taken: also where faults end again and again, each of which lets the
        # server go on.
        (Fault("delay", every=50, seconds=0.001), b"\x03\0\0\0\x08"),
    ],
)
def test_requests_of_a_client_that_gets_no_more_answers_are_not_read(lan: Lan, fault, request_):
    with serving(lan, "tcp", fault) as url, lan.client(url) as flood:
        assert blocks(flood, adu(request_) * 10_000)


@pytest.mark.parametrize("length", [None, 5, 512])
@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_a_fault_sends_its_bytes_before_it_closes_the_connection(lan: Lan, scheme, length):
    fault = Fault("disconnect", function=3, length=length)
    with serving(lan, scheme, fault) as url, lan.client(url) as connection:
        if scheme == "tcp":
            connection.sendall(adu(b"\x01\0\0\0\x01", 7) + adu(READ, 8))
            before, answer = adu(b"\x01\x01\0", 7), adu(b"\x03\x02\x02\x2b", 8)
        else:
            framer = RtuFramer("client")
            connection.sendall(framer.encode(Frame(1, READ)))
            before, answer = b"", framer.encode(Frame(1, b"\x03\x02\x02\x2b"))
        assert connection.receive(100) == before + answer[: length or 0]


def test_a_request_after_one_that_closes_the_connection_is_not_executed(lan: Lan) -> None:
    units = {1: make_device(), 2: make_device()}
    write = b"\x06\0\x01\0\x09"
    fault = Fault("disconnect", function=3)
    with serving(lan, "tcp", fault, units=units) as url, lan.client(url) as connection:
        requests = adu(write.replace(b"\1", b"\0")) + adu(READ) + adu(write) + adu(write, 1, 2)
        connection.sendall(requests)
        assert connection.receive(100) == adu(b"\x06\0\0\0\x09")
        # The server answers others, so it has dealt with these.
        with client_of(url, 2) as client:
            client.read_coils(0, 1)
    assert units[1].mapping.holding_registers[0:2] == [9, 0]
    assert units[2].mapping.holding_registers[1] == 0


def test_a_disconnect_comes_after_delayed_answers(lan: Lan) -> None:
    faults = [Fault("delay", function=1, seconds=100), Fault("disconnect", function=3, length=512)]
    with serving(lan, "tcp", *faults) as url, lan.client(url) as connection:
        connection.sendall(adu(b"\x01\0\0\0\x01", 1) + adu(READ, 2) + adu(READ, 3))
        answers = adu(b"\x01\x01\0", 1) + adu(b"\x03\x02\x02\x2b", 2)
        assert connection.receive(100) == answers


def test_garbage_and_disconnects_work_on_datagrams(lan: Lan) -> None:
    faults = [
        Fault("garbage", function=3, data=b"\xaa", place="behind"),
        Fault("disconnect", function=1, length=4),
    ]
    device = make_device()
    with Server(device, faults={1: faults}).background("udp://10.0.0.1:0") as running:
        datagrams = lan.client(running.urls[0])
        datagrams.send(adu(READ, 5))
        assert datagrams.recv(100) == adu(b"\x03\x02\x02\x2b", 5) + b"\xaa"
        datagrams.send(adu(b"\x01\0\0\0\x01", 6))
        assert datagrams.recv(100) == adu(b"\x01\x01\0", 6)[:4]


def test_a_disconnect_closes_a_tunnel(tmp_path: Path) -> None:
    server = Server({1: make_device()}, faults={1: [Fault("disconnect", every=2, length=5)]})
    with secured(server, Pki(tmp_path)) as url, Client(url, unit=1, timeout=5) as client:
        assert client.read_holding_registers(0, 1) == [555]
        with pytest.raises(ModbusConnectionError):
            client.read_holding_registers(0, 1)
        assert client.read_holding_registers(0, 1) == [555]
        assert server.statistics.handshakes == 2
