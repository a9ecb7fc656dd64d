"""
Host names, looked up in threads: a look-up ends only when the system gives up, after many seconds.

The threads belong to no event loop, whose own would be busy for others, and would be waited for at
its end. A program may end while they wait.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ..system import call_in_children

# fmt: off
__all__ = ["MOST_THREADS", "Question", "Resolve", "asked", "no_thread", "numeric", "start_thread"]
# fmt: on

# The number of names that are looked up at the same time; further names wait.
MOST_THREADS = 32


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


class Names:
    """The questions that wait, and the threads that look them up."""

    def __init__(self) -> None:
        # Reentrant, because a signal handler may ask while its own thread does.
        self._lock = threading.RLock()
        self._asked: dict[tuple[Any, ...], Question] = {}
        self._waiting: dict[tuple[Any, ...], Question] = {}
        self._threads: set[threading.Thread] = set()

    def put(self, wanted: Resolve, note: Callable[[], object]) -> Question:
        """
        Ask for a name, or join others who do.

        Raises:
            OSError: the system has no thread left.
        """
        key = _key(wanted)
        with self._lock:
            question = self._asked.get(key)
            if question is not None:
                question.notes.append(note)
                return question
            question = self._asked[key] = self._waiting[key] = Question(wanted)
            question.notes.append(note)
            try:
                self._start_thread()
            except BaseException:
                self.leave(wanted, question, note)
                raise
        return question

    def leave(self, wanted: Resolve, question: Question, note: Callable[[], object]) -> None:
        """Stop waiting for an answer; may be called any number of times."""
        key = _key(wanted)
        with self._lock:
            if note in question.notes:
                question.notes.remove(note)
            if not question.notes and self._waiting.get(key) is question:
                del self._waiting[key], self._asked[key]

    def _start_thread(self) -> None:
        if len(self._threads) >= MOST_THREADS:
            return
        thread = threading.Thread(target=self._work, name="look-up", daemon=True)
        self._threads.add(thread)
        try:
            start_thread(thread)
        except BaseException:
            self._threads.discard(thread)
            raise

    def _work(self) -> None:
        while self._look_up_next():
            pass

    def _look_up_next(self) -> bool:
        """Return False if no question waits, and the thread ends."""
        taken = self._take()
        if taken is None:
            return False
        key, question = taken
        question.look_up()
        with self._lock:
            del self._asked[key]
            notes, question.notes = question.notes, []
        for note in notes:
            with contextlib.suppress(Exception):  # a loop that was closed meanwhile
                note()
        return True

    def _take(self) -> tuple[tuple[Any, ...], Question] | None:
        with self._lock:
            key = next(iter(self._waiting), None)
            if key is None:
                self._threads.discard(threading.current_thread())
                return None
            return key, self._waiting.pop(key)


_names = Names()


@contextlib.contextmanager
def asked(wanted: Resolve, note: Callable[[], object]) -> Iterator[Question]:
    """
    Look up a name while the ``with`` block runs; leaving it does not wait for the look-up.

    Args:
        note: called in another thread when the question has its result. It must not block.

    Raises:
        OSError: the system has no thread left.
    """
    names = _names
    question = names.put(wanted, note)
    try:
        yield question
    finally:
        names.leave(wanted, question, note)


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


def _key(wanted: Resolve) -> tuple[Any, ...]:
    return wanted.host, wanted.port, wanted.kind, wanted.flags


def no_thread(error: RuntimeError) -> OSError:
    """Return the error for a system without a free thread, with its error number."""
    return OSError(errno.EAGAIN, str(error))


def start_thread(thread: threading.Thread) -> None:
    """
    Start a thread.

    Raises:
        OSError: the system has no thread left.
    """
    try:
        thread.start()
    except RuntimeError as error:
        raise no_thread(error) from error


def _begin_anew() -> None:
    """In a forked child: the threads are its parent's, and one may have held the lock."""
    global _names
    _names = Names()


call_in_children(_begin_anew)
