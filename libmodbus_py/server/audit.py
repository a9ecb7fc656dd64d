"""
The audit trail: who wrote what, and who was refused, for security officers.

Servers and gateways report to one `Audit`, which calls a function with each event, or writes it to
a file (`AuditFile`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import os
import re
import select
import stat
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from ..device.access import ExecutedRequest, ValueChange
from ..device.authorization import INTERVAL_S
from ..protocol.checks import checked_callback, finished
from ..protocol.errors import ExceptionResponse
from ..protocol.json_text import json_line
from ..protocol.logs import HarmlessLogger
from ..protocol.mistakes import named_arguments
from ..protocol.plain import time_text
from ..security.certificates import CertificateHolder
from ..system import open_file

logger: HarmlessLogger = HarmlessLogger(__name__)

REMEMBERED_MAX = 1000
"""Events that wait while they cannot be written; and disallowed hosts that were seen."""

ROOM_BYTES = 65_536
"""Bytes that a disk must have left before a change: more than the longest event."""

FIRST_LINE = re.compile(rb'\n*(\{"time": "[^"\n]*", "event": "|\Z)')
"""Matches the beginning of an audit trail."""


@dataclass(frozen=True, slots=True)
class AuditEvent:
    """
    One entry of an audit trail.

    Attributes:
        time: when it happened, in UTC.
        event: "write", a request that changes a device, executed or not; "refused", any other
            request that `authorize` does not allow; "handshake", a TLS handshake that failed;
            "logon", one that succeeded; "ended", a connection that was closed because its
            certificate is not accepted any more; "disallowed", a connection from a network that is
            not served. Of the server itself: "start" and "stop", with the endpoint as the result;
            "renewed", its own certificate; "reload", with what changed; "audit", the file of the
            audit trail was opened again.
        peer: the client: "192.0.2.7:51234", "[2001:db8::7]:51234", the serial port,
            or the path of a Unix socket with the client's user and process; empty for events of the
            server itself.
        result: "ok"; "sent" for a broadcast; "no answer"; the exception; or why a connection was
            refused.
        unit, function: those of the request; None without a request.
        subject, serial, issuer, fingerprint: those of the certificate, the client's, refused or
            not, or of "renewed" the server's own; the fingerprint is the SHA-256. None without a
            certificate.
        role: the role in the certificate; None without a role.
        changes: the values that the request writes, and the previous ones. Empty if the function
            has no addresses.
        data: the request PDU in hexadecimal digits; empty without a request.
    """

    time: datetime
    event: str
    peer: str
    result: str
    unit: int | None = None
    function: int | None = None
    subject: str | None = None
    serial: str | None = None
    issuer: str | None = None
    fingerprint: str | None = None
    role: str | None = None
    changes: tuple[ValueChange, ...] = ()
    data: str = ""

    def json(self) -> str:
        """Return the event as one line of JSON, without the newline."""
        fields = dataclasses.asdict(dataclasses.replace(self, changes=()))
        fields["time"] = time_text(self.time.timestamp())
        fields["changes"] = [_change(change) for change in self.changes]
        return json_line(
            {key: value for key, value in fields.items() if value not in (None, "", [])}
        )


def _change(change: ValueChange) -> dict[str, Any]:
    access, before = change
    place = {"file": access.file} if access.table == "file" else {}
    values = {"old": None if before is None else list(before), "new": list(access.values)}
    return {"table": access.table, **place, "address": access.address, **values}


OnAudited = Callable[[AuditEvent], object]


@named_arguments
class Audit:
    """
    Passes events to a function, and notes whether the function succeeds.

    If the function fails, up to 1000 events are kept, and passed to it again before the next one.
    The log gets a message when it begins to fail, and one when it succeeds again, with the number
    of events that were lost.

    Args:
        call: called with an `AuditEvent` in the server's loop, so it should be quick. If it is an
            object with a method `check`, as `AuditFile` is, that is called before each write, and
            raises an exception if its event could not be recorded.
        required: True to refuse writes with exception 4 while `check` or the function fails.
            Without `check`, the first write whose event fails has been carried out.

    Raises:
        TypeError: `call` is not a function.
    """

    def __init__(self, call: OnAudited, *, required: bool = False) -> None:
        self._call = checked_callback("audit", call)
        self._check: Callable[[], object] = getattr(call, "check", lambda: None)
        self._required = required
        self._waiting: deque[AuditEvent] = deque()
        self._lost = 0
        self._is_failing = False
        self._disallowed: dict[str, float] = {}

    def may_change(self) -> bool:
        """Return False if changes must be refused, because none can be recorded."""
        if not self._required:
            return True
        if self._waiting:
            self._pass_on()
            return not self._waiting
        try:
            self._check()
        except Exception as error:
            self._fail(error)
            return False
        return True

    def note(self, request: ExecutedRequest) -> None:
        """Record a request that changes a device, or is not allowed. Never raises."""
        caller = request.caller
        self._tell(
            "write" if request.is_change else "refused",
            caller.peer,
            _result(request.response, is_broadcast=caller.is_broadcast),
            caller.holder,
            unit=caller.unit,
            function=request.request[0],
            role=caller.role,
            changes=request.changes,
            data=request.request.hex(),
        )

    def note_peer(
        self,
        event: Literal["handshake", "logon", "ended"],
        peer: str,
        result: str,
        holder: CertificateHolder | None,
        role: str | None = None,
    ) -> None:
        """Record what became of a TLS connection. Never raises."""
        self._tell(event, peer, result, holder, role=role)

    def note_own(
        self,
        event: Literal["start", "stop", "renewed", "reload", "audit"],
        result: str,
        holder: CertificateHolder | None = None,
    ) -> None:
        """Record an event of the server itself. Never raises."""
        self._tell(event, "", result, holder)

    def note_disallowed(self, host: str, peer: str) -> None:
        """Record a connection or datagram from a network that is not served, once a minute."""
        now = time.monotonic()
        if now < self._disallowed.get(host, -INTERVAL_S) + INTERVAL_S:
            return
        self._disallowed.pop(host, None)
        if len(self._disallowed) >= REMEMBERED_MAX:
            del self._disallowed[next(iter(self._disallowed))]
        self._disallowed[host] = now
        self._tell("disallowed", peer, "not in an allowed network", None)

    def _tell(
        self, event: str, peer: str, result: str, holder: CertificateHolder | None, **more: Any
    ) -> None:
        if holder is not None:
            more |= holder._asdict()
        if len(self._waiting) >= REMEMBERED_MAX:
            self._waiting.popleft()
            self._lost += 1
        self._waiting.append(AuditEvent(datetime.now(UTC), event, peer, result, **more))
        self._pass_on()

    def _pass_on(self) -> None:
        while self._waiting:
            try:
                if self._is_failing:
                    self._check()
                finished("audit", self._call(self._waiting[0]))
            except Exception as error:
                self._fail(error)
                return
            self._waiting.popleft()
        if self._is_failing:
            self._is_failing = False
            logger.warning("audit: events are recorded again; %d were lost", self._lost)
            self._lost = 0

    def _fail(self, error: Exception) -> None:
        if not self._is_failing:
            self._is_failing = True
            logger.error("audit: %s: %s", type(error).__name__, error)


def _result(response: bytes, *, is_broadcast: bool) -> str:
    if not response:
        return "sent" if is_broadcast else "no answer"
    if not response[0] & 0x80:
        return "ok"
    return str(ExceptionResponse.of(response[1])) if len(response) > 1 else "no answer"


def audit_of(audit: Audit | OnAudited) -> Audit:
    """Return an audit; a function becomes one. Raises TypeError."""
    return audit if isinstance(audit, Audit) else Audit(audit)


@named_arguments
class AuditFile:
    """
    Appends events to a file, one line of JSON each; pass it to `Audit`, or as `audit`.

    Each line is appended with one system call, so that several programs can share a file. Lines are
    not forced to the disk. If the disk is full in the middle of a line, the line stays incomplete,
    and is written again as a whole later.

    Args:
        path: the path of the file, which is made if it does not exist, readable by its owner only.
            A named pipe needs a reader.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the file contains something else, such as a device file or a key.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path
        self._descriptor = self._opened()
        self._own = os.fstat(self._descriptor)
        self._failure: Exception | None = None  # of the last `reopen`
        self._is_cut = False

    def __call__(self, event: AuditEvent) -> None:
        """
        Write an event.

        Raises:
            OSError: the event could not be written completely; or the file was deleted or moved,
                or could not be opened again.
            ValueError: the file that was to be opened again is not an audit trail.
        """
        self._check_path()
        line = event.json().encode() + b"\n"
        if self._is_cut:  # the last line was cut off: this line must not continue it
            line = b"\n" + line
        size = os.write(self._descriptor, line)
        self._is_cut = size < len(line)
        if self._is_cut:
            raise OSError(f"{os.fspath(self._path)}: the disk is full")

    def check(self) -> None:
        """
        Check that an event can be written to the file that has the path now.

        Raises:
            OSError: the file was deleted or moved, or another one has its path; its disk has less
                than 64 KiB left, or can only be read; a named pipe has no reader, or a slow one;
                the file could not be opened again.
            ValueError: the file that was to be opened again is not an audit trail.
        """
        mode = self._check_path().st_mode
        if stat.S_ISREG(mode):
            disk = os.fstatvfs(self._descriptor)
            if disk.f_flag & os.ST_RDONLY:
                raise self._error(errno.EROFS)
            if disk.f_bavail * disk.f_frsize < ROOM_BYTES and disk.f_blocks:
                raise self._error(errno.ENOSPC)
        elif stat.S_ISFIFO(mode):
            pipe = select.poll()
            pipe.register(self._descriptor, select.POLLOUT)
            events = pipe.poll(0)
            if not events:
                raise self._error(errno.EAGAIN, "the reader of this pipe is too slow")
            if events[0][1] & select.POLLERR:
                raise self._error(errno.EPIPE, "this pipe has no reader")

    def _check_path(self) -> os.stat_result:
        """Return the status of the path, if it is the open file; else OSError or ValueError."""
        if self._failure is not None:
            raise self._failure.with_traceback(None)
        status = os.stat(self._path)
        if not os.path.samestat(status, self._own):
            raise self._error(errno.ESTALE, "another file has this path; open it again")
        return status

    def _error(self, number: int, text: str = "") -> OSError:
        return OSError(number, text or os.strerror(number), os.fspath(self._path))

    def reopen(self) -> None:
        """
        Open the file again, for example after a rotation.

        Raises:
            OSError, ValueError: as for `AuditFile`; nothing is written until this succeeds.
        """
        self.close()
        try:
            self._descriptor = self._opened()
            self._own, self._failure = os.fstat(self._descriptor), None
        except (OSError, ValueError) as error:
            self._failure = error
            raise

    def close(self) -> None:
        """Close the file; may be called any number of times."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def _opened(self) -> int:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC
        # A named pipe whose reader is gone, or slow, must not hold up all clients.
        descriptor = os.open(self._path, flags | os.O_NONBLOCK, 0o600)
        try:
            if stat.S_ISREG(os.fstat(descriptor).st_mode):
                with open_file(self._path) as file:
                    if FIRST_LINE.match(file.read(1000)) is None:
                        path = os.fspath(self._path)
                        raise ValueError(f"{path}: not written, because it is not an audit trail")
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor
