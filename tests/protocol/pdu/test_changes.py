"""
Which requests may change a device, and which may be sent twice: the clients, the audit and gateways
ask the request itself.
"""

from typing import Any

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu import RawRequest, ReadDeviceIdentification
from libmodbus_py.services.gateway.line import request_of
from tests.protocol.pdu.examples import EXAMPLES, Doubled
from tests.support.cases import each_case

READS = (1, 2, 3, 4, 7, 11, 12, 17, 20, 24)
WRITES = (5, 6, 15, 16, 21, 22, 23)

READING = [
    *(each for each in EXAMPLES if each.function in READS),
    *(pdu.Diagnostics(number) for number in (0, 2, *range(11, 19))),
    pdu.ReadDeviceIdentification(1),
]
CHANGING = [
    *(each for each in EXAMPLES if each.function in WRITES),
    *(pdu.Diagnostics(number) for number in (1, 3, 4, 10, 20)),
    pdu.EncapsulatedTransport(13, b"\0"),  # only its two ends know what a CANopen message does
    pdu.RawRequest(100),
]


@each_case("request_", [*READING, *CHANGING])
def test_a_request_says_whether_it_changes_a_device(request_: pdu.Request[Any]) -> None:
    assert request_.changes is (request_ in CHANGING)
    assert request_of(request_.encode()).changes is (request_ in CHANGING)


def test_every_function_is_tried() -> None:
    assert {each.function for each in READING + CHANGING} == {*pdu.REQUESTS, 100}


# --- requests that may be sent twice -----------------------------------------------------------


def test_reads_and_writes_of_absolute_values_are_repeatable() -> None:
    once = {8, 43}
    for function, kind in pdu.REQUESTS.items():
        assert kind.repeatable is (function not in once), kind
    assert ReadDeviceIdentification.repeatable is True
    assert RawRequest.repeatable is False
    assert Doubled.repeatable is False
