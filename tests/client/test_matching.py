"""
Which answer is whose: doubled, late, damaged and foreign answers, and what stands between them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import pytest

from libmodbus_py import InvalidResponse, ModbusError, ModbusTimeoutError, framing
from tests.support.clients import EVERYWHERE, Simulated, World, read
from tests.support.peers import Write, answer, answering, mbap


def rtu(request: bytes) -> bytes:
    return answer(request, "rtu")


# --- on lines ------------------------------------------------------------------------------------


@pytest.mark.parametrize("copy_after", [0.0, 0.001, 0.015])
def test_a_unit_that_answers_twice_gives_no_wrong_values(world: World, copy_after: float) -> None:
    def twice(request: bytes, write: Write) -> None:
        write(rtu(request))
        write(rtu(request), after=copy_after)

    unit = world.peer("rtu", twice)
    # A copy that comes while an answer is held fails the request.
    with world.connect(f"{unit.url}&silence=0.002") as client:
        for address in range(50):
            with contextlib.suppress(InvalidResponse):
                assert read(client, address) == address
        assert client.statistics.responses > 25


STRAYS: dict[str, Callable[[bytes], bytes]] = {
    "00": lambda request: b"\x00",
    "FF": lambda request: b"\xff",
    "FE 00": lambda request: b"\xfe\x00",
    "unit": lambda request: answer(request, "rtu", unit=9),
    "echo": lambda request: request,
    "00 and echo": lambda request: b"\x00" + request,
}


@pytest.mark.parametrize("pause", [0, 0.03])
@pytest.mark.parametrize("stray", STRAYS)
def test_what_stands_before_each_answer_on_a_line_harms_none(
    stray: str, pause: float, world: World
) -> None:
    """A transceiver that turns round makes bytes; a pause is longer than the framer's silence."""

    def strayed(request: bytes, write: Write) -> None:
        write(STRAYS[stray](request) + (b"" if pause else rtu(request)))
        if pause:
            write(rtu(request), after=pause)

    unit = world.peer("rtu", strayed)
    with world.connect(unit.url) as client:
        assert [read(client, address) for address in range(40)] == list(range(40))


@pytest.mark.parametrize("world", ["native"], indirect=True)
def test_a_stray_byte_before_each_answer_through_c(world: World) -> None:
    unit = world.peer("rtu", answering(lambda request: [b"\x00" + rtu(request)]))
    with world.connect(unit.url, timeout=30) as client:
        assert [read(client, address) for address in range(10)] == list(range(10))


@EVERYWHERE
def test_echoes_of_writes_are_their_answers_or_harm_none(world: World) -> None:
    def echoed(request: bytes) -> list[bytes]:
        return [request, request[:6] + framing.crc16(request[:6]).to_bytes(2, "little")]

    unit = world.peer("rtu", answering(echoed))
    with world.connect(unit.url, timeout=30) as client:
        for address in range(20 if world.is_exact else 3):
            client.write_registers(address, [1, 2])  # this one tells of the echo
            client.write_register(address, 1)


# --- over TCP ------------------------------------------------------------------------------------


@EVERYWHERE
def test_an_answer_with_another_id_before_each_answer_harms_none(world: World) -> None:
    def with_other(request: bytes) -> list[bytes]:
        number = int.from_bytes(request[:2], "big") ^ 0x5555
        return [mbap(request, b"\x03\x02\xff\xff", transaction=number) + answer(request, "tcp")]

    peer = world.peer("tcp", answering(with_other))
    with world.connect(peer.url) as client:
        assert [read(client, address) for address in range(40)] == list(range(40))
        assert peer.connections == 1


@EVERYWHERE
def test_a_late_answer_during_a_request_does_not_fail_it(world: World) -> None:
    """It comes while the second request after the one that was given up waits."""
    owed = b""

    def late(request: bytes, write: Write) -> None:
        nonlocal owed
        address = int.from_bytes(request[8:10], "big")
        if address == 7:
            owed = answer(request, "tcp")
        elif address == 3:
            write(owed, after=0.02)
            write(answer(request, "tcp"), after=0.04)
        else:
            write(answer(request, "tcp"))

    peer = world.peer("tcp", late)
    with world.connect(peer.url, timeout=30) as client:
        for _ in range(3):
            assert read(client, 1) == 1
            client.timeout = 0.05
            with world.lasting(0.05), pytest.raises(ModbusTimeoutError):
                read(client, 7)
            client.timeout = 30
            with world.lasting(0.04):
                assert [read(client, address) for address in (2, 3)] == [2, 3]
        assert client.late_answers == 3
        assert peer.connections == 1


@EVERYWHERE
def test_a_device_that_is_unit_255_to_everybody_is_reached_with_an_option(world: World) -> None:
    peer = world.peer("tcp", answering(lambda request: [answer(request, "tcp", unit=255)]))
    with (
        world.connect(peer.url, unit=3) as client,
        pytest.raises(ModbusError, match='accept_unit="any"') as caught,
    ):
        read(client, 1)
    assert caught.value.received[6] == 255
    for options, query in (({"accept_unit": "any"}, ""), ({}, "?accept_unit=any")):
        with world.connect(peer.url + query, unit=3, **options) as client:
            assert [read(client, address) for address in range(5)] == list(range(5))


# --- before a request goes out -------------------------------------------------------------------


def test_what_came_meanwhile_is_no_answer_to_the_next_request(world: Simulated) -> None:
    """A program that was busy reads what nobody asked for before it asks."""

    def twice(request: bytes, write: Write) -> None:
        write(answer(request, "rtu+tcp"))
        write(answer(b"\1\3\0\x63", "rtu+tcp"), after=0.05)

    peer = world.peer("rtu+tcp", twice)
    with world.connect(peer.url, timeout=1.0) as client:
        for address in range(5):
            assert read(client, address) == address
            world.compute(0.1)


def test_a_connection_that_ended_meanwhile_costs_no_request(world: Simulated) -> None:
    def and_close(request: bytes, write: Write) -> None:
        write(answer(request, "tcp"))
        write(None, after=0.05)

    peer = world.peer("tcp", and_close)
    with world.connect(peer.url, timeout=1.0) as client:
        for address in range(5):
            assert read(client, address) == address
            world.compute(0.1)
        assert peer.connections == 5
