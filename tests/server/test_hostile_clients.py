"""Hostile clients: what they send, and what others see of their attacks."""

import random
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from libmodbus_py import Client, Device, Limits, Mapping, Server, framing
from libmodbus_py.server.peer import READ_BYTES
from libmodbus_py.server.sessions import ByChunk
from tests.simulation.attackers import Attackers, Innocent
from tests.simulation.lan import Lan
from tests.support.attacks import ATTACKS, UNIT, Attack, adu, ask, connect
from tests.support.certificates import Pki
from tests.support.lan_server import ask as server_ask
from tests.support.lan_server import server_on

READ, READ_ANSWER = bytes.fromhex("03 0064 0002"), bytes.fromhex("03 04 03e8 03e9")

LYING = [
    b"\x10\x00\x64\x00\x02\xff\x00\x01\x00\x02",  # byte count beyond the data
    b"\x10\x00\x64\x00\x02\x02\x00\x01",  # byte count and quantity disagree
    b"\x10\x00\x64\x00\x7b\xf6",  # 123 registers promised, none there
    b"\x0f\x00\x0a\x00\x10\xff\xff\xff",
    b"\x0f\x00\x0a\x00\x08\x02\xff\xff",
    b"\x16\x00\x64\xff\xff",  # short mask write
    b"\x16\x00\x64\x00\x00\xff\xff\x00",  # long mask write
    b"\x06\x00\x64\x12",
    b"\x06\x00\x64\x12\x34\x56",
    b"\x05\x00\x0a\x12\x34",
    b"\x17\x00\x64\x00\x01\x00\x64\x00\x7d\xfa\x00",
    b"\x17\x00\x64\x00\x01\x00\x64\x00\x02\x02\x00\x01",
    b"\x00",
    b"\x00\x00\x64\x00\x01",
    b"\x80\x00\x64\x00\x01",
    b"\x86\x00\x64\x12\x34",
    b"\xff",
    b"\x15\xff" + bytes(9),
]


@pytest.mark.parametrize("body", LYING, ids=lambda body: body[:8].hex())
def test_a_wrong_length_has_no_effect_on_other_clients(port: int, device: Device, body) -> None:
    before = contents(device)
    with connect(port) as liar, Client(f"tcp://127.0.0.1:{port}", unit=17) as innocent:
        liar.sendall(adu(body) + adu(READ, 2))
        expected_last = adu(READ_ANSWER, 2)
        answers = b""
        while not answers.endswith(expected_last):
            piece = liar.recv(260)
            assert piece
            answers += piece
        assert contents(device) == before
        assert innocent.read_holding_registers(100, 1) == [1000]


def contents(device: Device) -> tuple[list[int], list[bool]]:
    return list(device.mapping.holding_registers), list(device.mapping.coils)


@pytest.mark.parametrize("length", [0, 1, 255, 65535])
def test_an_invalid_length_closes_the_connection(port: int, length: int) -> None:
    with connect(port) as liar, Client(f"tcp://127.0.0.1:{port}", unit=17) as innocent:
        innocent.connect()
        ask(liar, adu(READ, 1) + adu(READ, 2, length=length), adu(READ_ANSWER, 1))
        assert liar.recv(1) == b""
        assert innocent.read_holding_registers(100, 1) == [1000]


