"""
Fault injection by count: the n-th call of one kind fails, for every n until a run makes no n-th.

A scenario runs the unmodified package over real sockets, pseudo-terminals and threads. Calls of
the system are wrapped where Python code makes them; a call counts if the innermost code that is
neither Python's own library nor this file belongs to the part on trial. Peers of the package that
live in the same process are in `tests.support`, and never fail.
"""

import _thread
import contextlib
import errno
import fcntl
import gc
import logging
import os
import select
import selectors
import socket
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError
from tests.support.leaks import LOOPS, Snapshot, remaining_leaks

Error = Callable[[], Exception]


def system(number: int) -> Error:
    """Return a function that makes the OSError of this number."""
    return lambda: OSError(number, os.strerror(number))


def settings_error() -> Exception:
    return termios.error(errno.EIO, os.strerror(errno.EIO))


def no_thread() -> Exception:
    return RuntimeError("can't start new thread")


def unresolved() -> Exception:
    return socket.gaierror(socket.EAI_MEMORY, "Memory allocation failure")


NO_DESCRIPTOR = tuple(map(system, (errno.EMFILE, errno.ENFILE, errno.ENOMEM)))
NO_SEND = tuple(map(system, (errno.ECONNRESET, errno.EPIPE, errno.ENOBUFS, errno.ENETDOWN)))
NO_ACCEPT = (*NO_DESCRIPTOR, *map(system, (errno.ECONNABORTED, errno.ENETDOWN, errno.EPERM)))
NO_RECEIVE = tuple(map(system, (errno.ECONNRESET, errno.ENETDOWN, errno.EIO)))


@dataclass(frozen=True)
class Kind:
    """Calls that fail alike: wrapped functions of an owner, and their possible exceptions."""

    name: str
    owner: Any
    names: tuple[str, ...]
    errors: tuple[Error, ...]
    of_loops: bool = False  # calls that event loops make for themselves count, too


KINDS: tuple[Kind, ...] = (
    Kind("socket", socket.socket, ("__init__",), NO_DESCRIPTOR),
    Kind("pair", socket, ("socketpair",), NO_DESCRIPTOR),
    Kind("resolve", socket, ("getaddrinfo",), (unresolved, system(errno.EMFILE))),
    Kind("connect", socket.socket, ("connect", "connect_ex"), (system(errno.ENETUNREACH),)),
    Kind("bind", socket.socket, ("bind",), (system(errno.EADDRINUSE),)),
    Kind("listen", socket.socket, ("listen",), (system(errno.EADDRINUSE),)),
    Kind("accept", socket.socket, ("accept",), NO_ACCEPT),
    Kind("send", socket.socket, ("send", "sendto", "sendall"), NO_SEND),
    Kind("receive", socket.socket, ("recv", "recvfrom", "recv_into"), NO_RECEIVE),
    Kind("set", socket.socket, ("setsockopt", "getsockopt"), (system(errno.EINVAL),)),
    Kind("shut down", socket.socket, ("shutdown",), (system(errno.ENOTCONN),)),
    Kind("open", os, ("open", "dup"), (*NO_DESCRIPTOR, system(errno.EACCES))),
    Kind("write", os, ("write",), (system(errno.EIO), system(errno.ENOSPC))),
    Kind("read", os, ("read",), (system(errno.EIO),)),
    Kind("settings", termios, ("tcgetattr", "tcsetattr", "tcflush"), (settings_error,)),
    Kind("control", fcntl, ("flock", "ioctl", "fcntl"), (system(errno.EIO),)),
    Kind("eventfd", os, ("eventfd",), NO_DESCRIPTOR),
    Kind("pipe", os, ("pipe", "pipe2"), NO_DESCRIPTOR),
    Kind("epoll", select, ("epoll",), NO_DESCRIPTOR, of_loops=True),
    Kind("loop", selectors.EpollSelector, ("_selector_cls",), NO_DESCRIPTOR, of_loops=True),
    Kind("watch", selectors.EpollSelector, ("register", "modify"), (system(errno.ENOSPC),)),
    Kind("thread", threading.Thread, ("start",), (no_thread,), of_loops=True),
    Kind("bare thread", _thread, ("start_new_thread",), (no_thread,)),
)

CONNECTION = (ModbusConnectionError,)

# Of `socket.socket.__init__`, how many arguments there are if the last is a descriptor.
FILENO = 5

# Seconds: for all to be well again, and between two looks.
LONGEST, GLANCE = 20.0, 0.005

LIBRARY = sys.stdlib_module_names
PACKAGE = "libmodbus_py"


class Counting:
    """Counts the calls of one kind that the part on trial makes, and fails the n-th."""

    def __init__(self, kind: Kind, part: tuple[str, ...], count: int, make: Error) -> None:
        self.error: Exception | None = None  # what was raised
        self.place = ""  # the code that met it
        self._kind = kind
        self._part = part
        self._left = count
        self._make = make
        self._lock = threading.Lock()
        self.is_armed = False

    def meet(self) -> None:
        """Count a call; raise if it is the n-th."""
        if not self.is_armed or not (place := self._place(sys._getframe(2))):
            return
        with self._lock:
            self._left -= 1
            if self._left != 0:
                return
            self.error, self.place = self._make(), place
        raise self.error

    def _place(self, frame: FrameType | None) -> str:
        """Return the part of the package that makes this call, if any."""
        while frame is not None:
            name = frame.f_globals.get("__name__", "")
            root = name.partition(".")[0]
            if root == "asyncio" and not self._kind.of_loops and not _is_adding(frame):
                return ""
            if name != __name__ and root not in LIBRARY:
                is_of_part = name.startswith(self._part)
                return f"{name}:{frame.f_lineno}" if is_of_part else ""
            frame = frame.f_back
        return ""


