"""
A request that is lost beside others is asked again; of writes only the newest.
"""

from __future__ import annotations

from typing import Any

from libmodbus_py import ModbusTimeoutError, pdu
from tests.support.cases import each_case
from tests.support.talk import Talk, tcp

READS = [
    pdu.ReadCoils(0, 1),
    pdu.ReadDiscreteInputs(0, 1),
    pdu.ReadHoldingRegisters(0, 1),
    pdu.ReadInputRegisters(0, 1),
    pdu.ReadExceptionStatus(),
    pdu.ReadCommEventCounter(),
    pdu.ReadCommEventLog(),
    pdu.ReportServerId(),
    pdu.ReadFileRecords(((4, 1, 2),)),
    pdu.ReadFifoQueue(0),
    pdu.ReadDeviceIdentification(1),
]

WRITES = [
    pdu.WriteCoil(0, True),
    pdu.WriteRegister(0, 1),
    pdu.WriteCoils(0, (True,)),
    pdu.WriteRegisters(0, (1,)),
    pdu.WriteFileRecords(((4, 1, (2,)),)),
    pdu.MaskWriteRegister(0, 0, 1),
    pdu.ReadWriteRegisters(0, 1, 0, (1,)),
]


def lost_beside(older: Any, newer: Any, answer: str) -> tuple[Any, int]:
    """Lose the older of two requests; return its batch, and how often it was asked again."""
    talk = Talk(max_in_flight=None, timeout=1)
    talk.ask(*range(7), limit=16)
    while not talk.is_at_rest:
        pending = talk.conversation.in_flight
        talk.come(*[tcp(each) for each in talk.sent[len(talk.sent) - pending :]])
    assert talk.conversation.limit >= 4
    batch = talk.ask(older)
    talk.ask(newer)
    talk.come(tcp(talk.sent[-1], answer))
    sent = len(talk.sent)
    talk.wait(2)
    return batch, len(talk.sent) - sent


@each_case("request", READS, ids=repr)
def test_a_read_is_asked_again_over_a_newer_write(request: Any) -> None:
    _, count = lost_beside(request, pdu.WriteRegister(1, 2), "06 00 01 00 02")
    assert count == 1


@each_case("request", WRITES, ids=repr)
def test_a_write_is_not_sent_again_over_a_newer_one(request: Any) -> None:
    batch, count = lost_beside(request, pdu.WriteRegister(1, 2), "06 00 01 00 02")
    assert count == 0
    assert isinstance(batch.outcomes[0], ModbusTimeoutError)


@each_case("request", WRITES, ids=repr)
def test_a_write_is_sent_again_over_a_newer_read(request: Any) -> None:
    _, count = lost_beside(request, pdu.ReadHoldingRegisters(0, 1), "03 02 00 01")
    assert count == 1
