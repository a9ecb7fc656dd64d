"""
What passed, as text, and who wrote what last: both from the ADUs that a trace is told of.
"""

from __future__ import annotations

import re
import reprlib
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import count
from typing import Any, NamedTuple

from ...device.access import ACCESSES
from ...ports.endpoint import parse
from ...ports.trace import Traced
from ...protocol import pdu
from ...protocol.framing import Framing
from ...protocol.pdu import RawRequest, Request
from ..listener.outcome import Outcome, answered, damaged, decoded
from ..listener.transaction import Transaction
from .shown import Shown

__all__ = ["Log", "Passed", "Written"]

# How many ADUs wait to be looked at, and how many transactions are remembered.
MOST_ADUS = 2000
MOST_PASSED = 300

# How many ranges that somebody wrote are remembered, and how many writes without their answers.
MOST_RANGES = 1000
MOST_ASKED = 1000

MOST_VALUES = 10

_short = reprlib.Repr()
_short.maxlist = _short.maxtuple = _short.maxdict = 8
_short.maxstring = _short.maxother = 80

# Framing -> the PDU of an ADU.
PDUS: dict[Framing, Callable[[bytes], bytes]] = {
    "tcp": lambda adu: adu[7:],
    "udp": lambda adu: adu[7:],
    "rtu": lambda adu: adu[1:-2],
    "ascii": lambda adu: bytes.fromhex(adu[3:-4].decode()),
}

WRITES = frozenset(request.function for request, kind in ACCESSES.items() if kind.writes)


class Passed(NamedTuple):
    """A transaction as a row of the log; `number` counts all there ever were."""

    number: int
    time: float
    peer: str
    unit: int | None
    function: int | None
    asked: str
    outcome: str
    kind: str
    seconds: float | None


class Written(NamedTuple):
    """Who wrote some addresses last; `number` counts all writes there ever were."""

    number: int
    unit: int | None
    table: str
    start: int
    stop: int
    time: float
    who: str


@dataclass
class Asked:
    """A request that waits for its answer."""

    traced: Traced
    request: Request[Any] | None


class Log:
    """
    Notes what passes, from the server's loop, and tells it, from any thread.

    Args:
        shown: gives what there is now.
    """

    def __init__(self, shown: Callable[[], Shown]) -> None:
        self._shown = shown
        self._adus: deque[Traced] = deque(maxlen=MOST_ADUS)
        self._waiting: dict[tuple[Any, ...], Asked] = {}
        self._passed: deque[Passed] = deque(maxlen=MOST_PASSED)
        self._passed_before = count(1)
        self._written: dict[tuple[int | None, str, int, int], Written] = {}
        self._written_before = count(1)
        self._asked: dict[tuple[Any, ...], bytes] = {}

    # --- noting ----------------------------------------------------------------------------------

    def note(self, traced: Traced) -> None:
        """Take what a trace was told, quickly."""
        self._adus.append(traced)
        if traced.function in WRITES:
            self._note_write(traced)

    def wrote(self, unit: int | None, table: str, start: int, stop: int, who: str) -> None:
        """Somebody wrote these addresses."""
        key = unit, table, start, stop
        self._written.pop(key, None)  # the latest is the last
        while len(self._written) >= MOST_RANGES:
            self._written.pop(next(iter(self._written)), None)
        number = next(self._written_before)
        self._written[key] = Written(number, *key, time.time(), who)

    def _note_write(self, traced: Traced) -> None:
        key = _key(traced)
        body = _pdu(traced)
        if traced.direction == "sent":
            body = self._asked.pop(key, b"")
        elif traced.unit == 0 and _framing(traced.endpoint) in ("rtu", "ascii"):
            pass  # nobody answers a broadcast
        else:
            while len(self._asked) >= MOST_ASKED:
                self._asked.pop(next(iter(self._asked)), None)
            self._asked[key] = body
            return
        if body and (request := decoded(body)) is not None:
            self._note_written(traced, request)

    def _note_written(self, traced: Traced, request: Request[Any]) -> None:
        shown, kind = self._shown(), ACCESSES.get(type(request))
        for number in shown.units_of(traced.unit or 0, is_line=_is_line(traced)):
            mapping = shown.units[number].device.mapping
            for access in kind.find(request, mapping, (0, "", None)).writes if kind else ():
                start = access.address
                self.wrote(number, access.table, start, start + access.count, traced.peer or "")

    # --- telling ---------------------------------------------------------------------------------

    def passed(self, after: int = 0) -> list[Passed]:
        """Give the transactions after this number, of those that are remembered."""
        # Those that come meanwhile wait: under load there would be no end of them.
        for _ in range(len(self._adus)):
            self._pair(self._adus.popleft())
        return [each for each in self._passed if each.number > after]

    def written(self, after: int = 0) -> list[Written]:
        """Give the writes after this number, the oldest first."""
        newest = []
        for each in reversed(list(self._written.copy().values())):
            if each.number <= after:
                break
            newest.append(each)
        return newest[::-1]

    def _pair(self, traced: Traced) -> None:
        key = _key(traced)
        if traced.direction == "sent":
            asked = self._waiting.pop(key, None)
            self._add(asked, traced)
            return
        body = _pdu(traced)
        asked = Asked(traced, (decoded(body) or _raw(body)) if body else None)
        if asked.request is None or not asked.request.expects_response or _is_broadcast(traced):
            self._add(asked, None)
            return
        if key in self._waiting:  # asked again: the first one got no answer
            self._add(self._waiting.pop(key), None)
        while len(self._waiting) >= MOST_ASKED:
            self._add(self._waiting.pop(next(iter(self._waiting))), None)
        self._waiting[key] = asked

    def _add(self, asked: Asked | None, answer: Traced | None) -> None:
        first = asked.traced if asked is not None else answer
        if first is None:
            return
        request = None if asked is None else asked.request
        kind, response, error = _outcome(first, request, answer)
        told = Transaction(first.time, kind, first.unit, first.function, request, response, error)
        self._passed.append(
            Passed(
                next(self._passed_before),
                first.time,
                first.peer or "",
                first.unit,
                None if first.function is None else first.function & 0x7F,
                "" if request is None else _words(request),
                _cut(told.outcome()) if response is None else _listed(response),
                kind,
                None if asked is None or answer is None else answer.time - first.time,
            )
        )


