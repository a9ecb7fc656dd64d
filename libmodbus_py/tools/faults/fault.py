"""
A fault: a mistake in answers of a server, the requests concerned, its frequency, and its bytes.

The server lets the fault that is due happen (`server.faults`).
"""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import Literal, get_args

from ...device.access import Accesses, touched_by
from ...files import schema
from ...protocol.checks import number, seconds
from ...protocol.framing import AsciiFramer, Frame, Framer, RtuFramer
from ...protocol.mistakes import Path, WrongType, WrongValue, named_arguments
from ...protocol.tables import TABLE_SIZE, TABLES, Table
from ...server.faults import Fragment

KINDS: dict[str, str | None] = {
    "delay": "seconds",
    "no_answer": None,
    "exception": "code",
    "wrong_check": None,
    "wrong_transaction": None,
    "wrong_unit": None,
    "trickle": "seconds",
    "truncate": "length",
    "disconnect": None,
    "garbage": None,
}
"""Kind of fault -> the one setting that it needs."""

OPTIONAL: dict[str, tuple[str, ...]] = {
    "disconnect": ("length",),
    "garbage": ("data", "length", "place"),
}
"""Kind of fault -> the settings that it can have."""

Place = Literal["before", "instead", "behind"]

PLACES: tuple[Place, ...] = get_args(Place)
"""The places of garbage relative to the answer."""

LONGEST = 512
"""More bytes than any frame has."""


def _data(path: Path, value: object) -> None:
    if not isinstance(value, bytes):
        raise WrongType(path, f"must be bytes, not {type(value).__name__}")
    if len(value) > LONGEST:
        raise WrongValue(path, f"must have 0..{LONGEST} bytes, not {len(value)}")


SETTINGS: dict[str, schema.Check] = {
    "seconds": seconds,
    "code": schema.whole(1, 0xFF),
    "length": schema.whole(0, LONGEST),
    "data": _data,
    "place": schema.one_of(*PLACES),
}
"""Setting that only some kinds have -> its check."""

WHICH: dict[str, schema.Check] = {
    "function": schema.whole(1, 0x7F),
    "table": schema.one_of(*TABLES),
    "address": schema.whole(0, TABLE_SIZE - 1),
    "count": schema.whole(1, TABLE_SIZE),
    "every": schema.whole(1, 1_000_000_000),
    "probability": lambda path, value: number(path, value, 0, 1),
    "seed": schema.whole(0, (1 << 64) - 1),
}
"""Attribute that selects requests -> its check."""


