"""
Requests and answers that a gateway does not pass on.
"""

import pytest

from libmodbus_py import (
    Access,
    IllegalFunction,
    pdu,
)
from tests.services.gateway.gates import READ_ONE, adu, small
from tests.simulation.stage import Stage
from tests.support.gateways import passage
from tests.support.interop import UNIT, make_device


def test_read_only_is_read_only(stage: Stage) -> None:
    device = make_device()
    with (
        passage("tcp", "rtu", {UNIT: device}, route={"read_only": True}, stage=stage) as through,
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


def test_what_may_be_written_is_and_nothing_else(stage: Stage) -> None:
    route = {"writable": ["coils", Access("holding_registers", 110, 10)]}
    with passage("tcp", "rtu", route=route, stage=stage) as through, through.context() as context:
        context.write_coil(10, False)
        context.write_registers(110, range(10))
        context.read_write_registers(100, 5, 115, [1])
        for first, count in ((109, 2), (115, 6), (100, 1)):
            with pytest.raises(IllegalFunction):
                context.write_registers(first, [0] * count)
        with pytest.raises(IllegalFunction):
            context.execute(pdu.RawRequest(16, bytes.fromhex("006e 0001 04 0000 0000")))
        assert context.read_holding_registers(109, 3) == [1109, 0, 1]


def test_a_cached_answer_is_refused_to_those_who_may_not_read_it(stage: Stage) -> None:
    with (
        passage(
            "tcp",
            "rtu",
            {1: small()},
            route={"cache": 60},
            authorize=lambda asked: asked.peer.startswith("10.0.0.2:"),
            stage=stage,
        ) as through,
        stage.talk(through.url, "10.0.0.2") as one,
        stage.talk(through.url, "10.0.0.3") as other,
    ):
        for client, answer in ((one, "03 02 0000"), (other, "83 01"), (one, "03 02 0000")):
            client.sendall(adu(READ_ONE))
            expected = adu(bytes.fromhex(answer))
            assert client.receive(len(expected)) == expected
        (line,) = through.gateway.traffic.lines.values()
        assert (line.units[1].requests, line.units[1].cached) == (1, 1)
