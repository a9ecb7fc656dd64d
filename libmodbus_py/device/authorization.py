"""
Authorization of every request, before anything else is done (MB-TCP-Security-v36, R-24 to R-31);
and the access rights of roles as a table. A request that no rule allows is refused. Warnings that
clients cause, such as refusals, must not fill the log.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import reprlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import starmap
from typing import Any, Literal

from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import IllegalFunction
from ..protocol.logs import HarmlessLogger
from ..protocol.mistakes import Path, WrongType, WrongValue, named_arguments
from ..protocol.tables import contains, joined
from .access import ACCESSES, READABLE, WRITABLE, Access
from .hooks import timed

logger: HarmlessLogger = HarmlessLogger(__name__)

# The highest sub-function and MEI type.
SUB_FUNCTIONS = {pdu.Diagnostics.function: 0xFFFF, pdu.EncapsulatedTransport.function: 0xFF}

# A function, and its sub-function or MEI type; None stands for all of these.
Code = tuple[int, int | None]


@dataclass(frozen=True, slots=True)
class ClientRequest:
    """
    A request and its client, as they are passed to `authorize`.

    Attributes:
        role: the role in the client's certificate; None without a role, or without TLS.
        unit: the unit of the request, 0..255; on serial lines 0 stands for all units.
        peer: the client: "192.0.2.7:51234", or the serial port.
        function: the function code, 0..127.
        request: the decoded request; None if it cannot be decoded because its function is unknown,
            or a length, quantity or constant is wrong.
        writes: the accesses that write to tables and files, with the values.
        reads: the accesses that read tables, files and queues.
    """

    role: str | None
    unit: int
    peer: str
    function: int
    request: pdu.Request[Any] | None = None
    writes: tuple[Access, ...] = ()
    reads: tuple[Access, ...] = ()


Authorize = Callable[[ClientRequest], bool]


class UnauthorizedError(IllegalFunction):
    """The request is not allowed: exception 1 (R-31)."""


class Authorization:
    """Decides about each request, and logs few refusals, so that a client cannot fill the log."""

    def __init__(self, authorize: Authorize, log: LimitedLog | None = None) -> None:
        self._authorize = timed("authorize", authorize)
        self._log = log or LimitedLog(logger)

    def check(self, request: ClientRequest) -> None:
        """Raise UnauthorizedError if a request is not allowed, TypeError for no bool."""
        decision = self._authorize(request)
        if decision is True:
            return
        if decision is not False:
            # A truthy value may be a mistake, and a mistake must not allow access.
            kind = type(decision).__name__
            raise TypeError(f"authorize must return True or False, not {kind}")
        role = "without a role" if request.role is None else f"with the role {request.role!r}"
        message = "%s, %s, may not use %s"
        self._log.warning(
            message, request.peer or "a caller", role, what_is_asked(request), reason=role
        )
        raise UnauthorizedError("not allowed", function=request.function)


def what_is_asked(request: ClientRequest) -> str:
    """Return function and unit of a request, and its first access, for the log."""
    ranges = [f"write {_range_text(access)}" for access in request.writes[:1]]
    ranges += [f"read {_range_text(access)}" for access in request.reads[:1]]
    return ", ".join([f"function {request.function} of unit {request.unit}", *ranges])


def _range_text(access: Access) -> str:
    table = f"file {access.file}" if access.table == "file" else access.table
    return f"{table} {access.address}..{access.address + access.count - 1}"


@named_arguments
@dataclass(frozen=True)
class Allow:
    """
    The accesses that a role is allowed. What is not listed is refused.

    Args:
        read: the tables that may be read: names of whole tables, "fifo" and "file" among them;
            an `Access` with table, address and count (and file) for a part of a table; or "all".
        write: the same for writes to "coils", "holding_registers" and "file"; or "all".
        functions: functions that access no table: function codes such as 17, also registered ones;
            "8/0" or "43/14" for one sub-function or MEI type; or "all". Functions that access
            tables, such as 3 and 16, are governed by `read` and `write`; function 23 needs both.

    Raises:
        TypeError, ValueError: there is no such table, part of a table, or function.
    """

    read: Literal["all"] | Iterable[str | Access] = ()
    write: Literal["all"] | Iterable[str | Access] = ()
    functions: Literal["all"] | Iterable[int | str] = ()
    _reads: _Places = field(init=False, repr=False, compare=False)
    _writes: _Places = field(init=False, repr=False, compare=False)
    _codes: frozenset[Code] | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # A tuple, because a generator is empty the second time.
        read = _listed("read", self.read, READABLE)
        write = _listed("write", self.write, WRITABLE)
        functions = _listed("functions", self.functions, ("all",))
        is_all = self.functions == "all"
        vars(self).update(
            read=read,
            write=write,
            functions=functions,
            _reads=_Places("read", read, READABLE),
            _writes=_Places("write", write, WRITABLE),
            _codes=None if is_all else frozenset(starmap(_code, enumerate(functions))),
        )

    def allows(self, request: ClientRequest) -> bool:
        """
        Return True if a request and all its accesses are allowed.

        A request that cannot be decoded is allowed if some request of its function would be
        allowed, so that the client learns what is wrong with it.
        """
        if request.request is None:
            return self._allows_some(request.function)
        if type(request.request) in ACCESSES:
            return (
                bool(request.writes or request.reads)
                and all(map(self._writes.cover, request.writes))
                and all(map(self._reads.cover, request.reads))
            )
        codes = self._codes
        return (
            codes is None
            or (request.function, None) in codes
            or (request.function, _sub_function(request.request)) in codes
        )

    def _allows_some(self, function: int) -> bool:
        kind = ACCESSES.get(pdu.REQUESTS.get(function))  # type: ignore[arg-type]
        if kind is not None:
            return self._reads.has_table(kind.reads) and self._writes.has_table(kind.writes)
        return self._codes is None or any(code == function for code, _ in self._codes)


@named_arguments
class Rules:
    """
    The access rights of roles, for ``Device(authorize=...)``: what no rule allows is refused.

    ::

        Rules({
            "Viewer": Allow(read="all"),
            "Operator": Allow(read="all", write=["coils", Access("holding_registers", 100, 20)]),
            None: Allow(functions=["43/14"]),
        })

    Args:
        roles: ``{role: Allow(...)}``; the role None applies to clients without a role, such as all
            clients without TLS.

    Raises:
        TypeError, ValueError: a value is no `Allow`, or no certificate can contain the role.
    """

    def __init__(self, roles: Mapping[str | None, Allow]) -> None:
        from ..security.certificates import check_role  # which brings ssl

        if not isinstance(roles, Mapping):
            raise WrongType("roles", f"must be {{role: Allow(...)}}, not {type(roles).__name__}")
        for role, allow in roles.items():
            if role is not None:
                if not isinstance(role, str):
                    raise TypeError(f"a role must be text or None, not {role!r}")
                check_role(role)
            if not isinstance(allow, Allow):
                raise TypeError(f"roles[{role!r}] must be Allow(...), not {type(allow).__name__}")
        self._roles = dict(roles)

    def __repr__(self) -> str:
        return f"Rules({self._roles!r})"

    def __call__(self, request: ClientRequest) -> bool:
        allow = self._roles.get(request.role)
        return allow is not None and allow.allows(request)


class _Places:
    """Tables as a whole, and runs of items in them."""

    def __init__(self, name: str, places: Iterable[Any], sizes: Mapping[str, int]) -> None:
        self._whole: set[str] = set()
        runs: defaultdict[tuple[str, int], list[range]] = defaultdict(list)
        for at, part in enumerate(places):
            if isinstance(part, str):
                _check_table((name, at), part, sizes)
                self._whole.add(part)
            else:
                table, file, run = _run((name, at), part, sizes)
                runs[table, file].append(run)
        self._runs = {place: joined(ranges) for place, ranges in runs.items()}

    def has_table(self, table: str) -> bool:
        """Return True if any item of a table is among them; "" is no table, which may be."""
        return not table or table in self._whole or any(table == name for name, _ in self._runs)

    def cover(self, access: Access) -> bool:
        if access.table in self._whole:
            return True
        ranges = self._runs.get((access.table, access.file), ())
        return contains(ranges, access.address, access.count)


def _listed(name: str, items: object, everything: Iterable[str]) -> tuple[Any, ...]:
    if items == "all":
        return tuple(everything)
    if isinstance(items, str) or not isinstance(items, Iterable):
        raise WrongType(name, f'must be "all" or a list, not {reprlib.repr(items)}')
    return tuple(items)


def _check_table(name: Path, table: object, sizes: Mapping[str, int]) -> None:
    if not isinstance(table, str) or table not in sizes:
        names = f"one of {', '.join(sizes)}"
        raise WrongValue.about(name, f"the table must be {names}, not {reprlib.repr(table)}")


def _run(name: Path, place: Any, sizes: Mapping[str, int]) -> tuple[str, int, range]:
    text = reprlib.repr(place)
    if not isinstance(place, Access):
        raise WrongType(name, f"must be the name of a table or Access(...), not {text}")
    _check_table(name, place.table, sizes)
    if place != Access(place.table, place.address, place.count, file=place.file):
        raise WrongValue.about(name, f"values, unit, peer and role mean nothing in {text}")
    size = sizes[place.table]
    first = integer((*name, "address"), place.address, 0, size - 1)
    count = integer((*name, "count"), place.count, 1, size - first)
    is_file = place.table == "file"
    file = integer((*name, "file"), place.file, 1 if is_file else 0, 0xFFFF if is_file else 0)
    return place.table, file, range(first, first + count)


def _code(at: int, function: object) -> Code:
    """Return a function code and its sub-function or MEI type, None for all."""
    name = ("functions", at)
    code, sub = function, None
    if isinstance(function, str):
        parts = re.fullmatch(r"([0-9]{1,3})/([0-9]{1,5})", function)
        if parts is None or int(parts[2]) > SUB_FUNCTIONS.get(int(parts[1]), -1):
            rule = 'must be a code, or such as "8/0" or "43/14"'
            raise WrongValue(name, f"{rule}, not {reprlib.repr(function)}")
        code, sub = int(parts[1]), int(parts[2])
    number = integer(name, code, 1, 127)
    if pdu.REQUESTS.get(number) in ACCESSES:
        raise WrongValue.about(name, f"{number} touches tables: allow them by read and write")
    return number, sub


def _sub_function(request: pdu.Request[Any]) -> int | None:
    if isinstance(request, pdu.Diagnostics):
        return request.sub_function
    # The MEI type, which is the second byte in both classes of this function.
    return request.encode()[1] if request.function == pdu.EncapsulatedTransport.function else None


# --- warnings that clients cause ------------------------------------------------------------

INTERVAL_S = 60.0
"""Seconds between two lines or events of the same kind."""

MAX_REASONS = 100
"""Messages and reasons with lines of their own; further reasons share the line of their message."""


@dataclass(slots=True)
class _Reason:
    message: str
    ends: float  # the time from which on another line may be logged
    count: int = 0  # messages of this reason since the last line
    latest: tuple[object, ...] = ()


class LimitedLog:
    """
    Logs the first warning of a message and a reason at once, and then a line a minute at most: the
    latest one, with their number. This line comes when the minute is over, within `in_time`;
    elsewhere with the next warning after it. `clock` is used where no event loop has a time.
    """

    def __init__(self, logger: HarmlessLogger, clock: Callable[[], float] = time.monotonic) -> None:
        self._logger = logger
        self._clock = clock
        self._reasons: dict[tuple[str, str], _Reason] = {}

    def warning(self, message: str, *args: object, reason: str = "") -> None:
        """Log a warning, or count it; `reason` is the part of it that makes it another one."""
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:
            loop = None
        now = self._clock() if loop is None else loop.time()
        key = message, reason
        if key not in self._reasons and len(self._reasons) >= MAX_REASONS:
            self._log_counts(now)
            if len(self._reasons) >= MAX_REASONS:
                key = message, ""
        entry = self._reasons.setdefault(key, _Reason(message, now))
        entry.count, entry.latest = entry.count + 1, args
        if now >= entry.ends:
            self._log(entry, now)
        elif loop is not None and (timers := _timers.get(loop)) is not None:
            key_of_timer = self, entry.ends  # one timer for all reasons of that time
            if key_of_timer not in timers:
                timers[key_of_timer] = loop.call_at(entry.ends, self._end_minute, loop, entry.ends)

    def _end_minute(self, loop: asyncio.AbstractEventLoop, ends: float) -> None:
        del _timers[loop][self, ends]
        self._log_counts(ends)

    def _log_counts(self, now: float) -> None:
        """Log what was counted in minutes that are over, and forget reasons without any."""
        for key, entry in list(self._reasons.items()):
            if now >= entry.ends:
                if entry.count:
                    self._log(entry, now)
                else:
                    self._reasons.pop(key, None)

    def _log(self, entry: _Reason, now: float) -> None:
        if entry.count == 1:
            self._logger.warning(entry.message, *entry.latest)
        else:
            text = f"{entry.message}; %d since the last line like this"
            self._logger.warning(text, *entry.latest, entry.count)
        entry.count, entry.ends = 0, now + INTERVAL_S


_timers: dict[asyncio.AbstractEventLoop, dict[tuple[LimitedLog, float], asyncio.TimerHandle]] = {}


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    """Let all logs that are used in this event loop log in time while the block runs."""
    loop = asyncio.get_running_loop()
    _timers.setdefault(loop, {})
    try:
        yield
    finally:
        for timer in _timers.pop(loop, {}).values():
            timer.cancel()
