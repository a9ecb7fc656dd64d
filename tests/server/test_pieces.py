"""
Requests that arrive glued together or cut in pieces.
"""

from __future__ import annotations

import asyncio
import socket

import pytest

from libmodbus_py import Device, Server, framing, pdu
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server.framed import SessionSettings
from libmodbus_py.server.limits import Limits, ServerStatistics
from libmodbus_py.server.peers import Peers
from libmodbus_py.server.sessions import ByChunk, Singles
from libmodbus_py.server.units import TcpUnits, Units
from tests.server.raw_requests import READ, READ_ANSWER, adu, connect, receive
from tests.simulation.stage import Stage


def test_sixteen_requests_in_one_segment_are_answered_in_order(port: int) -> None:
    with connect(port) as connection:
        connection.sendall(b"".join(adu(READ, number) for number in range(16)))
        expected = b"".join(adu(READ_ANSWER, number) for number in range(16))
        assert receive(connection, len(expected)) == expected


def test_who_only_listens_any_more_gets_all_answers(device: Device) -> None:
    """More than the system buffers, so that they wait for the client to take them."""
    body = pdu.ReadHoldingRegisters(100, 125).encode()

    async def serve(end: socket.socket) -> bytes:
        statistics = ServerStatistics()
        peers = Peers(Limits(), statistics)
        units = TcpUnits(Units(device))
        singles = Singles(units, statistics, peers.later)
        settings = SessionSettings(parse("tcp://10.0.0.1"), statistics)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        end.setblocking(False)
        peers.admit(
            end,
            "peer",
            "peer:1",
            lambda peer: ByChunk(settings, units, peer, singles),
        )
        while statistics.requests < 80:  # it has seen the end of the requests
            await asyncio.sleep(0)
        received = await asyncio.to_thread(receive, client, 1 << 20)
        assert statistics.connections == 0
        peers.close()
        return received

    client, end = socket.socketpair()
    with client, end:
        client.sendall(b"".join(adu(body, number) for number in range(80)))
        client.shutdown(socket.SHUT_WR)
        assert len(asyncio.run(serve(end))) == 80 * 259


@pytest.mark.timeout(60)
def test_an_illegal_request_does_not_cost_its_neighbours_their_answers(port: int) -> None:
    """modbus_reply would sleep half a second for each, a minute and a half for all."""
    requests = [READ, b"\x03\x00\x64\x00\x00", READ, b"\x41", READ, b"\x06\x09", READ]
    answers = [READ_ANSWER, b"\x83\x03", READ_ANSWER, b"\xc1\x01", READ_ANSWER, b"\x86\x03"]
    answers.append(READ_ANSWER)
    requests, answers = requests * 60, answers * 60
    with connect(port) as connection:
        connection.sendall(b"".join(adu(body, number) for number, body in enumerate(requests)))
        expected = b"".join(adu(body, number) for number, body in enumerate(answers))
        assert receive(connection, len(expected)) == expected


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp"])
def test_a_request_cut_anywhere_is_answered(stage: Stage, scheme: str, device: Device) -> None:
    framers: dict[str, framing.Framer] = {
        "tcp": framing.TcpFramer(),
        "rtu+tcp": framing.RtuFramer("server"),
        "ascii+tcp": framing.AsciiFramer(),
    }
    framer = framers[scheme]
    request = framer.encode(framing.Frame(17, READ))
    answer = framer.encode(framing.Frame(17, READ_ANSWER))
    with Server(device).background(f"{scheme}://10.0.0.1:0") as running:
        for cut in range(1, len(request)):
            with stage.talk(running.urls[0]) as client:
                client.sendall(request[:cut])
                stage.pass_time(0.03)
                client.sendall(request[cut:] + request)
                # A line has no transaction ids: only the last of two requests is answered.
                answers = answer * (2 if scheme == "tcp" else 1)
                assert client.receive(len(answers)) == answers, cut
