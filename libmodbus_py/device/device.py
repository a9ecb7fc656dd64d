"""
A device: request PDU in, response PDU out.

Functions of libmodbus are answered from the mapping by its modbus_reply (`reply`), after the exact
checks that it lacks; the rest by the methods here. All state is the device's own: two devices share
nothing.
"""

from __future__ import annotations

import os
import reprlib
from collections.abc import Callable, Iterable, Sequence
from collections.abc import Mapping as MappingABC
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypedDict, Unpack

from ..binding.library import Answered, WatchedRequests, answer_in_c, make_tally, replier, reply
from ..protocol.checks import integer
from ..protocol.errors import (
    ExceptionResponse,
    IllegalDataAddress,
    IllegalFunction,
    ServerDeviceFailure,
)
from ..protocol.logs import HarmlessLogger
from ..protocol.mistakes import named_arguments, named_parameters
from ..protocol.pdu import (
    MAX_PDU,
    REQUESTS,
    Diagnostics,
    Request,
    ServerId,
    SubFunction,
    decode_request,
)
from ..protocol.tables import joined, without
from .access import (
    ACCESSES,
    Access,
    Accesses,
    Auditor,
    Caller,
    ExecutedRequest,
    changes_of,
    touched,
    values_at,
)
from .authorization import Authorization, Authorize, ClientRequest, UnauthorizedError
from .event_log import EventLog
from .functions import DEFAULT_SERVER_ID, Handlers, PythonFunctions
from .hooks import Hook, HookLike, Hooks
from .mapping import Mapping, Table
from .named_values import NamedValues, PointIndex, PointRules, RuledCells, zeros_for
from .records import Records

if TYPE_CHECKING:
    from ..maps.register_map import RegisterMap

logger: HarmlessLogger = HarmlessLogger(__name__)

_RESTART = Diagnostics(SubFunction.RESTART_COMMUNICATIONS).encode()[:3]

_UNKNOWN = Caller()


class DeviceOptions(TypedDict, total=False):
    """The arguments of a `Device` besides its tables and points."""

    files: MappingABC[int, Records] | None
    fifos: MappingABC[int, Sequence[int]] | None
    identification: MappingABC[str | int, str | bytes] | None
    server_id: ServerId
    exception_status: int
    canopen: Callable[[bytes], bytes] | None
    handlers: Handlers | None
    before_write: HookLike | None
    after_write: HookLike | None
    before_read: HookLike | None
    authorize: Authorize | None


