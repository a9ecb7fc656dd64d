"""
Which requests are asked again if they are lost beside others: those that change nothing.
"""

from __future__ import annotations

from typing import Any

from libmodbus_py import ModbusTimeoutError, pdu
from tests.client.test_window import grown
from tests.support.cases import each_case
from tests.support.talk import tcp

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


@each_case("request", READS, ids=repr)
def test_a_read_is_asked_again_alone(request: Any) -> None:
    talk = grown()
    sent = len(talk.sent)
    talk.ask(request), talk.ask(1)
    assert len(talk.sent) == sent + 2
    talk.come(tcp(talk.sent[-1]))
    talk.wait(0.25)
    assert [adu[2:] for adu in talk.sent[sent + 2 :]] == [talk.sent[sent][2:]]


@each_case("request", WRITES, ids=repr)
def test_a_write_is_sent_beside_no_other_and_once(request: Any) -> None:
    talk = grown()
    sent = len(talk.sent)
    batch = talk.ask(request)
    other = talk.ask(1)
    talk.wait(0.99)
    assert len(talk.sent) == sent + 1
    talk.wait(0.01)
    assert isinstance(batch.outcomes[0], ModbusTimeoutError)
    assert len(talk.sent) == sent + 2
    talk.come(tcp(talk.sent[-1]))
    assert other.outcomes == [[1]]
    assert talk.is_at_rest
