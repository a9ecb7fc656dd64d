"""
Which requests may change a device, and which may be sent twice: the clients, the audit and gateways
ask the request itself.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu import RawRequest, ReadDeviceIdentification
from libmodbus_py.services.gateway.line import request_of
from tests.protocol.pdu.examples import Doubled

READING = [
    pdu.ReadCoils(0, 1),
    pdu.ReadDiscreteInputs(0, 1),
    pdu.ReadHoldingRegisters(0, 1),
    pdu.ReadInputRegisters(0, 1),
    pdu.ReadExceptionStatus(),
    pdu.Diagnostics(0),
    pdu.Diagnostics(11),
    pdu.ReadCommEventCounter(),
    pdu.ReadCommEventLog(),
    pdu.ReportServerId(),
    pdu.ReadFileRecords([(4, 1, 2)]),
    pdu.ReadFifoQueue(0),
    pdu.ReadDeviceIdentification(1),
]
CHANGING = [
    pdu.WriteCoil(0, True),
    pdu.WriteRegister(0, 1),
    *(pdu.Diagnostics(number) for number in (1, 3, 4, 10, 20)),
    pdu.WriteCoils(0, [True]),
    pdu.WriteRegisters(0, [1]),
    pdu.WriteFileRecords([(4, 1, [2])]),
    pdu.MaskWriteRegister(0, 1, 2),
    pdu.ReadWriteRegisters(0, 1, 0, [1]),
    pdu.EncapsulatedTransport(13, b"\0"),  # only its two ends know what a CANopen message does
    pdu.RawRequest(100),
]


@pytest.mark.parametrize("request_", [*READING, *CHANGING], ids=str)
def test_a_request_says_whether_it_changes_a_device(request_: pdu.Request[Any]) -> None:
    assert request_.changes is (request_ in CHANGING)
    assert request_of(request_.encode()).changes is (request_ in CHANGING)


# --- requests that may be sent twice -----------------------------------------------------------


def test_reads_and_writes_of_absolute_values_are_repeatable() -> None:
    once = {8, 43}
    for function, kind in pdu.REQUESTS.items():
        assert kind.repeatable is (function not in once), kind
    assert ReadDeviceIdentification.repeatable is True
    assert RawRequest.repeatable is False
    assert Doubled.repeatable is False