def test_a_closed_client_gets_no_reset_although_it_had_sent_more(port: int) -> None:
    """A reset could take the answers that were sent before from the client."""
    for _ in range(5):
        with connect(port) as liar:
            flood = adu(READ, 1) + adu(READ, 2, length=65535) + bytes(5000)
            ask(liar, flood, adu(READ_ANSWER, 1))
            assert liar.recv(1) == b""


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp"])
def test_random_bytes_change_no_value(lan: Lan, scheme: str, device: Device) -> None:
    """A client that sends invalid bytes is closed, and connects again with the next ones."""
    before = contents(device)
    chance = random.Random(1)
    urls = f"{scheme}://10.0.0.1:0", "tcp://10.0.0.1:0"
    with (
        Server({17: device}).background(*urls) as running,
        Client(running.urls[1], unit=17, timeout=2) as innocent,
    ):
        for _ in range(60):
            flood = lan.client(running.urls[0])
            flood.end.send(chance.randbytes(4096))
            start = lan.now
            assert innocent.read_holding_registers(100, 1) == [1000]
            assert lan.now - start < 0.01
            flood.close()
        lan.pass_time(60)
        assert contents(device) == before


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(body=st.binary(min_size=1, max_size=253), transaction=st.integers(0, 0xFFFF))
def test_any_request_gets_one_answer_or_none(port: int, body: bytes, transaction: int) -> None:
    with connect(port) as connection:
        last = transaction ^ 1
        connection.sendall(adu(body, transaction) + adu(READ, last))
        data = b""
        while not data.endswith(adu(READ_ANSWER, last)):
            data += connection.recv(600)
        frames = framing.TcpFramer().feed(data)
        transactions = [last] if body[0] & 0x80 else [transaction, last]
        assert [frame.transaction for frame in frames] == transactions
        assert frames[0].pdu[0] & 0x7F == body[0] & 0x7F or body[0] & 0x80


# How many of those that send something are enough: in a turn 128 connections are read.
SENDERS = 200

# The turns of the loop in which so many are read, and one for the answer.
TURNS = -(-SENDERS // 128) + 1


def others(attack: Attack) -> int:
    """
    How many requests of others are answered before the innocent's: what one turn reads of them,
    `READ_BYTES` of each of up to 128 connections.
    """
    return min(attack.connections, 128) * READ_BYTES // len(adu(b"\x63\1\2\3"))


def enough(attack: Attack) -> Attack:
    return replace(attack, connections=min(attack.connections, SENDERS)) if attack.sends else attack


@pytest.mark.parametrize(
    "attack", [*map(enough, ATTACKS)], ids=lambda attack: attack.name.replace(" ", "-")
)
def test_a_client_waits_for_few_requests_of_a_flood(lan: Lan, attack, tmp_path) -> None:
    """The innocent speaks TCP; an attack on TLS meets another endpoint of the same server."""
    server = Server(
        {UNIT: Device(Mapping(holding_registers=2000))},
        limits=Limits(max_connections=1500),
        security=Pki(tmp_path).server() if attack.scheme == "tls" else None,
    )
    urls = ["tcp://10.0.0.1:0", f"{attack.scheme}://10.0.0.1:0"]
    with server.background(*urls) as running, lan.client(running.urls[0]) as client:
        innocent = Innocent(lan, client, lambda: server.statistics.requests)
        assert innocent.poll(5).turns == [0] * 5
        with Attackers(lan, attack, running.urls[1]) as attackers:
            assert lan.until(lambda: attackers.all_attack, 10)
            waited = innocent.poll(3, among=attackers)
        assert (attackers.sent > 0) == attack.sends
        assert max(waited.turns) <= TURNS
        assert max(waited.others) <= others(attack)
        assert waited.longest <= others(attack) + 1
        assert lan.until(lambda: server.statistics.connections == 1)
        assert innocent.poll(5).turns == [0] * 5


def test_an_internal_error_ends_one_connection_only(lan: Lan, monkeypatch, caplog):
    receive = ByChunk.receive

    def fail_at_noise(session: ByChunk, data: bytes) -> int:
        if data == b"!":
            raise RuntimeError("a defect")
        return receive(session, data)

    monkeypatch.setattr(ByChunk, "receive", fail_at_noise)
    with server_on(lan) as server:
        bad, good = server.connect(), server.connect()
        bad.sendall(b"!")
        server_ask(good)
        assert bad.is_closed()
        assert server.counts(connections=1)
    assert "connection closed" in caplog.text
