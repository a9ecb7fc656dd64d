"""
A capture replayed: devices that answer as those in it did, and requests sent again, whose results
are compared with those in it.
"""

from __future__ import annotations

import os
from collections import defaultdict, deque
from collections.abc import Container, Iterator
from typing import Any, NamedTuple

from ...client.blocking import Client
from ...device.access import Caller
from ...device.device import Device
from ...device.mapping import Mapping
from ...protocol import errors
from ...protocol.errors import ExceptionResponse, ModbusConnectionError, ModbusError
from ...protocol.logs import HarmlessLogger
from ...protocol.mistakes import WrongValue
from ...protocol.pdu import Request
from .listener import CAPTURES, listen
from .transaction import Transaction

logger: HarmlessLogger = HarmlessLogger(__name__)

_UNKNOWN = Caller()

Answers = dict[bytes, "deque[bytes]"]
"""The PDU of a request -> those of its responses, in order; an empty one for no response."""


class ReplayedDevice(Device):
    """
    Answers each request with the responses that the capture has for it, in order, then with the
    last again. A request that is not in the capture gets exception 4 (server device failure).
    """

    def __init__(self, unit: int, answers: Answers) -> None:
        super().__init__(Mapping())
        self._unit = unit
        self._answers = answers
        self._is_logged = False

    def answer(self, pdu: bytes, caller: Caller = _UNKNOWN) -> bytes:
        if caller.is_broadcast or pdu[0] & 0x80:
            return b""
        with self.mapping:
            responses = self._answers.get(pdu)
            if responses is not None:
                return responses.popleft() if len(responses) > 1 else responses[0]
            is_first, self._is_logged = not self._is_logged, True
        if is_first:
            text = "unit %d: request %s is not in the capture; this is logged once"
            logger.warning(text, self._unit, pdu.hex(" "))
        return bytes([pdu[0] | 0x80, errors.ServerDeviceFailure.code])


def replayed_devices(path: str | os.PathLike[str]) -> dict[int, Device]:
    """
    Return the devices of a capture by unit.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no capture, or has no request to a unit.
    """
    units: defaultdict[int, Answers] = defaultdict(lambda: defaultdict(deque))
    for unit, request, transaction in _requests(path):
        units[unit][request.encode()].append(_response(request, transaction))
    if not units:
        raise WrongValue((), f"{os.fspath(path)}: no request of Modbus is in this capture")
    return {unit: ReplayedDevice(unit, dict(answers)) for unit, answers in units.items()}


def _requests(path: str | os.PathLike[str]) -> Iterator[tuple[int, Request[Any], Transaction]]:
    """Yield the requests of a capture, with their units and transactions."""
    name = os.fspath(path)
    if not name.endswith(CAPTURES):
        raise WrongValue((), f"{name}: the name of a capture must end with .pcap or .pcapng")
    with listen(name) as listener:
        for transaction in listener:
            if transaction.kind in ("broadcast", "late"):
                continue
            if transaction.unit is not None and transaction.request is not None:
                yield transaction.unit, transaction.request, transaction


def _response(request: Request[Any], transaction: Transaction) -> bytes:
    """Return the PDU of a response, empty for none."""
    error = transaction.error
    if isinstance(error, ExceptionResponse):
        return bytes([request.function | 0x80, error.code])
    if transaction.kind == "answered":
        return request.encode_response(transaction.response)
    return error.received if transaction.kind == "invalid" and error is not None else b""


class Difference(NamedTuple):
    """A transaction of a capture, and what the device answers now: a result or an error."""

    transaction: Transaction
    answer: Any


def differences(
    client: Client, path: str | os.PathLike[str], *, units: Container[int] | None, writes: bool
) -> Iterator[Difference | None]:
    """
    Send the requests of a capture that had a response, and yield each response that differs; None
    for those that are the same.

    Raises:
        ModbusConnectionError: the device cannot be reached any more.
    """
    for unit, request, transaction in _requests(path):
        is_wanted = (units is None or unit in units) and (writes or not request.changes)
        if not is_wanted or transaction.kind not in ("answered", "exception"):
            continue
        answer: Any = None
        try:
            answer = client.for_unit(unit).execute(request)
        except ModbusConnectionError:
            raise
        except ModbusError as error:
            answer = error
        now = getattr(answer, "code", None) if isinstance(answer, ModbusError) else answer
        before = getattr(transaction.error, "code", transaction.response)
        is_same = now == before and isinstance(answer, ModbusError) is (
            transaction.error is not None
        )
        yield None if is_same else Difference(transaction, answer)
