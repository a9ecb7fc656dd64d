"""A subclass of Device that overrides `answer` is asked for every request, on every transport."""

from typing import Any
from unittest import mock

import pytest

from libmodbus_py import (
    Client,
    Device,
    Gateway,
    IllegalDataValue,
    Mapping,
    Point,
    RegisterMap,
    Route,
    Server,
)
from libmodbus_py.serve import Caller, Hook
from tests.support import transports
from tests.support.attacks import READ_ONE, adu, connect, receive
from tests.support.transports import TRANSPORTS

WRITE = bytes.fromhex("06 0001 0007")
REFUSAL = bytes.fromhex("86 03")


class Refusing(Device):
    """Refuses each write of 7 to register 1, and answers the rest as a Device does."""

    def answer(self, pdu: bytes, caller: Caller = Caller()) -> bytes:  # noqa: B008
        return REFUSAL if pdu == WRITE else super().answer(pdu, caller)


def check(url: str) -> None:
    with Client(url, unit=17) as client:
        for _ in range(2):  # the second time on a connection that has answered
            with pytest.raises(IllegalDataValue):
                client.write_register(1, 7)
            client.write_register(1, 8)
            assert client.read_holding_registers(0, 2) == [0, 8]


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_an_overridden_answer_is_called(transport: str) -> None:
    device = Refusing(Mapping(holding_registers=4))
    with transports.serving(transport, Server({17: device})) as url:
        check(url)


HOOK = Hook(print, holding_registers=range(3, 4))
POINTS = RegisterMap([Point("flow", "holding_registers", 3)])


@pytest.mark.parametrize(
    "options",
    [{}, {"before_write": HOOK}, {"after_write": HOOK}, {"before_read": HOOK}, {"points": POINTS}],
    ids=lambda options: "".join(options) or "plain",
)
@pytest.mark.parametrize("unit", [1, 0])
def test_an_overridden_answer_is_called_for_each_request(options: dict[str, Any], unit: int):
    device = Refusing(Mapping(holding_registers=4), **options)
    requests = [WRITE, WRITE] if "points" in options else [READ_ONE, WRITE, READ_ONE]
    with (
        Server({1: device}).background("tcp://127.0.0.1:0") as running,
        connect(running.urls[0]) as peer,
    ):
        peer.sendall(b"".join(adu(request, at, unit) for at, request in enumerate(requests)))
        answers = [REFUSAL if item == WRITE else bytes.fromhex("03 02 0000") for item in requests]
        response = b"".join(adu(answer, at, unit) for at, answer in enumerate(answers))
        assert receive(peer, len(response)) == response
    assert device.mapping.holding_registers[1] == 0


def test_a_method_that_is_replaced_later_is_called() -> None:
    device = Device(Mapping(holding_registers=4))
    with (
        Server(device).background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0]) as client,
    ):
        client.write_register(1, 7)
        for owner in (device, Device):
            with (
                mock.patch.object(owner, "answer", return_value=REFUSAL),
                pytest.raises(IllegalDataValue),
            ):
                client.write_register(1, 9)
        assert client.read_holding_registers(1, 1) == [7]


def test_an_overridden_answer_is_called_behind_gateways_and_beside_other_devices() -> None:
    own, plain = (kind(Mapping(holding_registers=4)) for kind in (Refusing, Device))
    server = Server({17: own, 18: plain})
    with server.background("tcp://127.0.0.1:0") as behind:
        gateway = Gateway([Route(behind.urls[0], units="17-18")])
        with gateway.background("tcp://127.0.0.1:0") as running:
            check(running.urls[0])
            with Client(running.urls[0], unit=18) as client:
                client.write_register(1, 7)
    assert plain.mapping.holding_registers[1] == 7


def test_a_device_with_an_overridden_answer_is_not_answered_in_c() -> None:
    device = Refusing(Mapping(holding_registers=4))
    assert device.in_c == frozenset()
    assert device.answer_chunk(adu(READ_ONE), 0, 1) == (0, b"", 0, 0)
