"""
Host names, each looked up in a thread: a look-up ends only when the system gives up, after many
seconds.

All that ask for one name share its thread, so that there are no more threads than names, and none
waits for another. The threads belong to no event loop, whose own would be busy for others, and
would be waited for at its end. A program may end while they wait.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ..system import call_in_children

__all__ = ["Question", "Resolve", "asked", "numeric", "start_thread"]


class Resolve(NamedTuple):
    """Look up a name; yields the result of getaddrinfo, or raises its OSError or TimeoutError."""

    host: str
    port: int
    kind: socket.SocketKind
    deadline: float
    flags: int = 0


class Question:
    """A name that is looked up, for all that ask for it meanwhile."""

    def __init__(self, wanted: Resolve) -> None:
        self._wanted = wanted
        self._found: list[Any] | Exception | None = None
        self.notes: list[Callable[[], object]] = []

    def look_up(self) -> None:
        """Set the result."""
        host, port, kind, _, flags = self._wanted
        try:
            self._found = socket.getaddrinfo(host, port, type=kind, flags=flags)
        except Exception as error:  # whatever it is, those who wait must be told
            self._found = error

    def result(self) -> list[Any]:
        """
        Return the result of getaddrinfo.

        Raises:
            OSError: the name is not known, or cannot be looked up.
        """
        if isinstance(self._found, OSError):
            # Each who asked gets an error of its own, because a traceback belongs to one.
            raise type(self._found)(*self._found.args) from self._found
        if isinstance(self._found, Exception):
            raise OSError(None, str(self._found)) from self._found
        assert self._found is not None
        return self._found


@contextlib.contextmanager
def asked(wanted: Resolve, note: Callable[[], object]) -> Iterator[Question]:
    """
    Look up a name while the ``with`` block runs; leaving it does not wait for the look-up.

    Args:
        note: called in another thread when the question has its result. It must not block.

    Raises:
        OSError: the system has no thread left.
    """
    key = wanted._replace(deadline=0.0)
    with _lock:
        question = _asked.get(key)
        if question is None:
            question = Question(wanted)
            start_thread(
                threading.Thread(target=_work, args=(key, question), name="look-up", daemon=True)
            )
            _asked[key] = question
        question.notes.append(note)
    try:
        yield question
    finally:
        with _lock, contextlib.suppress(ValueError):  # it was called
            question.notes.remove(note)


def _work(key: Resolve, question: Question) -> None:
    question.look_up()
    with _lock:
        if _asked.get(key) is question:
            del _asked[key]
        notes, question.notes = question.notes, []
    for note in notes:
        with contextlib.suppress(Exception):  # a loop that was closed meanwhile
            note()


def numeric(wanted: Resolve) -> list[Any]:
    """Return the result for a numeric address, which needs no look-up and no thread; else []."""
    flags = wanted.flags | socket.AI_NUMERICHOST
    try:
        # As bytes, because for text Python would import its codec for international names.
        return socket.getaddrinfo(wanted.host.encode(), wanted.port, type=wanted.kind, flags=flags)
    except OSError as error:
        if error.errno is None and error.strerror is None:
            raise  # of a signal handler
        return []
    except UnicodeError:
        return []


def start_thread(thread: threading.Thread) -> None:
    """
    Start a thread.

    Raises:
        OSError: the system has no thread left.
    """
    try:
        thread.start()
    except RuntimeError as error:
        raise OSError(errno.EAGAIN, str(error)) from error


def _begin() -> None:
    """In a forked child, too: the threads are its parent's, and one may have held the lock."""
    global _lock, _asked
    # Reentrant, because a signal handler may ask while its own thread does.
    _lock = threading.RLock()
    _asked = {}


_lock: threading.RLock
_asked: dict[Resolve, Question]
_begin()
call_in_children(_begin)
