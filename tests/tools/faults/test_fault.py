"""
Faults that cannot be are refused with the name of the argument.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Server
from libmodbus_py.tools.faults.answers import Faults
from libmodbus_py.tools.faults.fault import Fault
from tests.tools.faults.serving import made_device


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "dealy"}, "kind must be one of delay, no_answer, exception, .*, not 'dealy'"),
        ({"kind": ["delay"]}, "kind must be one of"),
        ({"kind": "delay"}, "seconds is missing, which delay needs"),
        ({"kind": "trickle", "seconds": 0}, r"seconds must be in 0.001..86400 seconds, not 0"),
        ({"kind": "delay", "seconds": "1"}, "seconds must be a number of seconds, not str"),
        ({"kind": "exception"}, "code is missing, which exception needs"),
        ({"kind": "exception", "code": 256}, r"code must be in 1..255, not 256"),
        ({"kind": "exception", "code": 0}, r"code must be in 1..255, not 0"),
        ({"kind": "truncate"}, "length is missing, which truncate needs"),
        ({"kind": "truncate", "length": 0}, r"length must be in 1..512, not 0"),
        ({"kind": "no_answer", "seconds": 1}, "seconds does not apply to no_answer"),
        ({"kind": "delay", "seconds": 1, "code": 1}, "code does not apply to delay"),
        ({"kind": "no_answer", "function": 128}, r"function must be in 1..127, not 128"),
        ({"kind": "no_answer", "every": 0}, r"every must be in 1..1000000000, not 0"),
        (
            {"kind": "no_answer", "every": 2, "probability": 0.5},
            "probability cannot be given together",
        ),
        ({"kind": "no_answer", "probability": 1.1}, r"probability must be in 0..1, not 1.1"),
        ({"kind": "no_answer", "probability": float("nan")}, r"probability must be in 0..1"),
        ({"kind": "no_answer", "probability": True}, r"probability must be a number, not bool"),
        ({"kind": "no_answer", "seed": 1}, "seed cannot be given without probability"),
        ({"kind": "no_answer", "probability": 0.5, "seed": -1}, "seed must be in 0"),
        ({"kind": "disconnect", "length": 513}, r"length must be in 0..512, not 513"),
        ({"kind": "disconnect", "seconds": 1}, "seconds does not apply to disconnect"),
        ({"kind": "garbage"}, "data or length is missing, and garbage needs one of them, not"),
        ({"kind": "garbage", "data": b"1", "length": 1}, "needs one of them, not both"),
        ({"kind": "garbage", "data": "1"}, "data must be bytes, not str"),
        ({"kind": "garbage", "data": b""}, r"data must have 1..512 bytes, not 0"),
        ({"kind": "garbage", "length": 0}, r"length must be in 1..512, not 0"),
        (
            {"kind": "garbage", "length": 1, "place": "after"},
            "place must be one of before, instead, behind, not 'after'",
        ),
        ({"kind": "garbage", "data": b"1", "seed": 1}, "seed cannot be given without probability"),
        ({"kind": "delay", "seconds": 1, "place": "before"}, "place does not apply to delay"),
        ({"kind": "no_answer", "table": "coil"}, "table must be one of coils, .*, not 'coil'"),
        ({"kind": "no_answer", "address": 65536}, r"address must be in 0..65535, not 65536"),
        ({"kind": "no_answer", "count": 1}, "count cannot be given without address"),
        ({"kind": "no_answer", "address": 1, "count": 0}, r"count must be in 1..65536, not 0"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        Fault(**settings)


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ([Fault("no_answer")], "faults must be"),
        ({256: [Fault("no_answer")]}, r"faults: unit must be in 0..255, not 256"),
        ({1: ["no_answer"]}, "faults must be .*, not 'no_answer'"),
    ],
)
def test_faults_that_are_none_are_refused(faults: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        Server(made_device(), faults)


def test_a_server_without_faults_has_nothing_to_do_with_them() -> None:
    assert not Faults({})
    assert not Faults({1: [], None: []})
    assert Server(made_device(), {1: []})._units.interceptor is None