@named_arguments
class Device(NamedValues, PythonFunctions):
    """
    A device that answers the requests of one unit. It may be used from any thread.

    With `points`, ``device["setpoint"]`` is the value of a point, as `Point.decode` returns it,
    and ``device["setpoint"] = 21.5`` sets it. This is the device's own access: it may also set
    points that clients can only read, and calls no hooks. Requests of clients are restricted to the
    points: they get exception 2 (illegal data address) for a cell that they may not read or write,
    and exception 3 (illegal data value) for a write that would leave a point outside its `minimum`
    and `maximum`, even if it writes only some of its registers. Both are checked before any hook
    is called. A cell that belongs to several points may be read if one of them may be read; the
    same applies to writes. A write of a scale (`scale_from`) does not check the points that it
    scales.

    A subclass may override `answer`, which is then called for every request: C answers none.

    Hooks are called with an `Access` while the mapping is locked. They run in the server's loop, so
    they should be quick: the first call that takes 0.1 s or more is logged. If a hook raises an
    ExceptionResponse, the request is refused with it. Any other exception is logged once, and the
    request gets exception 4; SystemExit and KeyboardInterrupt are passed on. Hooks are only called
    for accesses to existing addresses. The same holds for `canopen` and `handlers`.

    `authorize` is called first for every request, while the mapping is locked: before the hooks,
    and before the client learns which addresses exist. If it returns False, the request gets
    exception 1 (MB-TCP-Security-v36, R-31). An exception that it raises is treated like one of a
    hook; any result other than True or False is a mistake, and the request gets exception 4.
    For a request that cannot be decoded, it gets the function code.

    Args:
        mapping: the four tables.
        files: ``{file number 1..65535: records}``, records as for `RecordFile`, such as
            ``{4: 100}`` for the records 0..99 of file 4, all 0.
        fifos: ``{pointer address 0..65535: registers}``, up to 31 in each.
        identification: ``{object: value}``; objects are names such as
            "VendorName" or ids 0..6, 128..255, values up to 244 bytes or ASCII
            text. The three mandatory objects have defaults.
        server_id: the response to function 17.
        exception_status: the response to function 7, 0..255.
        canopen: called with the data of function 43/13; returns the data of the response.
        handlers: ``{request class: function}`` for classes that were registered
            with `pdu.register`: the function is called with the request and returns its result.
        before_write: ``def before_write(access: Access) -> None``, or a `Hook` with such a
            function: called before a write, which it may refuse.
        after_write: the same, called after a write.
        before_read: the same, called before a read; it may refresh the values or refuse. For
            function 23 it is called before the write, because nothing may be refused after a
            change.
        authorize: called with a `ClientRequest`; returns True if it is allowed. `Rules` are such a
            function. None allows all requests.
        points: names, access and bounds of values in the tables, whose cells must all exist; None
            for no points.

    Attributes:
        mapping, server_id, exception_status, files, fifos: as given; they may be set, and are
            checked like the arguments. `files` is ``{file number: RecordFile}``, with all records
            that clients wrote, and `fifos` ``{pointer address: FifoQueue}``, whose queues the
            program may change like lists.
        diagnostic_register: the response to sub-function 2 of function 8, 0..65535.
        in_c: the function codes that `answer_chunk` may answer.

    Raises:
        TypeError, ValueError: an argument or an attribute of the wrong type or range.
        AttributeError: another argument is set as an attribute.
    """

    def __init__(
        self,
        mapping: Mapping,
        *,
        files: MappingABC[int, Records] | None = None,
        fifos: MappingABC[int, Sequence[int]] | None = None,
        identification: MappingABC[str | int, str | bytes] | None = None,
        server_id: ServerId = DEFAULT_SERVER_ID,
        exception_status: int = 0,
        canopen: Callable[[bytes], bytes] | None = None,
        handlers: Handlers | None = None,
        before_write: HookLike | None = None,
        after_write: HookLike | None = None,
        before_read: HookLike | None = None,
        authorize: Authorize | None = None,
        points: RegisterMap | None = None,
    ) -> None:
        NamedValues.__init__(self, mapping, points)
        PythonFunctions.__init__(
            self, files, fifos, identification, server_id, exception_status, canopen, handlers
        )
        self._guard = None if authorize is None else Authorization(authorize)
        self._log = EventLog(is_serial=False)
        self._tally = make_tally()
        self._failed: set[int] = set()
        self.change_hooks(before_write, after_write, before_read)

    # Called before `before_read`; that of a subclass.
    _refresh_hook: Hook | None = None

    @named_parameters
    def change_hooks(
        self,
        before_write: HookLike | None = None,
        after_write: HookLike | None = None,
        before_read: HookLike | None = None,
    ) -> None:
        """
        Replace all three hooks, from any thread, even while a server runs.

        Raises:
            TypeError: one is neither a function nor a `Hook`; nothing has changed.
        """
        hooks = Hooks(before_write, after_write, before_read, self._refresh_hook)
        with self._mapping.lock:  # no request is answered meanwhile
            self._hooks = hooks
            self._failed.clear()
            self._arrange()

    def _arrange(self) -> None:
        """Find the requests that rules, hooks and handlers need; C may answer all others."""
        rules = PointRules(self._ruled_cells(), lambda: self.points)
        self._rules = rules if rules.reads or rules.writes else None
        reads, writes = (
            {table: joined([*places[table], *more.get(table, ())]) for table in places}
            for places, more in (
                (self._hooks.reads, rules.reads),
                (self._hooks.writes, rules.writes),
            )
        )
        # Request class -> the rule that finds the accesses for rules and hooks.
        self._finds = {
            request: kind.find
            for request, kind in ACCESSES.items()
            if reads.get(kind.reads) or writes.get(kind.writes)
        }
        self._in_c: frozenset[int] = frozenset(
            request.function
            for request, kind in ACCESSES.items()
            if request not in self._handlers
            and not self._is_whole(kind.reads, reads.get(kind.reads, ()))
            and not self._is_whole(kind.writes, writes.get(kind.writes, ()))
        )
        if self._guard is not None or self._has_another_answer():
            self._in_c = frozenset()
        self._watched = WatchedRequests(self._in_c, reads, writes)

    @property
    def in_c(self) -> frozenset[int]:
        """
        The function codes that `answer_chunk` may answer: all functions of libmodbus, except those
        with a handler, and those for which hooks or rules are called at all addresses of their
        table; empty if requests are authorized, or a subclass answers them.
        """
        return self._in_c

    def _has_another_answer(self) -> bool:
        """Return True if `answer` is that of a subclass or of a test, which C must not go round."""
        return getattr(self.answer, "__func__", None) is not _ANSWER

    def _is_whole(self, table: str, ranges: tuple[range, ...]) -> bool:
        return bool(ranges) and not without(getattr(self.mapping, table).ranges, ranges)

    @classmethod
    def of_map(
        cls,
        map: RegisterMap | str | os.PathLike[str],
        values: MappingABC[str, Any] | None = None,
        **options: Unpack[DeviceOptions],
    ) -> Self:
        """
        Return a device that has the cells of all points of a map, and no others.

        Args:
            map: the points, or the path of their file, which `load_map` reads.
            values: initial values by name, such as ``{"setpoint": 21.5}``; those of other points
                are their `initial`, or have cells that are 0.
            options: the other arguments of `Device`.

        Raises:
            KeyError: the map has no such point.
            TypeError, ValueError: a value does not fit its point, or an argument is wrong.
            FileError: a ValueError: the file cannot be read, or contains a mistake.
        """
        from ..maps.register_map import map_of

        points = map_of(map)
        device = cls(zeros_for(points), points=points, **options)
        device.update(points.initial)
        device.update(values or {})
        return device

    def save(self, path: str | os.PathLike[str]) -> None:
        """
        Write the values of all tables and files to a file, readable by its owner only if it is new.

        Raises:
            OSError: it cannot be written, or is no regular file; a file there is unchanged.
        """
        from .state import replace_file, state_text, unit_text  # which few programs need

        replace_file(path, state_text([unit_text(None, self)]))

    def load(self, path: str | os.PathLike[str]) -> None:
        """
        Set all values to those of a file that `save` wrote, either all of them or none.

        Values that the file does not contain are set to 0. No hook is called.

        Raises:
            OSError: the file cannot be read.
            ValueError: the file is damaged, of a newer version, or has values for what does not
                exist here; the message names the file and the key.
        """
        from .state import load_state, read_text

        load_state(os.fspath(path), read_text(path), {None: self})

    def first_values(self) -> Iterable[Access]:
        """Return the first values that are not 0, which `save` leaves out: none."""
        return ()

    def answer(self, pdu: bytes, caller: Caller = _UNKNOWN) -> bytes:
        """
        Execute a request.

        Args:
            pdu: the request, 1..253 bytes.
            caller: the origin of the request.

        Returns:
            The response, which may be an exception response. Empty for broadcasts, in listen-only
            mode, and for function codes 128..255, for which there is no exception response.

        Raises:
            SystemExit, KeyboardInterrupt: a hook or handler raised it.
        """
        function = pdu[0]
        log = caller.log or self._own_log()
        if function & 0x80:
            if not log.is_serial:
                log.note_frame()
            return b""
        is_broadcast, listening = caller.is_broadcast, log.listen_only
        log.note_request(broadcast=is_broadcast)
        restart = pdu[:3] == _RESTART and not is_broadcast
        may_be_broadcast = getattr(REQUESTS.get(function), "may_be_broadcast", False)
        if (listening and not restart) or (is_broadcast and not may_be_broadcast):
            response = b""
        elif caller.auditor is None:
            response = self._respond(pdu, log, caller)
        else:
            response = self._respond_audited(pdu, log, caller, caller.auditor)
        silent = is_broadcast or listening or log.listen_only
        log.note_response(pdu, response, silent=silent)
        if restart and response[:1] == pdu[:1]:
            # The answer is sent before the restart, so that only what came after is counted.
            log.restart(clear_log=pdu[3:] == b"\xff\0")
        return b"" if silent else response

    def answer_chunk(self, data: bytes, start: int, unit: int) -> Answered:
        """
        Execute requests of Modbus/TCP to a unit with the functions `in_c`, from ``data[start]`` on,
        up to the first that needs `answer`, because it has a hook or is for another unit.

        Returns:
            The index of the first byte that was not used; the responses; the number of requests
            that were executed; and how many of them were refused.

        Raises:
            TypeError, ValueError: `start` or `unit` is outside its range.
            ModbusConnectionError: libmodbus failed in memory.
        """
        if not (0 <= start <= len(data) and 0 <= unit <= 0xFF):  # C does not check these numbers
            start = integer("start", start, 0, len(data))
            unit = integer("unit", unit, 0, 0xFF)
        if self._has_another_answer():
            return start, b"", 0, 0
        with self._mapping.lock:
            return answer_in_c(
                replier(), self._mapping._struct, self._watched, self._tally, unit, data, start
            )

    def refuse(self, pdu: bytes, code: int, caller: Caller = _UNKNOWN) -> bytes:
        """Refuse a request with an exception, 1..255, without executing it; return the response."""
        log = caller.log or self._own_log()
        log.note_request(broadcast=False)
        refusal = bytes([pdu[0] | 0x80, code])
        log.note_response(pdu, refusal, silent=False)
        return refusal

    def refresh(self, table: str, address: int, count: int) -> None:
        """
        Call `before_read`, if there is one, for a program that reads values without a request.

        It is called in this thread, with an `Access` to `count` items of a table such as "coils",
        from a 0-based address on, without unit, peer and role. Exceptions of the hook are raised.
        """
        with self.mapping.lock:
            self._hooks.before(Accesses(reads=(Access(table, address, count, device=self),)))

    def _own_log(self) -> EventLog:
        """Return the notes about TCP, including those made in C."""
        with self.mapping.lock:
            tally = self._tally
            if requests := tally.requests:
                size = len(tally.was_refused)
                latest = [tally.was_refused[n % size] for n in range(requests)[-size:]]
                self._log.note_exchanges(requests, tally.refused, latest)
                tally.requests = tally.refused = 0
        return self._log

    def _respond_audited(
        self, pdu: bytes, log: EventLog, caller: Caller, auditor: Auditor
    ) -> bytes:
        """Execute a request, and record it if it changes the device or no rule allows it."""
        try:
            request = decode_request(pdu)
        except Exception:
            request = None
        changes = request is not None and request.changes
        refusals: list[bool] = []
        with self.mapping.lock:
            values = changes_of(request, caller, self.mapping, self.files) if changes else ()
            if changes and not auditor.may_change():
                response = bytes([pdu[0] | 0x80, ServerDeviceFailure.code])
            else:
                response = self._respond(pdu, log, caller.telling(refusals.append))
        # The code of the response does not tell: exception 1 may also come from the function.
        if changes or refusals:
            auditor.note(ExecutedRequest(caller, pdu, response, values, changes))
        return response

    def _respond(self, pdu: bytes, log: EventLog, caller: Caller) -> bytes:
        try:
            try:
                request = decode_request(pdu)
            except Exception:
                # A client without the right to this function learns nothing else of the request.
                with self.mapping:
                    self._authorize(pdu[0], None, caller)
                raise
            return self._execute(request, pdu, log, caller)
        except ExceptionResponse as refusal:
            if isinstance(refusal.code, int) and 1 <= refusal.code <= 0xFF:
                return bytes([pdu[0] | 0x80, refusal.code])
            self._log_failure(pdu)
        except (SystemExit, KeyboardInterrupt):  # raised to end the process
            raise
        # CancelledError, GeneratorExit and similar ones, too: an exception of a hook concerns this
        # request only, and must not reach the requests of others.
        except BaseException:
            self._log_failure(pdu)
        return bytes([pdu[0] | 0x80, ServerDeviceFailure.code])

    def _authorize(self, function: int, request: Request[Any] | None, caller: Caller) -> None:
        if self._guard is None:
            return
        accesses = touched(request, caller.who, self.mapping)
        details = ClientRequest(caller.role, caller.unit, caller.peer, function, request, *accesses)
        try:
            self._guard.check(details)
        except BaseException as error:
            if caller.on_unauthorized is not None:
                caller.on_unauthorized(isinstance(error, UnauthorizedError))
            raise

    def _execute(self, request: Request[Any], pdu: bytes, log: EventLog, caller: Caller) -> bytes:
        handle = self._handlers.get(type(request))
        find = self._finds.get(type(request))
        sides = None
        with self.mapping.lock:
            if self._guard is not None:
                self._authorize(request.function, request, caller)
            if find is not None:
                sides = writes, reads = find(request, self.mapping, caller.who)
                for access in writes + reads if writes else reads:
                    self._check_exists(access)
                if self._rules is not None:
                    self._rules.check(sides, self.mapping)
                if not self._hooks.is_empty:
                    if writes or self.has_points:
                        sides = Accesses(*(tuple(map(self._described, side)) for side in sides))
                    else:
                        for access in reads:  # of this request alone; a copy is a third of its cost
                            object.__setattr__(access, "device", self)
                    self._hooks.before(sides)
            if handle is not None:
                response = request.encode_response(handle(self, request, log))
                if not isinstance(response, bytes) or not 1 <= len(response) <= MAX_PDU:
                    raise ValueError(f"not a response PDU: {reprlib.repr(response)}")
            elif type(request) in ACCESSES:
                response = reply(pdu, self.mapping._struct)
            else:
                raise IllegalFunction(function=request.function)
            if sides is not None and sides.writes:
                self._hooks.after(sides)
        return response

    def _log_failure(self, pdu: bytes) -> None:
        """Log a failure once for each function: a client must not be able to fill the log."""
        if pdu[0] not in self._failed:
            self._failed.add(pdu[0])
            logger.exception("request %s failed; answered with exception 4", pdu.hex(" "))

    def _described(self, access: Access) -> Access:
        """Return an access with the names of its points, the values before, and the device."""
        names: tuple[str, ...] = ()
        if self.has_points:
            names = tuple(point.name for point in self._index.touched(access))
        before = values_at(access, self.mapping, self.files) if access.values else None
        return replace(access, names=names, old_values=before or (), device=self)

    @cached_property
    def _index(self) -> PointIndex:
        return PointIndex(map(RuledCells.of, self.points.values()))

    def _ruled_cells(self) -> Iterable[RuledCells]:
        """Return the cells that have a rule: those of all points."""
        return map(RuledCells.of, self.points.values()) if self.has_points else ()

    def _check_exists(self, access: Access) -> None:
        if access.table == "file":
            self._file(access.file, access.address, access.count)
        elif access.table == "fifo":
            self._fifo(access.address)
        else:
            table: Table[Any] = getattr(self.mapping, access.table)
            if not table.has(access.address, access.count):
                raise IllegalDataAddress(f"{table} lacks {access.address}+{access.count}")


_ANSWER = Device.answer
