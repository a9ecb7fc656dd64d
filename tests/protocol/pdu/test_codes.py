"""
The numbers of the specification: functions, sub-functions, MEI types and exceptions.
"""

from __future__ import annotations

from libmodbus_py import pdu
from libmodbus_py.protocol import errors
from libmodbus_py.protocol.pdu.interface import (
    MeiType,
    ReadDeviceIdCode,
)

# Application protocol, 6.1 to 6.21.
FUNCTIONS = {
    "ReadCoils": 1,
    "ReadDiscreteInputs": 2,
    "ReadHoldingRegisters": 3,
    "ReadInputRegisters": 4,
    "WriteCoil": 5,
    "WriteRegister": 6,
    "ReadExceptionStatus": 7,
    "Diagnostics": 8,
    "ReadCommEventCounter": 11,
    "ReadCommEventLog": 12,
    "WriteCoils": 15,
    "WriteRegisters": 16,
    "ReportServerId": 17,
    "ReadFileRecords": 20,
    "WriteFileRecords": 21,
    "MaskWriteRegister": 22,
    "ReadWriteRegisters": 23,
    "ReadFifoQueue": 24,
    "EncapsulatedTransport": 43,
}

# Application protocol, 6.8.1.
SUB_FUNCTIONS = {
    "RETURN_QUERY_DATA": 0,
    "RESTART_COMMUNICATIONS": 1,
    "RETURN_DIAGNOSTIC_REGISTER": 2,
    "CHANGE_ASCII_DELIMITER": 3,
    "FORCE_LISTEN_ONLY": 4,
    "CLEAR_COUNTERS": 10,
    "BUS_MESSAGE_COUNT": 11,
    "BUS_COMMUNICATION_ERROR_COUNT": 12,
    "BUS_EXCEPTION_ERROR_COUNT": 13,
    "SERVER_MESSAGE_COUNT": 14,
    "SERVER_NO_RESPONSE_COUNT": 15,
    "SERVER_NAK_COUNT": 16,
    "SERVER_BUSY_COUNT": 17,
    "BUS_CHARACTER_OVERRUN_COUNT": 18,
    "CLEAR_OVERRUN": 20,
}

# Application protocol, 7.
EXCEPTIONS = {
    "IllegalFunction": 1,
    "IllegalDataAddress": 2,
    "IllegalDataValue": 3,
    "ServerDeviceFailure": 4,
    "Acknowledge": 5,
    "ServerDeviceBusy": 6,
    "MemoryParityError": 8,
    "GatewayPathUnavailable": 10,
    "GatewayTargetFailedToRespond": 11,
}


def test_functions_have_the_codes_of_the_specification() -> None:
    assert {name: getattr(pdu, name).function for name in FUNCTIONS} == FUNCTIONS
    assert {kind.__name__: code for code, kind in pdu.REQUESTS.items()} == FUNCTIONS


def test_sub_functions_have_the_codes_of_the_specification() -> None:
    assert {each.name: each.value for each in pdu.SubFunction} == SUB_FUNCTIONS


def test_mei_types_have_the_codes_of_the_specification() -> None:
    assert list(MeiType) == [0x0D, 0x0E]
    assert {each.value for each in ReadDeviceIdCode} == {1, 2, 3, 4}


def test_exceptions_have_the_codes_of_the_specification() -> None:
    assert {name: getattr(errors, name).code for name in EXCEPTIONS} == EXCEPTIONS