@named_arguments
@dataclass(frozen=True)
class Fault:
    """
    A fault in the responses of a unit, and how often it happens.

    A fault counts the answered requests of its unit, function and address range, from all clients
    on all endpoints together. If several faults are due for a request, those of the unit come
    before those of all units, and earlier ones before later ones. The request is executed
    whatever happens to its response; only "exception" executes nothing.

    Attributes:
        kind: what goes wrong:

            * "delay": the response, and those after it on the connection, come `seconds` later;
            * "no_answer": no response is sent;
            * "exception": the request is refused with the exception `code`;
            * "wrong_check": the CRC or LRC is wrong; on TCP, the length in the header is 0;
            * "wrong_transaction": the response has the transaction id of the previous
              request; never on lines, which have none;
            * "wrong_unit": the response has the address of another unit;
            * "trickle": its bytes are sent one by one, `seconds` apart; over UDP as datagrams;
            * "truncate": only the first `length` bytes of the frame are sent, never all;
            * "disconnect": the first `length` bytes of the response are sent, none by default,
              then the connection is closed, and later requests of the client are not executed.
              On serial ports and UDP only the rest of the response is missing;
            * "garbage": `data`, or `length` random bytes, are sent at `place`; over UDP in the
              datagram of the response.

        function: the function code whose requests have the fault, 1..127; None for all.
        every: the fault happens to every n-th request, n = 1 or more; None for 1.
        probability: the probability that the fault happens to a request, 0..1, in place of
            `every`.
        seed: makes `probability` select the same requests in each run, and makes random bytes
            the same; 0..2^64 - 1.
        seconds: for "delay" and "trickle", 0.001..86400.
        code: for "exception", 1..255.
        length: a number of bytes, 0..512.
        table: the fault happens only to requests that read or write this table: "coils",
            "discrete_inputs", "holding_registers", "input_registers"; None for all tables.
        address: the fault happens only to requests that touch one of `count` addresses starting
            here, 0..65535; None for all addresses.
        count: 1..65536; None for 1.
        data: for "garbage", 0..512 bytes.
        place: "before" the response, "instead" of it or "behind" it; None for before.

    Raises:
        TypeError, ValueError: an attribute is of the wrong type or range, or missing, or does not
            apply to the kind.
    """

    kind: str
    function: int | None = None
    every: int | None = None
    probability: float | None = None
    seed: int | None = None
    seconds: float | None = None
    code: int | None = None
    length: int | None = None
    table: Table | None = None
    address: int | None = None
    count: int | None = None
    data: bytes | None = None
    place: Place | None = None

    def __post_init__(self) -> None:
        schema.one_of(*KINDS)(("kind",), self.kind)
        required = KINDS[self.kind]
        keys = WHICH.keys() | {required, *OPTIONAL.get(self.kind, ())}
        for name, check in (SETTINGS | WHICH).items():
            if (value := getattr(self, name)) is None:
                if name == required:
                    raise WrongValue(name, f"is missing, which {self.kind} needs")
            elif name not in keys:
                raise WrongValue(name, f"does not apply to {self.kind}")
            else:
                check((name,), value)
        if self.kind == "garbage" and (self.data is None) == (self.length is None):
            raise WrongValue("data", "or length is missing, and garbage needs one of them")
        if self.count is not None and self.address is None:
            raise WrongValue("count", "cannot be given without address")
        if self.every is not None and self.probability is not None:
            raise WrongValue("probability", "cannot be given together with every")
        if self.seed is not None and self.probability is None and not self.has_random_bytes:
            raise WrongValue("seed", "cannot be given without probability")

    @property
    def has_random_bytes(self) -> bool:
        """True for garbage of which only the length is given."""
        return self.kind == "garbage" and self.length is not None

    @property
    def is_everywhere(self) -> bool:
        """True if the fault happens to requests of all addresses."""
        return self.table is None and self.address is None

    def hits(self, accesses: Accesses) -> bool:
        """Return True if the fault happens to a request with these accesses."""
        first = 0 if self.address is None else self.address
        stop = TABLE_SIZE if self.address is None else first + (self.count or 1)
        return any(
            access.table == self.table or (self.table is None and access.table in TABLES)
            for access in (*accesses.writes, *accesses.reads)
            if access.address < stop and first < access.address + access.count
        )

    def concerns(self, request: Frame, *, has_transaction: bool) -> bool:
        """Return True if the fault counts a request, which may have a transaction id."""
        if self.function not in (None, request.pdu[0]):
            return False
        if self.kind == "wrong_transaction" and not has_transaction:
            return False
        return self.is_everywhere or self.hits(touched_by(request.pdu))

    def counter(self) -> Counter:
        """Return a new counter of the requests of the fault."""
        return Counter(self)

    def fragments(self, answer: Frame, framer: Framer) -> list[Fragment]:
        """Return what is sent in place of an answer."""
        kind = self.kind
        if kind == "no_answer":
            return []
        if kind == "wrong_transaction":
            # Never that of the next request, because this would then count as its answer.
            answer = answer._replace(transaction=answer.transaction - 1 & 0xFFFF)
        if kind == "wrong_unit":
            answer = answer._replace(unit=answer.unit % 247 + 1)  # one that a serial line can have
        adu = framer.encode(answer)
        parts = _parts(self, adu, framer)
        fragments_of_adu = tuple((part, answer if part == adu else None) for part in parts if part)
        data = b"".join(parts)
        wait = self.seconds or 0
        if kind != "trickle":
            return [Fragment(wait, data, kind == "disconnect", fragments_of_adu)]
        fragments = [Fragment(wait if at else 0, data[at : at + 1]) for at in range(len(data))]
        return [*fragments[:-1], fragments[-1]._replace(traced=fragments_of_adu)]


class Counter:
    """Counts the requests that a fault concerns."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._count = 0
        self._random = random.Random(fault.seed)

    def is_due(self) -> bool:
        if self._fault.probability is not None:
            return self._random.random() < self._fault.probability
        self._count += 1
        return self._count % (self._fault.every or 1) == 0

    def happening(self) -> Fault:
        """The fault as it happens this time: with its random bytes."""
        fault = self._fault
        if not fault.has_random_bytes:
            return fault
        data = self._random.randbytes(fault.length or 0)
        return replace(fault, data=data, length=None, seed=None)


def _parts(fault: Fault, adu: bytes, framer: Framer) -> tuple[bytes, ...]:
    """Return the bytes sent in place of a frame; the frame is a part of its own."""
    garbage = fault.data or b""
    match fault.kind:
        case "wrong_check":
            return (_with_wrong_check(adu, framer),)
        case "truncate":
            return (adu[: min(fault.length or 0, len(adu) - 1)],)
        case "disconnect":
            return (adu[: fault.length or 0],)
        case "garbage" if fault.place == "instead":
            return (garbage,)
        case "garbage" if fault.place == "behind":
            return (adu, garbage)
        case "garbage":
            return (garbage, adu)
    return (adu,)


def _with_wrong_check(adu: bytes, framer: Framer) -> bytes:
    if isinstance(framer, RtuFramer):
        return adu[:-2] + bytes(byte ^ 0xFF for byte in adu[-2:])
    if isinstance(framer, AsciiFramer):  # two digits before CR and delimiter
        return adu[:-4] + b"%02X" % (int(adu[-4:-2], 16) ^ 0xFF) + adu[-2:]
    return adu[:4] + b"\0\0" + adu[6:]  # the length in the header