def _outcome(first: Traced, request: Request[Any] | None, answer: Traced | None) -> Outcome:
    if answer is None:
        if request is None:
            return damaged(first.adu)
        silent = _is_broadcast(first) or not request.expects_response
        return Outcome("broadcast" if silent else "unanswered")
    body = _pdu(answer)
    if request is None or not body:
        return Outcome("unasked") if body else damaged(answer.adu)
    return answered(request, body)


def _key(traced: Traced) -> tuple[Any, ...]:
    """What a request and its answer have in common."""
    is_line = _is_line(traced)
    number = b"" if is_line else traced.adu[:2]
    function = None if traced.function is None else traced.function & 0x7F
    return traced.endpoint, traced.peer, traced.unit, function, number


def _is_line(traced: Traced) -> bool:
    return _framing(traced.endpoint) in ("rtu", "ascii")


def _is_broadcast(traced: Traced) -> bool:
    return traced.unit == 0 and _is_line(traced)


@lru_cache(64)
def _framing(url: str) -> Framing:
    return parse(url).framing


def _pdu(traced: Traced) -> bytes:
    """Nothing for bytes that are no frame."""
    return b"" if traced.unit is None else PDUS[_framing(traced.endpoint)](traced.adu)


def _raw(body: bytes) -> Request[Any] | None:
    return RawRequest.decode(body) if 0 < body[0] < 0x80 else None


def _words(request: Request[Any]) -> str:
    """Such as ``read holding registers 100..102``, or ``diagnostics: sub function 0, data ...``."""
    match request:
        case pdu.WriteCoil() | pdu.WriteRegister():
            return f"write {_place(request)} {request.address}: {int(request.value)}"
        case pdu.WriteCoils() | pdu.WriteRegisters():
            span = _span(request.address, len(request.values))
            return f"write {_place(request)} {span}: {_listed(request.values)}"
        case (
            pdu.ReadCoils()
            | pdu.ReadDiscreteInputs()
            | pdu.ReadHoldingRegisters()
            | pdu.ReadInputRegisters()
        ):
            return f"read {_place(request)} {_span(request.address, request.count)}"
        case _:
            return _all_words(request)


def _place(request: Request[Any]) -> str:
    kind = ACCESSES[type(request)]
    return (kind.reads or kind.writes).replace("_", " ")


def _span(address: int, count: int) -> str:
    return str(address) if count == 1 else f"{address}..{address + count - 1}"


def _listed(values: Any) -> str:
    """Bits and registers as numbers, the first few; others as Python has them."""
    if not isinstance(values, list | tuple) or not all(isinstance(each, int) for each in values):
        return _short.repr(values)
    more = "" if len(values) <= MOST_VALUES else f", ... ({len(values)})"
    return ", ".join(str(int(each)) for each in values[:MOST_VALUES]) + more


def _all_words(request: Request[Any]) -> str:
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(request).__name__).lower()
    given = [
        f"{each.name.replace('_', ' ')} {_short.repr(getattr(request, each.name))}"
        for each in fields(request)  # type: ignore[arg-type]
        if each.repr
    ]
    return f"{name}: {', '.join(given)}" if given else name


def _cut(text: str) -> str:
    return text if len(text) <= 200 else f"{text[:200]}..."
