"""What a client sees of each fault."""

from dataclasses import replace

import pytest

from libmodbus_py import (
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusTimeoutError,
    ServerDeviceBusy,
)
from libmodbus_py.tools.faults.fault import Fault
from tests.simulation.lan import Lan
from tests.tools.faults.serving import client_of, serving

SEEN: dict[str, tuple[Fault, type[Exception]]] = {
    "delay": (Fault("delay", every=2, seconds=300), ModbusTimeoutError),
    "no_answer": (Fault("no_answer", every=2), ModbusTimeoutError),
    "exception": (Fault("exception", every=2, code=6), ServerDeviceBusy),
    "unknown exception": (Fault("exception", every=2, code=255), ExceptionResponse),
    "wrong_check": (Fault("wrong_check", every=2), FrameError),
    "wrong_transaction": (Fault("wrong_transaction", every=2), ModbusTimeoutError),
    "wrong_unit": (Fault("wrong_unit", every=2), InvalidResponse),
    "trickle": (Fault("trickle", every=2, seconds=30), ModbusTimeoutError),
    "truncate": (Fault("truncate", every=2, length=5), ModbusTimeoutError),
    "disconnect": (Fault("disconnect", every=2), ModbusConnectionError),
    "disconnect midway": (Fault("disconnect", every=2, length=5), ModbusConnectionError),
    "garbage": (Fault("garbage", every=2, data=bytes(9)), FrameError),
    "garbage instead": (Fault("garbage", every=2, length=3, place="instead"), ModbusTimeoutError),
}
# Where no connection can be closed it is silence.
ON_LINES = {"disconnect": ModbusTimeoutError, "disconnect midway": ModbusTimeoutError}

# On serial lines clients skip noise before an answer.
SERIAL = [
    name for name in SEEN if name not in ("wrong_transaction", "unknown exception", "garbage")
]

CASES = [
    # A read is sent again if its connection ends before a byte of the answer.
    *(("tcp", name) for name in SEEN if name != "disconnect"),
    *((scheme, name) for scheme in ("rtu", "ascii") for name in SERIAL),
    *((scheme, "wrong_check") for scheme in ("rtu+tcp", "ascii+tcp")),
    *((scheme, "disconnect midway") for scheme in ("rtu+tcp", "ascii+tcp")),
]


@pytest.mark.parametrize(("scheme", "name"), CASES)
def test_a_client_sees_the_fault_and_the_next_request_succeeds(lan: Lan, scheme, name) -> None:
    fault, error = SEEN[name]
    if scheme in ("rtu", "ascii"):
        error = ON_LINES.get(name, error)
    if scheme == "ascii" and name == "trickle":
        # Twice the bytes; and a line must not be noisy for longer than two timeouts.
        fault = replace(fault, seconds=0.015)
    # A second of silence ends a frame there.
    timeout = 0.2 if scheme == "ascii" else 200
    with serving(lan, scheme, fault) as url, client_of(url, timeout=timeout) as client:
        assert client.read_holding_registers(0, 3) == [555, 0, 100]
        with pytest.raises(error) as caught:
            client.read_holding_registers(0, 3)
        assert type(caught.value) is error
        client.timeout = 5000
        assert client.read_holding_registers(0, 3) == [555, 0, 100]


@pytest.mark.parametrize("scheme", ["tcp", "rtu", "ascii"])
def test_a_client_with_a_long_timeout_gets_late_and_slow_answers(lan: Lan, scheme: str) -> None:
    faults = [Fault("delay", function=3, seconds=50), Fault("trickle", seconds=0.5)]
    with serving(lan, scheme, *faults) as url, client_of(url) as client:
        assert client.read_holding_registers(0, 3) == [555, 0, 100]
        assert client.read_coils(0, 3) == [False] * 3
