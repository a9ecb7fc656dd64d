"""From any side of a gateway to any: all functions, also those the package does not know."""

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    Access,
    Client,
    Device,
    Gateway,
    IllegalFunction,
    Mapping,
    Route,
    Server,
    pdu,
)
from tests.services.gateway.gates import small
from tests.simulation.lan import Lan
from tests.support.certificates import Pki
from tests.support.gateways import passage
from tests.support.interop import check_all

FRONTS = ["tcp", "udp", "rtu+udp", "rtu+tcp", "ascii+tcp", "rtu", "ascii"]
SIDES = [(front, back) for front in FRONTS for back in FRONTS]


@pytest.mark.parametrize(("front", "back"), SIDES, ids=["-".join(sides) for sides in SIDES])
def test_any_function_is_forwarded_between_any_transports(lan: Lan, front: str, back: str) -> None:
    with passage(front, back, lan=lan) as through, through.context() as context:
        every_function(context)


@pytest.mark.parametrize(("front", "back"), [("tcp", "rtu"), ("rtu", "udp"), ("ascii", "tcp")])
def test_any_function_is_forwarded_over_real_sockets_and_ports(front: str, back: str) -> None:
    """The real copy."""
    with passage(front, back) as through, through.context() as context:
        every_function(context)


def every_function(context: Client) -> None:
    check_all(context)
    assert context.read_file_records([(4, 7, 2)]) == [[5007, 5008]]
    context.write_file_records([(4, 7, [1, 2])])
    assert context.read_file_records([(4, 7, 2)]) == [[1, 2]]
    assert context.read_fifo_queue(100) == [440, 4740]
    assert context.read_exception_status() == 0x6D
    assert context.report_server_id().additional == b"libmodbus-py"
    assert context.read_device_identification("extended").objects[128] == b"private"
    assert context.read_comm_event_counter().status == 0
    assert context.read_comm_event_log().events is not None
    assert context.diagnostics(0, 0x1234) == 0x1234
    with pytest.raises(IllegalFunction):
        context.execute(pdu.EncapsulatedTransport(13, b"abc"))


def test_unknown_functions_are_forwarded_as_bytes(lan: Lan) -> None:
    """On a line between, their ends are found by the CRC."""

    @pdu.register
    class Own(pdu.RawRequest):
        function = 101
        request_length = pdu.unknown_length
        response_length = pdu.unknown_length

    device = Device(Mapping(), handlers={Own: lambda request: request.data[::-1]})
    try:
        for front, back in (("tcp", "rtu"), ("rtu", "tcp"), ("udp", "ascii"), ("ascii", "rtu+tcp")):
            with (
                passage(front, back, {1: device}, lan=lan) as through,
                through.context(1) as context,
            ):
                assert context.execute(pdu.RawRequest(101, b"abc")) == b"cba"
                assert context.execute(pdu.RawRequest(101, bytes(252))) == bytes(252)
                with pytest.raises(IllegalFunction):
                    context.execute(pdu.RawRequest(66, b"x"))
    finally:
        del pdu.REQUESTS[101]


def test_authorize_gets_the_role_of_tls_clients(tmp_path: Path) -> None:
    pki = Pki(tmp_path)
    calls: list[object] = []

    def authorize(request: object) -> bool:
        calls.append(request)
        return request.role == "Operator"  # type: ignore[attr-defined]

    with (
        Server({1: small()}).background("tcp://127.0.0.1:0") as behind,
        Gateway([Route(behind.urls[0])], security=pki.server(), authorize=authorize).background(
            "tls://127.0.0.1:0"
        ) as running,
    ):
        for role, is_allowed in (("Operator", True), ("Viewer", False), (None, False)):
            security = pki.client(role=role)
            with Client(running.urls[0], unit=1, security=security) as context:
                if is_allowed:
                    context.write_register(3, 4)
                    assert context.read_holding_registers(3, 1) == [4]
                    continue
                with pytest.raises(IllegalFunction):
                    context.write_register(3, 5)
    assert calls[0].writes == (Access("holding_registers", 3, 1, (4,), 0, 1, *_who(calls[0])),)  # type: ignore[attr-defined]


def _who(request: Any) -> tuple[str, str | None]:
    return request.peer, request.role
