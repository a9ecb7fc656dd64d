"""The base of sessions: frames of received bytes, what is written and traced, and its state."""

import struct

import pytest

from libmodbus_py import Device, Server, framing
from tests.simulation.lan import Lan
from tests.support.attacks import adu, ask, connect

ASKED, ANSWER = bytes.fromhex("03 0000 0001"), bytes.fromhex("03 02 0007")

# What the fixture `device` is asked, and answers.
READ, READ_ANSWER = bytes.fromhex("03 0064 0002"), bytes.fromhex("03 04 03e8 03e9")


def framed(pdu: bytes, number: int) -> bytes:
    return struct.pack(">HHHB", number, 0, len(pdu) + 1, 1) + pdu


def request(number: int = 1) -> bytes:
    return framed(ASKED, number)


def answer(number: int = 1) -> bytes:
    return framed(ANSWER, number)


@pytest.mark.timeout(60)
def test_an_invalid_request_does_not_affect_the_answers_around_it(port: int) -> None:
    """modbus_reply would sleep half a second for each, a minute and a half for all."""
    requests = [READ, b"\x03\x00\x64\x00\x00", READ, b"\x41", READ, b"\x06\x09", READ]
    answers = [READ_ANSWER, b"\x83\x03", READ_ANSWER, b"\xc1\x01", READ_ANSWER, b"\x86\x03"]
    answers.append(READ_ANSWER)
    requests, answers = requests * 60, answers * 60
    with connect(port) as connection:
        frames = b"".join(adu(body, number) for number, body in enumerate(requests))
        ask(connection, frames, b"".join(adu(body, number) for number, body in enumerate(answers)))


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp"])
def test_a_request_split_anywhere_is_answered(lan: Lan, scheme: str, device: Device) -> None:
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
            with lan.client(running.urls[0]) as client:
                client.sendall(request[:cut])
                lan.pass_time(0.03)
                client.sendall(request[cut:] + request)
                # A line has no transaction ids: only the last of two requests is answered.
                answers = answer * (2 if scheme == "tcp" else 1)
                assert client.receive(len(answers)) == answers, cut
