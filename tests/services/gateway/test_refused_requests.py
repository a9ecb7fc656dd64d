"""Requests that a gateway refuses, and those that it forwards as bytes."""

import pytest

from libmodbus_py import (
    Access,
    ExceptionResponse,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    pdu,
)
from libmodbus_py.services.gateway.line import request_of
from tests.services.gateway.gates import READ_ONE, adu, small
from tests.simulation.lan import Lan
from tests.support.cases import each_case
from tests.support.gateways import passage
from tests.support.interop import UNIT, make_device


def test_a_route_that_is_read_only_refuses_writes(lan: Lan) -> None:
    device = make_device()
    with (
        passage("tcp", "rtu", {UNIT: device}, route={"read_only": True}, lan=lan) as through,
        through.context() as context,
    ):
        assert context.read_holding_registers(100, 2) == [1100, 1101]
        assert context.report_server_id().running
        assert context.diagnostics(0, 7) == 7
        assert context.read_device_identification().names["VendorName"] == "vendor"
        for write in (
            lambda: context.write_register(100, 1),
            lambda: context.write_coils(10, [True]),
            lambda: context.read_write_registers(100, 1, 100, [1]),
            lambda: context.mask_write_register(100, 0, 0),
            lambda: context.write_file_records([(4, 7, [1])]),
            lambda: context.diagnostics(1),
            lambda: context.execute(pdu.RawRequest(100, b"")),
            lambda: context.execute(pdu.RawRequest(6, b"\0\1\0\2")),
            lambda: context.execute(pdu.RawRequest(15, b"\0\0\0\1\1\1")),
            lambda: context.execute(pdu.EncapsulatedTransport(13, b"")),
            lambda: context.for_unit(0).write_register(100, 1),
        ):
            with pytest.raises(IllegalFunction):
                write()
        assert device.mapping.holding_registers[100] == 1100
        assert through.gateway.traffic.refused == 11


def test_only_writes_that_a_rule_allows_are_executed(lan: Lan) -> None:
    route = {"writable": ["coils", Access("holding_registers", 110, 10)]}
    with passage("tcp", "rtu", route=route, lan=lan) as through, through.context() as context:
        context.write_coil(10, False)
        context.write_registers(110, range(10))
        context.read_write_registers(100, 5, 115, [1])
        for first, count in ((109, 2), (115, 6), (100, 1)):
            with pytest.raises(IllegalFunction):
                context.write_registers(first, [0] * count)
        with pytest.raises(IllegalFunction):
            context.execute(pdu.RawRequest(16, bytes.fromhex("006e 0001 04 0000 0000")))
        assert context.read_holding_registers(109, 3) == [1109, 0, 1]


def test_a_cached_answer_is_refused_to_unauthorized_clients(lan: Lan) -> None:
    with (
        passage(
            "tcp",
            "rtu",
            {1: small()},
            route={"cache": 60},
            authorize=lambda question: question.peer.startswith("10.0.0.2:"),
            lan=lan,
        ) as through,
        lan.client(through.url, "10.0.0.2") as one,
        lan.client(through.url, "10.0.0.3") as other,
    ):
        for client, answer in ((one, "03 02 0000"), (other, "83 01"), (one, "03 02 0000")):
            client.sendall(adu(READ_ONE))
            adu_ = adu(bytes.fromhex(answer))
            assert client.receive(len(adu_)) == adu_
        (line,) = through.gateway.traffic.lines.values()
        assert (line.units[1].requests, line.units[1].cached) == (1, 1)


@pytest.mark.parametrize("code", [0, 0x80, 0x83, 0xFF])
def test_an_invalid_function_code_is_refused(code: int) -> None:
    with pytest.raises(IllegalFunction) as raised:
        request_of(bytes([code, 1, 2]))
    assert raised.value.function == code


@each_case("request", ["03", "03 000000", "03 0000000100", "07 00", "10 00000001 02 00"])
def test_a_known_function_is_forwarded_at_its_length_only(request: str) -> None:
    """With a wrong length, everybody on a line would look for the end in vain."""
    pdu = bytes.fromhex(request)
    with pytest.raises(IllegalDataValue) as raised:
        request_of(pdu)
    assert raised.value.function == pdu[0]


# Requests of the application protocol, sections 6.1 to 6.4, with responses.
RESPONSES = [
    ("01 0013 0013", "01 03 CD6B05"),
    ("02 00C4 0016", "02 03 ACDB35"),
    ("03 006B 0003", "03 06 022B00000064"),
    ("04 0008 0001", "04 02 000A"),
]


@each_case("request, response", RESPONSES)
def test_a_response_to_a_read_is_passed_on_if_its_length_fits(request: str, response: str) -> None:
    request_, good = request_of(bytes.fromhex(request)), bytes.fromhex(response)
    assert request_.decode_response(good) == good
    bad = [b"", good[:-1], good + b"\0", bytes([good[0] ^ 7]) + good[1:], good[:2]]
    bad += [good[:1] + bytes([good[1] - 1]) + rest for rest in (good[2:], good[2:-1])]
    for response_pdu in bad:
        with pytest.raises(InvalidResponse):
            request_.decode_response(response_pdu)
    with pytest.raises(ExceptionResponse):
        request_.decode_response(bytes([good[0] | 0x80, 2]))


@each_case("request", ["05 0001 FF00", "06 0001 0007", "10 0001 0001 02 0007", "16 0001 FFFF 0000"])
def test_bytes_behind_an_echo_are_not_forwarded(request: str) -> None:
    """On a line they would have a wrong CRC."""
    request_ = bytes.fromhex(request)
    echo = request_[: 7 if request_[0] == 0x16 else 5]
    assert request_of(request_).decode_response(echo + b"\6") == echo
