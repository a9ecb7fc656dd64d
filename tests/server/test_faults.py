"""The faults that a server accepts: a keyword, and any object that can do what `Fault` can."""

from dataclasses import dataclass
from typing import Any

import pytest

from libmodbus_py import Client, Device, Fault, IllegalDataAddress, InvalidResponse, Mapping, Server
from libmodbus_py.protocol.framing import Frame, Framer
from libmodbus_py.server.faults import FaultCounter, Fragment


def device() -> Device:
    return Device(Mapping(holding_registers={0: [7]}))


@dataclass(frozen=True)
class EverySecond:
    """A fault that is no `Fault`: every second answer is that of another function, or refused."""

    code: int | None = None

    def concerns(self, request: Frame, *, has_transaction: bool) -> bool:
        return request.pdu[0] == 3

    def counter(self) -> FaultCounter:
        return CountedTwo(self)

    def fragments(self, answer: Frame, framer: Framer) -> list[Fragment]:
        if answer.pdu[0] == 3:
            answer = answer._replace(pdu=b"\4" + answer.pdu[1:])
        return [Fragment(0, framer.encode(answer))]


class CountedTwo:
    def __init__(self, fault: EverySecond) -> None:
        self._fault, self._requests = fault, 0

    def is_due(self) -> bool:
        self._requests += 1
        return self._requests % 2 == 0

    def happening(self) -> EverySecond:
        return self._fault


@pytest.mark.parametrize(
    ("fault", "error"),
    [(EverySecond(), InvalidResponse), (EverySecond(code=2), IllegalDataAddress)],
    ids=["bytes", "exception"],
)
def test_an_own_fault_of_a_program_is_applied(fault: EverySecond, error: type[Exception]) -> None:
    server = Server({1: device()}, faults={1: [fault]})
    with (
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], retries=0) as client,
    ):
        for _ in range(2):
            assert client.read_holding_registers(0, 1) == [7]
            with pytest.raises(error):
                client.read_holding_registers(0, 1)
    assert server.faults == {1: [fault]}


@pytest.mark.parametrize(
    ("faults", "text"),
    [
        ([Fault("no_answer")], r"faults must be \{unit or None: \[Fault, \.\.\.\]\}, not list"),
        ({1: Fault("no_answer")}, r"faults\[1\] must be a list of faults, not Fault"),
        ({None: "delay"}, r"faults\[None\] must be a list of faults, not str"),
        ({1: ["delay"]}, r"faults must be \{unit or None: \[Fault, \.\.\.\]\}, not 'delay'"),
    ],
    ids=repr,
)
def test_an_invalid_fault_is_named(faults: Any, text: str) -> None:
    with pytest.raises(TypeError, match=f"^{text}$"):
        Server(device(), faults=faults)
    server = Server(device())
    with pytest.raises(TypeError, match=f"^{text}$"):
        server.replace({1: device()}, faults=faults)
    assert isinstance(server.devices, Device)


def test_only_the_devices_are_positional_arguments() -> None:
    faults = {1: [Fault("no_answer")]}
    with pytest.raises(TypeError, match="positional"):
        Server(device(), faults)  # type: ignore[call-arg, arg-type]
    server = Server(device())
    with pytest.raises(TypeError, match="positional"):
        server.replace(device(), faults)  # type: ignore[call-arg, arg-type]


@pytest.mark.parametrize("name", ["devices", "faults"])
def test_attributes_that_replace_changes_are_read_only(name: str) -> None:
    server = Server(device())
    with pytest.raises(AttributeError, match=name):
        setattr(server, name, getattr(server, name))
