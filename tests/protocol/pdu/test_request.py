"""
Which requests may be sent twice.
"""

from __future__ import annotations

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu import RawRequest, ReadDeviceIdentification
from tests.protocol.pdu.examples import Doubled


def test_reads_and_writes_of_absolute_values_are_repeatable() -> None:
    once = {8, 43}
    for function, kind in pdu.REQUESTS.items():
        assert kind.repeatable is (function not in once), kind
    assert ReadDeviceIdentification.repeatable is True
    assert RawRequest.repeatable is False
    assert Doubled.repeatable is False