def _is_adding(frame: FrameType) -> bool:
    """Return whether a loop does what the package asks of it at this moment."""
    code = frame.f_code.co_name.lstrip("_")
    return code.startswith(("add_reader", "add_writer", "remove_reader", "remove_writer", "ensure"))


@contextlib.contextmanager
def counting(kind: Kind, part: tuple[str, ...], count: int, make: Error) -> Iterator[Counting]:
    """Wrap the calls of a kind."""
    counter = Counting(kind, part, count, make)
    with pytest.MonkeyPatch.context() as patch:
        for name in kind.names:
            patch.setattr(kind.owner, name, _wrapped(counter, getattr(kind.owner, name)))
        yield counter


def _wrapped(counter: Counting, real: Callable[..., Any]) -> Callable[..., Any]:
    def wrapped(*arguments: Any, **options: Any) -> Any:
        if not ("fileno" in options or len(arguments) == FILENO):  # a socket that exists already
            counter.meet()
        return real(*arguments, **options)

    # What stands in a class as a class, such as `_selector_cls`, is called without its owner.
    return staticmethod(wrapped) if isinstance(real, type) else wrapped


class Complaints(logging.Handler):
    """What event loops, threads and the garbage collector complain of."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else ""
        self.texts.append(f"logged: {record.getMessage()} {error!r}")

    def thread(self, hook: threading.ExceptHookArgs) -> None:
        name = hook.thread.name if hook.thread else ""
        self.texts.append(f"a thread ended: {name}: {hook.exc_value!r}")

    def garbage(self, hook: Any) -> None:
        if "BaseEventLoop.__del__" in f"{hook.object!r} {hook.err_msg}":
            return  # CPython's own: an event loop that could not be made cannot be closed either
        self.texts.append(f"ignored: {hook.err_msg or hook.object!r}: {hook.exc_value!r}")


@contextlib.contextmanager
def complaints() -> Iterator[Complaints]:
    """Collect log messages."""
    result = Complaints()
    logger = logging.getLogger("asyncio")
    logger.addHandler(result)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading, "excepthook", result.thread)
        patch.setattr(sys, "unraisablehook", result.garbage)
        try:
            yield result
        finally:
            logger.removeHandler(result)


@dataclass
class Trial:
    """One run of a scenario, and its failures."""

    counting: Counting
    problems: list[str] = field(default_factory=list)

    @contextlib.contextmanager
    def faults(self, *errors: type[BaseException]) -> Iterator[None]:
        """Let the call fail in this block; ModbusConnectionError, or what is allowed, says so."""
        self.counting.is_armed = True
        try:
            yield
        except CONNECTION as error:
            self._check(error)
        except errors:
            pass
        except BaseException as error:
            if self.counting.error is None:
                raise
            self.problems.append(f"raised {error!r}")
        finally:
            self.counting.is_armed = False

    def _check(self, error: ModbusConnectionError) -> None:
        """Check that a connection was lost for this reason, or because the other side closed it."""
        cause = self.counting.error
        if cause is None and error.errno == errno.ETIMEDOUT:
            return  # the machine is busy, and a scenario has no patience
        if cause is None:
            self.problems.append(f"raised without a fault: {error!r}")
        elif not str(error).strip() or "None" in str(error):
            self.problems.append(f"says nothing: {error!r}")
        elif isinstance(cause, OSError) and error.errno is None:
            self.problems.append(f"has no number: {error!r}")


Scenario = Callable[[Trial], None]


def eventually(is_so: Callable[[], object]) -> bool:
    """Wait until a condition holds, however busy the machine is."""
    until = time.monotonic() + LONGEST
    while not is_so():
        if time.monotonic() > until:
            return False
        time.sleep(GLANCE)
    return True


def try_faults(
    scenario: Scenario, *part: str, errors: int | None = None, without: str | None = None
) -> None:
    """
    Run a scenario with every fault there is; fail with all that went wrong, each with its fault.
    """
    begins = tuple(f"{PACKAGE}.{byte}" if byte else PACKAGE for byte in part)
    problems: list[str] = []
    reached = 0
    scenario(Trial(Counting(KINDS[0], begins, 0, no_thread)))  # modules are imported once, here
    gc.collect()
    gc.freeze()
    for kind in KINDS:
        if kind.name == without:
            continue
        for make in kind.errors[:errors]:
            count = 1
            while _one(scenario, kind, begins, count, make, problems):
                reached += 1
                count += 1
    assert reached, "no fault was reached"
    assert not problems, "\n".join(problems)


def _one(
    scenario: Scenario, kind: Kind, part: tuple[str, ...], count: int, make: Error, texts: list[str]
) -> bool:
    """Return True if the call with this number was made."""
    LOOPS.begin()
    before = Snapshot.taken()
    with complaints() as complaints_, counting(kind, part, count, make) as counter:
        trial = Trial(counter)
        try:
            scenario(trial)
        except (Exception, pytest.fail.Exception) as error:
            trial.problems.append(f"afterwards: {error!r} {_line_of(error)}")
        if counter.error is not None:
            counter.error.__traceback__ = None  # it holds objects of the package
        problems = [*trial.problems, *remaining_leaks(before, LOOPS.names()), *complaints_.texts]
    where = f"{kind.name} {count}, {counter.error!r} at {counter.place}"
    texts += [f"{where}: {problem}" for problem in problems]
    return counter.error is not None


def _line_of(error: BaseException) -> str:
    traceback = error.__traceback__
    lines = []
    while traceback is not None:
        frame = traceback.tb_frame
        lines.append(f"{frame.f_globals.get('__name__', '')}:{traceback.tb_lineno}")
        traceback = traceback.tb_next
    return " ".join(lines[-3:])
