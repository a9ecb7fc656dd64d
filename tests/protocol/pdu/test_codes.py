"""
The numbers of the specification that have names here: sub-functions and MEI types.
"""

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu.interface import (
    MeiType,
    ReadDeviceIdCode,
)

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


def test_sub_functions_have_the_codes_of_the_specification() -> None:
    assert {each.name: each.value for each in pdu.SubFunction} == SUB_FUNCTIONS


def test_mei_types_have_the_codes_of_the_specification() -> None:
    assert list(MeiType) == [0x0D, 0x0E]
    assert {each.value for each in ReadDeviceIdCode} == {1, 2, 3, 4}
