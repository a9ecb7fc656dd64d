"""
Values as JSON can contain them.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

from libmodbus_py import pdu
from libmodbus_py.client.reconnecting import State
from libmodbus_py.protocol.plain import plain, without_controls
from tests.support.cases import each_case


@each_case(
    ("value", "made"),
    [
        (None, None),
        (True, True),
        (7, 7),
        (0.5, 0.5),
        (float("nan"), None),
        (float("-inf"), None),
        ("text", "text"),
        (datetime(2026, 3, 29, 1, 30, tzinfo=UTC), "2026-03-29T01:30:00+00:00"),
        (b"\x01\xff", "01ff"),
        ([1, (b"\x02", float("inf"))], [1, ["02", None]]),
        ({1: b"\x03"}, {"1": "03"}),
        (pdu.ServerId(b"\x01", True, b""), {"identifier": "01", "running": True, "additional": ""}),
        (
            pdu.ServerId(b"A", None, b"C"),
            {"identifier": "41", "running": None, "additional": "43"},
        ),
        (pdu.SubFunction.CLEAR_COUNTERS, 10),
        (State.CONNECTED, "connected"),
        (
            pdu.ReadHoldingRegisters(0, 2),
            {"name": "ReadHoldingRegisters", "address": 0, "count": 2},
        ),
        (
            pdu.WriteFileRecords(((4, 1, (7,)),)),
            {"name": "WriteFileRecords", "records": [[4, 1, [7]]]},
        ),
    ],
)
def test_each_value_is_one_that_json_has(value: Any, made: Any) -> None:
    assert plain(value) == made
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == made


def test_what_a_terminal_would_obey_is_shown_instead() -> None:
    assert without_controls("a\x1b[2J\x9b\tb\nc \xe4") == "a\\x1b[2J\\x9b\\x09b\nc \xe4"
